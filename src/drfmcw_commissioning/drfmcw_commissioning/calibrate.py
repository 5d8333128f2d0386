"""`drfmcw calibrate`: stations indoors, a pair on site, and the calibrations that are kept."""

import argparse
import sys
from collections.abc import Sequence

from drfmcw_ros.commands.cli import Parser, guarded

from . import stored
from .indoors import command as indoors
from .rehearsal import command as rehearsal
from .site import command as site


def parser() -> argparse.ArgumentParser:
    """Return the command line; its help holds that of every subcommand."""
    result = Parser(prog='drfmcw calibrate', description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = result.add_subparsers(metavar='COMMAND', required=True, parser_class=Parser)
    indoors.add_parser(commands)
    site.add_parser(commands)
    stored.add_parsers(commands)
    rehearsal.add_parsers(commands)
    result.epilog = 'options of the commands:\n\n' + '\n'.join(p.format_usage() for p in commands.choices.values())
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status."""
    arguments = parser().parse_args(argv)
    return guarded('drfmcw calibrate', lambda: arguments.work(arguments))


if __name__ == '__main__':
    sys.exit(main())
