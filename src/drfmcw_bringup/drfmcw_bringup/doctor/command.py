"""`doctor`: says what keeps a graph from working on this machine, and what to do; status 1 with any ERROR."""

import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import Parser, guarded

from .files import check_file
from .finding import ERROR, Finding
from .graph import check_graph
from .machine import CHECKS


def findings(files: Sequence[Path], seconds: float) -> Iterator[Finding]:
    """Yield all findings; the graph comes last, where the environment lets a node start at all."""
    wrong = False
    for check in CHECKS:
        for found in check(os.environ):
            wrong |= found.level == ERROR and found.subject in ('domain', 'security')
            yield found
    for path in files:
        yield from check_file(path)
    if not wrong:
        yield from check_graph(seconds)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status."""
    parser = Parser(prog='drfmcw doctor', description=__doc__)
    parser.add_argument('files', nargs='*', type=Path, metavar='FILE', help='ROS parameter file or scenario to check')
    parser.add_argument('--seconds', type=float, default=3.0, metavar='S', help='how long to look at the graph (3)')
    arguments = parser.parse_args(argv)

    def work() -> int:
        if not 0.0 <= arguments.seconds <= 3600.0:
            raise ConfigurationError(f'--seconds = {arguments.seconds:g} is outside 0 ... 3600')
        errors = 0
        for found in findings(arguments.files, arguments.seconds):
            print(found.line(), flush=True)
            errors += found.level == ERROR
        return 1 if errors else 0

    return guarded(parser.prog, work)


if __name__ == '__main__':
    sys.exit(main())
