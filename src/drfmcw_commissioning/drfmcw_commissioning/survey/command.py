"""`survey RECORDING`: is the site good enough? Judges a recording of the travel by the customer's requirements.

With --live it records the running graph first.
"""

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.settings import ConfigurationError, declared_parameters, from_mapping
from drfmcw_ros.bag.files import BagError
from drfmcw_ros.bag.options import add_damage_option
from drfmcw_ros.commands.cli import Parser, guarded, write_atomically
from drfmcw_ros.commands.config_files import find_config

from .evidence import read_evidence
from .findings import find, worst
from .live import record_live
from .report import Survey, as_object, checksum, headline, render
from .requirements import Requirements, read_requirements
from .verdict import Result, judge

_PROG = 'drfmcw survey'
_STYLES = {Result.MET: 'green', Result.NOT_MET: 'bold red', Result.NOT_SHOWN: 'yellow'}


def survey(path: str, requirements: Requirements, source: str, estimator: EstimatorSettings | None = None) -> Survey:
    """Return what a recording says about a site.

    Args:
        path: of the recording.
        requirements: that the site shall meet.
        source: where they come from, for the report.
        estimator: of the stations; None takes the default.

    Raises:
        BagError: the recording cannot be read, or no sweep of it gives a range.
    """
    evidence = read_evidence(path, estimator)
    if not evidence.pairs:
        raise BagError(f'{path}: no sweep of two stations gives a range')
    findings = tuple(find(pair, requirements) for pair in evidence.pairs)
    verdicts = tuple(verdict for finding in findings for verdict in judge(finding, requirements))
    return Survey(path, checksum(path), requirements, source, evidence, findings, verdicts)


def _show(found: Survey, console: Console) -> None:
    """Print the verdicts and the positions to look at first."""
    console.print(f'[bold]{headline(found)}[/]', highlight=False)
    width = max(len(v.name) for v in found.verdicts)
    for finding in found.findings:
        console.print(f'\n{finding.pair}', highlight=False)
        for v in found.verdicts:
            if v.pair == finding.pair:
                mark = f'[{_STYLES[v.result]}]{v.result.value:<9}[/]'
                note = f'; {v.note}' if v.note else ''
                console.print(f'  {mark}  {v.name:<{width}}  {v.measured} ({v.required}){note}', highlight=False)
        console.print('  look first at', highlight=False)
        for position, text in worst(finding, 3):
            console.print(f'    {position.distances}: {text}', highlight=False)


def _run(arguments: argparse.Namespace) -> int:
    path = find_config(arguments.requirements)
    requirements = read_requirements(str(path))
    options = {'estimator': arguments.estimator} if arguments.estimator else {}
    estimator = from_mapping(EstimatorSettings, options, 'options')
    console = Console()
    if arguments.duration is not None and not arguments.live:
        raise ConfigurationError('--duration needs --live')
    if arguments.live:
        duration = math.inf if arguments.duration is None else arguments.duration
        status = record_live(arguments.recording, duration, console)
        if status:
            return status
    found = survey(arguments.recording, requirements, str(path), estimator)
    _show(found, console)
    if arguments.out:
        write_atomically(arguments.out, render(found))
        console.print(f'report: {arguments.out}', highlight=False)
    if arguments.json:
        write_atomically(arguments.json, json.dumps(as_object(found), indent=2, allow_nan=False) + '\n')
    return 0 if found.passed else 1


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 all requirements met, 1 one not met or not shown, 2 wrong input."""
    parser = Parser(prog=_PROG, description=__doc__)
    parser.add_argument(
        'recording', help='rosbag2 recording of the travel, with reference distances if accuracy counts'
    )
    add_damage_option(parser)
    parser.add_argument(
        '--requirements', default='requirements', metavar='FILE', help='YAML file (config/requirements.yaml)'
    )
    parser.add_argument('--out', type=Path, metavar='FILE', help='write the acceptance report (HTML; print it as PDF)')
    parser.add_argument('--json', type=Path, metavar='FILE', help='write everything as JSON')
    parser.add_argument('--estimator', help=declared_parameters(EstimatorSettings)['estimator'][1].description)
    parser.add_argument(
        '--live',
        action='store_true',
        help='first record what the running graph measures, into a recording of this name',
    )
    parser.add_argument('--duration', type=float, metavar='S', help='with --live: record S seconds (until Ctrl-C)')
    arguments = parser.parse_args(argv)
    return guarded(_PROG, lambda: _run(arguments))


if __name__ == '__main__':
    sys.exit(main())
