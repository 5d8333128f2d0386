"""`calibrate rehearse` and `calibrate contributions`: what a calibration achieves, simulated and computed."""

import argparse
import os
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TimeRemainingColumn

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import write_atomically
from drfmcw_ros.work.processes import WorkFailed, unordered
from drfmcw_ros.work.progress import Progress

from .commissioning import Outcome, commission
from .contributing import DISTANCES
from .contributing import table as contributions
from .summary import summarise, table

_NEAREST, _FARTHEST = 1.0, 1500.0  # that the modes of the default sweep measure [m]


def add_parsers(commands: Any) -> None:
    """Add the subcommands."""
    summary = 'commission simulated stations again and again, and compare errors with what is stated'
    rehearse = commands.add_parser('rehearse', help=summary, description=summary)
    rehearse.add_argument('--times', type=int, default=200, metavar='N', help='commissionings (200)')
    rehearse.add_argument('--seed', type=int, default=0, metavar='N', help='of the first; each has the next one (0)')
    rehearse.add_argument('--jobs', type=int, default=os.cpu_count() or 1, metavar='N', help='processes (all cores)')
    rehearse.add_argument('--report', metavar='FILE', help='write the table (Markdown) too')
    rehearse.set_defaults(work=_rehearse)
    summary = 'print what each part of a calibration contributes to the uncertainty of a range'
    parts = commands.add_parser('contributions', help=summary, description=summary)
    parts.add_argument(
        '--distance', action='append', type=float, metavar='M',
        help=f'distance (repeatable; {" and ".join(f"{d:g}" for d in DISTANCES)})',
    )  # fmt: skip
    parts.set_defaults(work=_contributions)


def _contributions(arguments: argparse.Namespace) -> None:
    distances = arguments.distance or DISTANCES
    for distance in distances:
        if not _NEAREST <= distance <= _FARTHEST:
            raise ConfigurationError(f'--distance {distance:g}: from {_NEAREST:g} to {_FARTHEST:g} m can be computed')
    print(contributions(distances))


def _rehearse(arguments: argparse.Namespace) -> int:
    """Return 1 where the stated uncertainty does not hold."""
    if arguments.times < 2 or arguments.jobs < 1 or arguments.seed < 0:
        raise ConfigurationError('--times must be 2 at least, --jobs 1 and --seed 0')
    seeds = range(arguments.seed, arguments.seed + arguments.times)
    found: dict[int, list[Outcome]] = {}
    columns = ('{task.description}', BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task('commissionings', total=len(seeds))
        try:
            for number, outcomes in unordered(commission, seeds, arguments.jobs):
                found[number] = outcomes
                bar.update(task, completed=len(found))
        except WorkFailed as error:
            raise ConfigurationError(f'a worker process died ({error})') from None
    rows = summarise(found[number] for number in range(len(seeds)))
    print(table(rows))
    if arguments.report:
        write_atomically(arguments.report, table(rows) + '\n')
    return 0 if all(row.holds for row in rows) else 1
