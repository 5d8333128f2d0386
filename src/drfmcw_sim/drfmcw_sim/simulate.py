"""`drfmcw simulate`: a scenario rendered into a recording, or played live by the simulator node."""

import argparse
import os
import sys
from collections.abc import Sequence

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from drfmcw_ros.commands.cli import Parser, guarded
from drfmcw_ros.work.progress import Progress

from .recording import write_recording
from .scenario import read_scenario
from .timeline import Timeline

_WORTH_PROCESSES = 2000  # sweep pairs: about a second on one core


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    result = Parser(
        prog='drfmcw simulate',
        description='Simulate a scenario: into a recording with --out, without it live as the hardware would.',
    )
    result.add_argument('scenario', help='scenario: YAML file, or name of one in config/')
    result.add_argument('--out', metavar='RECORDING', help='write this recording, as fast as possible')
    result.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap', help='format of the recording')
    result.add_argument('--force', action='store_true', help='replace a recording of that name')
    result.add_argument(
        '--jobs', type=int, metavar='N', help='processes that render (all cores); the recording is the same'
    )
    result.add_argument('--seed', type=int, help="replaces the scenario's")
    result.add_argument(
        '--set', metavar='KEY=VALUE', action='append', default=[], dest='overrides',
        help='replace a setting of the scenario: section.key=value, list items by number (pairs.0.first=master)',
    )  # fmt: skip
    result.add_argument(
        '--pace', choices=('scenario', 'subscribers'), default='scenario', help='live: pace of the sweeps'
    )
    result.add_argument('--rate', type=float, default=1.0, help='live: scenario seconds per second')
    result.add_argument(
        '--mode-control', choices=('request', 'range'), default='request', help='live: who chooses the mode'
    )
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status."""
    command = parser()
    arguments = command.parse_args(argv)
    if arguments.jobs is not None and arguments.jobs < 1:
        command.error(f'--jobs {arguments.jobs}: at least 1')
    return guarded('drfmcw simulate', lambda: _live(arguments) if arguments.out is None else _render(arguments))


def _render(arguments: argparse.Namespace) -> None:
    """Write the scenario into a recording, with a progress bar."""
    scenario = read_scenario(arguments.scenario, tuple(arguments.overrides), arguments.seed)
    sweep_count = Timeline(scenario).sweep_count
    jobs = arguments.jobs
    if jobs is None:  # processes take half a second to start
        jobs = len(os.sched_getaffinity(0)) if sweep_count > _WORTH_PROCESSES else 1
    console = Console(stderr=True)
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task('sweep pairs', total=sweep_count)
        count = write_recording(
            scenario,
            arguments.out,
            arguments.storage,
            lambda done: bar.update(task, completed=done),
            overwrite=arguments.force,
            jobs=jobs,
        )
    console.print(f'{arguments.out}: {count} sweep pairs', highlight=False)


def _live(arguments: argparse.Namespace) -> int:
    """Run the simulator node with the command line's settings as its parameters."""
    from .simulator import main as simulator

    parameters = {
        'scenario': arguments.scenario,
        'pace': arguments.pace,
        'rate': float(arguments.rate),
        'mode_control': arguments.mode_control,
    }
    if arguments.seed is not None:
        parameters['seed'] = arguments.seed
    if arguments.overrides:
        parameters['overrides'] = arguments.overrides
    ros = ['--ros-args']
    for name, value in parameters.items():
        quoted = '[' + ', '.join(_quote(v) for v in value) + ']' if isinstance(value, list) else value
        ros += ['-p', f'{name}:={_quote(value) if isinstance(value, str) else quoted}']
    return simulator(ros)


def _quote(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


if __name__ == '__main__':
    sys.exit(main())
