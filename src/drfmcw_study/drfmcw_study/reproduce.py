"""`reproduce`: Figs. 6 to 12 and Table 1 of the paper, simulated, with a table of its claims beside ours."""

import argparse
import dataclasses
import os
import sys
import textwrap
import xml.etree.ElementTree
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.settings import ConfigurationError, declared_parameters, nearest
from drfmcw_ros.commands.cli import Parser, guarded, write_atomically
from drfmcw_ros.work.progress import Progress

from .paper import claims, figures
from .paper.catalogue import SECTIONS
from .paper.experiments import NOISE_FLOORS, Run, simulate_all
from .paper.section import LABORATORY_PATH, Finished, Section
from .trials.study import StudyStopped

_CHECKOUT = Path(__file__).resolve().parents[3]  # where this file lies in a source checkout
_DOCUMENT = 'reproduction.md'
_PLOTS = 'reproduction'  # folder beside the document


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    arguments = _parser().parse_args(argv)
    try:
        return guarded('drfmcw reproduce', lambda: _reproduce(arguments))
    except StudyStopped as error:
        print(f'drfmcw reproduce: {error}', file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog='drfmcw reproduce', description=__doc__)
    parser.add_argument(
        '--out', metavar='DIR', help=f'write DIR/{_DOCUMENT} and its plots; default: docs/ of a source checkout'
    )
    parser.add_argument('--trials', type=int, default=2000, metavar='N', help='sweep pairs per point (2000)')
    parser.add_argument('--jobs', type=int, default=0, metavar='N', help='processes; default: one per core')
    parser.add_argument('--only', metavar='LIST', help=f'only these figures, with --out: {",".join(SECTIONS)}')
    parser.add_argument(
        '--estimator', default='paper', metavar='NAME',
        help=f'of the beat frequencies (paper): {declared_parameters(EstimatorSettings)["estimator"][1].description}',
    )  # fmt: skip
    parser.add_argument('--seed', type=int, default=1, metavar='N', help='of all random numbers (1)')
    parser.add_argument('--force', action='store_true', help='replace a document in DIR')
    return parser


@dataclasses.dataclass(frozen=True)
class _Options:
    """What the command line asks for, checked."""

    folder: Path
    sections: tuple[Section, ...]
    run: Run
    jobs: int
    complete: bool  # all figures


def _options(arguments: argparse.Namespace) -> _Options:
    """Check the command line.

    Raises:
        ConfigurationError: unknown figure or estimator, a number out of bounds, a document that would be replaced.
    """
    for name, low, high in (('trials', 2, 10**7), ('jobs', 0, 1024), ('seed', 0, 2**63 - 1)):
        value = getattr(arguments, name)
        if not low <= value <= high:
            raise ConfigurationError(f'--{name} = {value} is outside {low} ... {high}')
    names = list(SECTIONS) if arguments.only is None else [n.strip() for n in arguments.only.split(',')]
    for name in names:
        if name not in SECTIONS:
            raise ConfigurationError(f"--only: unknown figure '{name}'{nearest(name, list(SECTIONS))}")
    choices = declared_parameters(EstimatorSettings)['estimator'][1].choices
    if arguments.estimator not in choices:
        raise ConfigurationError(f"--estimator: unknown '{arguments.estimator}'{nearest(arguments.estimator, choices)}")
    folder = _CHECKOUT / 'docs' if arguments.out is None else Path(arguments.out)
    if arguments.out is None:
        if not (_CHECKOUT / 'drfmcw').is_file() or not folder.is_dir():
            raise ConfigurationError('not run in a source checkout: --out DIR says where to write')
        if arguments.only is not None:
            raise ConfigurationError('--only leaves out parts of the document: give --out DIR as well')
    elif (folder / _DOCUMENT).exists() and not arguments.force:
        raise ConfigurationError(f'{folder / _DOCUMENT} exists; --force replaces it')
    return _Options(
        folder=folder,
        sections=tuple(SECTIONS[name]() for name in SECTIONS if name in names),
        run=Run(arguments.trials, arguments.seed, EstimatorSettings(estimator=arguments.estimator)),
        jobs=arguments.jobs or len(os.sched_getaffinity(0)),
        complete=set(names) == set(SECTIONS),
    )


def _reproduce(arguments: argparse.Namespace) -> None:
    options = _options(arguments)
    plots = options.folder / _PLOTS
    try:
        plots.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f'{plots}: {error.strerror}') from None
    console = Console(stderr=True)
    points = [point for section in options.sections for point in section.points]
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task('sweep pairs', total=len(points) * options.run.trials)
        outcomes = simulate_all(points, options.run, options.jobs, lambda done: bar.update(task, completed=done))
    finished: list[tuple[Section, Finished]] = []
    begin = 0
    for section in options.sections:
        end = begin + len(section.points)
        finished.append((section, section.finish(outcomes[begin:end], options.run)))
        begin = end
    for section, part in finished:
        write_atomically(plots / f'{section.name}.png', figures.png(part.figure))
    found = [*claims.exact_claims(), *(claim for _, part in finished for claim in part.claims)]
    write_atomically(options.folder / _DOCUMENT, _document(options, finished, found))
    agreeing = sum(claim.agrees for claim in found)
    console.print(
        f'{options.folder / _DOCUMENT}: {len(finished)} figures; of {len(found)} claims {agreeing} agree, '
        f'{len(found) - agreeing} differ',
        highlight=False, soft_wrap=True,
    )  # fmt: skip


def _version() -> str:
    """Return the version of this package."""
    path = Path(__file__).resolve().parents[1] / 'package.xml'
    if not path.is_file():
        from ament_index_python.packages import get_package_share_directory

        path = Path(get_package_share_directory('drfmcw_study'), 'package.xml')
    return xml.etree.ElementTree.parse(path).findtext('version', '')


def _document(options: _Options, finished: Sequence[tuple[Section, Finished]], found: Sequence[claims.Claim]) -> str:
    """Return the document as Markdown."""
    command = ['./drfmcw reproduce']
    if options.run.trials != 2000:
        command.append(f'--trials {options.run.trials}')
    if options.run.seed != 1:
        command.append(f'--seed {options.run.seed}')
    if options.run.estimator.estimator != 'paper':
        command.append(f'--estimator {options.run.estimator.estimator}')
    if not options.complete:
        command.append(f'--only {",".join(section.name for section, _ in finished)} --out DIR')
    estimator = options.run.estimator.estimator
    window = ', Hann window' if estimator in ('paper', 'hann') else ''
    floors = ', '.join(f'{name} {level:.1f} dBm' for name, level in NOISE_FLOORS.items())
    agreeing = sum(claim.agrees for claim in found)
    known, others = ([c for c in found if c.known is k] for k in (True, False))
    rows = '\n'.join(f'| {name} | {value} |' for name, value in claims.parameters())
    switches = options.folder == _CHECKOUT / 'docs'
    parts = [
        '# The paper, reproduced',
        f"""Written by `{' '.join(command)}`, drfmcw {_version()}: do not edit. {options.run.trials} simulated sweep
pairs per point, seed {options.run.seed}, estimator `{estimator}`{window}. The simulator renders the IF samples of both
stations; the classes of the live station and fusion nodes turn them into ranges. The same seed gives the same numbers,
for any number of processes.""",
        f"""{agreeing} of {len(found)} claims of the paper agree with what our code computes, {len(found) - agreeing}
differ. The paper publishes its measurements as plots only; the comparison uses the figures in its text.""",
        'Assumptions where the paper states nothing:',
        f"""- Noise power in the IF band of 1.024 MHz: {floors}. A leaves 10 dB in the whole band at 5000 m, as Fig. 12
  says; B gives the 12 mm at 1000 m of Fig. 11. Both are sub-millimetre indoors.
- Phase noise: one pole with its corner at 200 kHz, through the -90 dBc/Hz at 100 kHz of Table 1.
- The cables delay as {LABORATORY_PATH:.0f} m of air. On the crane T_off is 3.41 µs in short-distance mode, a quarter of
  the sampling rate, and 0.6 µs in long-distance mode.
- Free space, one path, a standing crane.""",
        '## Where the paper disagrees with itself',
        _claims_table(known),
        'Switches that bring the printed version back: [errata](paper_errata.md).' if switches else '',
        '## Its other claims',
        _claims_table(others),
        '## Table 1, and what follows from it',
        f'| parameter | value |\n|---|---|\n{rows}',
    ]
    for section, part in finished:
        image = f'![{section.title}]({_PLOTS}/{section.name}.png)'
        parts += [f'## Fig. {section.name.removeprefix("fig")}: {section.title}', image, part.text, part.table]
    return '\n\n'.join(_filled(part) for part in parts if part) + '\n'


def _filled(part: str) -> str:
    """Return a paragraph with its lines filled; tables, lists, images and headings as they are."""
    return part if part[0] in '|-!#' else textwrap.fill(' '.join(part.split()), 118, break_on_hyphens=False)


def _claims_table(found: Sequence[claims.Claim]) -> str:
    rows = ['| where | the paper | ours | verdict | why |', '|---|---|---|---|---|']
    rows += [f'| {c.where} | {c.paper} | {c.ours} | {c.verdict} | {c.why} |' for c in found]
    return '\n'.join(rows)


if __name__ == '__main__':
    sys.exit(main())
