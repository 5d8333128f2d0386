"""`view RECORDING`: one page that shows what is in a recording."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from drfmcw_ros.bag.options import add_damage_option
from drfmcw_ros.commands.cli import Parser, guarded, write_atomically


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    result: argparse.ArgumentParser = Parser(prog='drfmcw view', description=__doc__)
    result.add_argument('recording', help='rosbag2 recording: directory, .mcap or .db3 file')
    add_damage_option(result)
    result.add_argument('--out', metavar='FILE', help='page to write (RECORDING.html in the current directory)')
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    arguments = parser().parse_args(argv)
    status: int = guarded('drfmcw view', lambda: _run(arguments))
    return status


def _run(arguments: argparse.Namespace) -> None:
    from .look.page import render  # matplotlib takes a third of a second, which --help need not wait for

    out = Path(arguments.out or f'{Path(arguments.recording).resolve().stem}.html')
    write_atomically(out, render(arguments.recording))
    print(f'page: {out}')


if __name__ == '__main__':
    sys.exit(main())
