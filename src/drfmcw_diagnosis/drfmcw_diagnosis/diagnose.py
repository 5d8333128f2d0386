"""`drfmcw diagnose`: says what physics the model of a recording leaves out."""

import argparse
import json
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.bag.options import add_damage_option
from drfmcw_ros.commands.cli import Parser, guarded, write_atomically
from drfmcw_ros.work.progress import Progress

from .engine import LIMITS, diagnose
from .finding.report import render_html
from .finding.summary import terminal
from .several.command import Wanted, diagnose_several
from .several.running import Place


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    result = Parser(
        prog='drfmcw diagnose',
        description='Compare a recording with the model of its own settings, calibrations, weather and reference, and '
        'say what physics the model leaves out. Exit status: 0 whatever the verdict; 2 if a recording cannot be read '
        'or lacks what is needed (the others are diagnosed), or a file cannot be written.',
    )
    result.add_argument(
        'recordings', metavar='RECORDING', nargs='+',
        help='rosbag2 recording of raw IF samples, of both stations or of one; of several, also what they share',
    )  # fmt: skip
    add_damage_option(result)
    result.add_argument('--json', metavar='FILE', help='write the finding as JSON')
    result.add_argument('--html', metavar='FILE', help='write a report')
    result.add_argument('--out', metavar='DIR', help='write finding.json, report.html and refined.yaml there')
    result.add_argument('--pair', metavar='FIRST/SECOND', help='pair of stations (the one with most sweeps)')
    result.add_argument(
        '--false-alarm-rate', type=float, default=LIMITS.false_alarm_rate, metavar='P',
        help=f'accepted chance of finding a mismatch where there is none ({LIMITS.false_alarm_rate:g})',
    )  # fmt: skip
    result.add_argument('--without', default='', metavar='EFFECT[,EFFECT]', help='search without these effects')
    result.add_argument('--jobs', type=int, default=os.cpu_count(), metavar='N', help='processes (default: all cores)')
    result.add_argument('--scheduler', metavar='ADDRESS', help='Dask scheduler whose workers do several recordings')
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status."""
    arguments = parser().parse_args(argv)
    words = ['./drfmcw', 'diagnose', *(sys.argv[1:] if argv is None else argv)]
    return guarded('drfmcw diagnose', lambda: _run(arguments, shlex.join(words)))


def _run(arguments: argparse.Namespace, command: str) -> int:
    if not 0.0 < arguments.false_alarm_rate < 1.0:
        raise ConfigurationError(f'--false-alarm-rate = {arguments.false_alarm_rate:g} is not between 0 and 1')
    if arguments.jobs < 1:
        raise ConfigurationError(f'--jobs = {arguments.jobs} is not at least 1')
    for option, file in (('--json', arguments.json), ('--html', arguments.html)):
        if file == '-':
            raise ConfigurationError(f'{option} -: is no file name, and the standard output is not written to')
    without = tuple(filter(None, (name.strip() for name in arguments.without.split(','))))
    out = Path(arguments.out) if arguments.out else None
    if len(arguments.recordings) > 1 or arguments.scheduler:
        wanted = Wanted(
            tuple(arguments.recordings),
            out,
            arguments.json,
            arguments.html,
            arguments.pair,
            arguments.false_alarm_rate,
            without,
            command,
        )
        return diagnose_several(wanted, Place(arguments.jobs, arguments.scheduler))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    console = Console(stderr=True)
    columns = (TextColumn('{task.description}'), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task('reading', total=1.0)
        diagnosis = diagnose(
            arguments.recordings[0],
            arguments.pair,
            arguments.false_alarm_rate,
            out,
            lambda text, share: bar.update(task, description=text, completed=share),
            command,
            without,
            arguments.jobs,
        )
    page = arguments.html or (str(out / 'report.html') if out else None)
    finding = arguments.json or (str(out / 'finding.json') if out else None)
    if finding:
        write_atomically(finding, json.dumps(diagnosis.as_object(), indent=2) + '\n')
    if page:
        configuration = Path(diagnosis.refined_config).read_text(encoding='utf-8') if diagnosis.refined_config else ''
        write_atomically(page, render_html(diagnosis, configuration, arguments.jobs))
    Console().print(terminal(diagnosis, page))
    return 0


if __name__ == '__main__':
    sys.exit(main())
