"""`drfmcw montecarlo SCENARIO`: simulate and evaluate many measurements at many points, resumable, on many machines."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from drfmcw_physics.settings import ConfigurationError, read_yaml
from drfmcw_ros.commands.cli import Parser, guarded, write_atomically
from drfmcw_ros.commands.config_files import find_config
from drfmcw_ros.work.progress import Progress

from . import summary
from .points import grid, try_point, values_of
from .trials.results import ResultDirectory
from .trials.running import run
from .trials.study import Study, StudyStopped

_PROG = 'drfmcw montecarlo'
_PACKAGES = tuple(f'drfmcw_{name}' for name in ('physics', 'sim', 'node', 'fusion', 'study'))
_FILE_WIDTH = 200  # of the table where it does not go to a terminal [characters]


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    result = Parser(
        prog=_PROG,
        description='Simulate and evaluate measurements of a standing crane, many at each of many points. '
        'The same command resumes an interrupted study.',
    )
    result.add_argument('scenario', help='scenario: YAML file, or name of one in config/')
    result.add_argument('--out', metavar='DIR', required=True, help='directory of the results')
    result.add_argument(
        '--vary', metavar='KEY=VALUES', action='append', default=[],
        help='first:last:step or value,value,... of the distance, a setting of the scenario (weather.humidity, '
        'stations.slave.alpha, effects.0.deviation), estimator.KEY or fusion.KEY; several make the full grid',
    )  # fmt: skip
    result.add_argument(
        '--set', metavar='KEY=VALUE', action='append', default=[], dest='assignments',
        help='one value of such a key, at all points',
    )  # fmt: skip
    result.add_argument(
        '--estimator', metavar='NAME', help='of the beat frequencies, as --set estimator.estimator=NAME'
    )
    result.add_argument('--trials', type=int, default=2000, metavar='N', help='at each point (default: 2000)')
    result.add_argument('--batch', type=int, default=500, metavar='N', help='trials stored together (default: 500)')
    result.add_argument('--seed', type=int, help="of all random numbers (default: the scenario's)")
    result.add_argument('--jobs', type=int, default=os.cpu_count(), metavar='N', help='processes (default: all cores)')
    result.add_argument('--scheduler', metavar='ADDRESS', help='Dask scheduler whose workers do it: tcp://host:8786')
    result.add_argument('--csv', metavar='FILE', help="write the table as CSV [m]; '-' prints it")
    result.add_argument('--json', metavar='FILE', help="write the table as JSON [m]; '-' prints it")
    result.add_argument('--plot', metavar='FILE', help='write bias and standard deviation as PNG, SVG or PDF')
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status."""
    arguments = parser().parse_args(argv)
    return guarded(_PROG, lambda: _run(arguments))


def study_from(arguments: argparse.Namespace) -> Study:
    """Return the study that the command line asks for.

    Raises:
        ConfigurationError: what it asks for is not valid.
    """
    path = find_config(arguments.scenario)
    mapping = read_yaml(path)
    assignments = list(arguments.assignments)
    if arguments.estimator is not None:
        assignments.append(f'estimator.estimator={arguments.estimator}')
    seed = mapping.get('seed', 1) if arguments.seed is None else arguments.seed
    if not isinstance(seed, int) or seed < 0:
        raise ConfigurationError(f'seed = {seed!r} must be a whole number from 0 on')
    points = grid(mapping, [values_of(text) for text in arguments.vary], assignments, seed)
    return Study(tuple(points), arguments.trials, arguments.batch, _PACKAGES)


class _Rate(ProgressColumn):
    """Trials per second."""

    def render(self, task: Task) -> Text:
        """Return the present speed."""
        return Text(f'{task.speed:.0f} trials/s' if task.speed else '')


def _run(arguments: argparse.Namespace) -> int:
    if arguments.jobs < 1:
        raise ConfigurationError(f'--jobs = {arguments.jobs} must be at least 1')
    study = study_from(arguments)
    messages = Console(stderr=True)
    with ResultDirectory(arguments.out, study) as results:
        try:
            _work(results, arguments, messages)
        except KeyboardInterrupt:
            _say_how_to_resume(results, messages, 'interrupted')
            raise
        except StudyStopped as error:
            _say_how_to_resume(results, messages, str(error))
            return 1
        rows = summary.summarise(results)
    name = Path(arguments.scenario).stem
    # with the data printed, standard output holds nothing else
    console = Console(stderr='-' in (arguments.csv, arguments.json))
    if not console.is_terminal:
        console = Console(stderr=console.stderr, width=_FILE_WIDTH)
    console.print(summary.table(rows, name))
    for text, file in ((summary.csv_text, arguments.csv), (summary.json_text, arguments.json)):
        if file == '-':
            print(text(rows), end='')
        elif file:
            write_atomically(file, text(rows))
    if arguments.plot:
        summary.write_plot(rows, name, arguments.plot)
    return 0


def _work(results: ResultDirectory, arguments: argparse.Namespace, messages: Console) -> None:
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(), _Rate(), TimeRemainingColumn())
    with Progress(*columns, console=messages) as bar:
        task = bar.add_task('trials', total=results.study.total)
        run(
            results,
            try_point,
            jobs=arguments.jobs,
            scheduler=arguments.scheduler,
            progress=lambda done: bar.update(task, completed=done),
            note=lambda text: messages.print(f'{_PROG}: {text}', highlight=False, markup=False, soft_wrap=True),
        )


def _say_how_to_resume(results: ResultDirectory, messages: Console, why: str) -> None:
    left = sum(len(job.sweeps) for job in results.missing())
    messages.print(
        f'{_PROG}: {why}; {results.study.total - left} of {results.study.total} trials are in {results.path}, '
        'the same command does the rest',
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


if __name__ == '__main__':
    sys.exit(main())
