"""`bench [NAME ...]`: measures speed on this machine and prints each figure beside its goal."""

import argparse
import json
import sys

from graph import bench_graph
from rich.console import Console
from rich.table import Table

from drfmcw_ros.cli import Parser, guarded, write_atomically

BENCHMARKS = {'graph': bench_graph}


def main() -> int:
    """Run the command line; return the exit status: 1 where a goal is not met."""
    parser = Parser(prog='drfmcw bench', description=__doc__)
    parser.add_argument('names', nargs='*', metavar='NAME', help=f'benchmarks to run (all): {", ".join(BENCHMARKS)}')
    parser.add_argument('--seconds', type=float, default=60.0, metavar='S', help='length of each live run (60)')
    parser.add_argument('--json', metavar='FILE', help='write all figures as JSON')
    arguments = parser.parse_args()
    for name in arguments.names:
        if name not in BENCHMARKS:
            parser.error(f"unknown benchmark '{name}'; one of {', '.join(BENCHMARKS)}")
    return guarded('drfmcw bench', lambda: _run(arguments))


def _run(arguments: argparse.Namespace) -> int:
    console = Console()
    figures = []
    for name in arguments.names or BENCHMARKS:
        figures += BENCHMARKS[name](arguments.seconds, console)
    table = Table('figure', 'measured', 'goal', 'met', header_style='bold')
    for figure in figures:
        met = {True: 'yes', False: 'NO', None: ''}[figure.met]
        goal = '' if figure.goal is None else f'{figure.relation} {figure.goal:g}'
        table.add_row(figure.name, f'{figure.value:.4g} {figure.unit}', goal, met)
    console.print(table)
    if arguments.json:
        write_atomically(arguments.json, json.dumps([f.as_object() for f in figures], indent=2) + '\n')
    return 1 if any(f.met is False for f in figures) else 0


if __name__ == '__main__':
    sys.exit(main())
