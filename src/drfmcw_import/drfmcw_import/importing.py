"""`import FILE [FILE ...] --settings FILE --out RECORDING`: files of another radar into a recording."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import TextColumn, TimeElapsedColumn

from drfmcw_ros.bag.files import STORAGES
from drfmcw_ros.commands.cli import Parser, guarded
from drfmcw_ros.work.progress import Progress

from .convert.recording import Imported, Importer, read_settings


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    result: argparse.ArgumentParser = Parser(prog='drfmcw import', description=__doc__)
    result.add_argument(
        'files', nargs='+', type=Path, metavar='FILE', help='of one radar at one setting, in order of time'
    )
    result.add_argument(
        '--settings', required=True, metavar='FILE', help='YAML: radar, layout, samples (docs/importing.md)'
    )
    result.add_argument('--out', required=True, metavar='RECORDING', help='recording to write, a directory')
    result.add_argument('--storage', choices=list(STORAGES), default='mcap', help='storage format (mcap)')
    result.add_argument('--overwrite', action='store_true', help='replace a recording that exists')
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    arguments = parser().parse_args(argv)
    status: int = guarded('drfmcw import', lambda: _run(arguments))
    return status


def _run(arguments: argparse.Namespace) -> None:
    settings, kind, stated = read_settings(arguments.settings, arguments.files)
    console = Console(stderr=True)
    columns = (TextColumn('{task.description}'), TextColumn('{task.completed} sweeps'), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task('importing', total=None)
        imported = Importer(settings, kind).run(
            arguments.files,
            arguments.out,
            arguments.storage,
            arguments.overwrite,
            lambda count: bar.update(task, completed=count),
        )
    for line in report(imported, stated, arguments.out):
        Console().print(line, highlight=False, markup=False, soft_wrap=True)


def report(imported: Imported, stated: Sequence[str], out: str) -> list[str]:
    """Return what is said of an import: what was written, stated by the files, found; warnings last of each station."""
    lines = []
    if stated:
        lines.append(f'from the files: {"; ".join(stated)}')
    lines += [f'read: {note}' for note in imported.notes]
    for sweep, found in zip(imported.settings, imported.findings, strict=True):
        lines.append(
            f"station '{sweep.station}': {imported.sweeps} sweeps of {sweep.sample_count} "
            f'{"I/Q" if imported.iq else "real"} samples at {sweep.sample_rate / 1e6:.6g} MS/s, '
            f'{sweep.start_frequency / 1e9:.6g} GHz {sweep.bandwidth / 1e6:+.6g} MHz in '
            f'{sweep.ramp_duration * 1e6:.6g} us'
        )
        lines += [f'  ok: {f.sentence}' for f in found if f.agrees]
        lines += [f'  warning: {f.sentence}' for f in found if not f.agrees]
    lines.append(f'recording: {out}')
    return lines


if __name__ == '__main__':
    sys.exit(main())
