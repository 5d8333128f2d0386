"""`bench [NAME ...]`: prints each figure beside its bound, its reference measured in the same run, and its goal."""

import argparse
import inspect
import json
import sys
from collections.abc import Sequence

import document
from accuracy import bench_accuracy
from estimation import bench_estimation
from figures import Figure, number
from gateway import bench_gateway
from graph import bench_graph
from host import bench_host
from latency import bench_latency
from rich.console import Console
from rich.table import Table
from simulation import bench_simulation

from drfmcw_ros.commands.cli import Parser, guarded, write_atomically

BENCHMARKS = {
    'simulation': bench_simulation,
    'estimation': bench_estimation,
    'accuracy': bench_accuracy,
    'graph': bench_graph,
    'latency': bench_latency,
    'gateway': bench_gateway,
    'host': bench_host,
}
_REPORT = 'report'


def main() -> int:
    """Run the command line; return the exit status: 1 where a goal is not met."""
    parser = Parser(prog='drfmcw bench', description=__doc__)
    parser.add_argument(
        'names',
        nargs='*',
        metavar='NAME',
        help=f'benchmarks to run (all): {", ".join(BENCHMARKS)}; report: only write docs/benchmarks.md',
    )
    parser.add_argument('--seconds', type=float, default=60.0, metavar='S', help='length of each measurement (60)')
    parser.add_argument('--json', metavar='FILE', help='write all figures as JSON')
    parser.add_argument('--document', action='store_true', help='write the figures into docs/benchmarks.json and .md')
    parser.add_argument('--list', action='store_true', help='list what each benchmark measures, then exit')
    arguments = parser.parse_args()
    for name in arguments.names:
        if name not in BENCHMARKS and arguments.names != [_REPORT]:
            parser.error(f"unknown benchmark '{name}'; one of {', '.join(BENCHMARKS)}, or {_REPORT} alone")
    if arguments.list:
        for name, benchmark in BENCHMARKS.items():
            print(f'{name:<12} {(inspect.getdoc(benchmark) or "").splitlines()[0]}')
        return 0
    return guarded('drfmcw bench', lambda: _run(arguments))


def _run(arguments: argparse.Namespace) -> int:
    console = Console()
    results = document.read_results() if arguments.document or arguments.names == [_REPORT] else {}
    if arguments.names == [_REPORT]:
        document.write(results)
        return 0
    figures = []
    for name in arguments.names or BENCHMARKS:
        measured = BENCHMARKS[name](arguments.seconds, console)
        figures += measured
        if arguments.document:
            command = f'`./drfmcw bench {name} --seconds {arguments.seconds:g}`'
            results['rows'] = document.with_figures(results['rows'], name, command, measured)
            document.write(results)
    console.print(_table(figures))
    if arguments.json:
        write_atomically(arguments.json, json.dumps([f.as_object() for f in figures], indent=2) + '\n')
    return 1 if any(f.met is False for f in figures) else 0


def _table(figures: Sequence[Figure]) -> Table:
    """Return the figures as a table, with those columns that any of them fills."""
    columns = {'figure': [f.name for f in figures], 'measured': [f'{number(f.value)} {f.unit}' for f in figures]}
    columns['bound'] = [number(f.bound) for f in figures]
    columns['reference'] = [f'{number(f.reference)} {f.reference_name}'.strip() for f in figures]
    columns['goal'] = ['' if f.goal is None else f'{f.relation} {number(f.goal)}' for f in figures]
    columns['met'] = [{True: 'yes', False: 'NO', None: ''}[f.met] for f in figures]
    filled = {heading: cells for heading, cells in columns.items() if any(cells)}
    table = Table(*filled, header_style='bold')
    for cells in zip(*filled.values(), strict=True):
        table.add_row(*cells)
    return table


if __name__ == '__main__':
    sys.exit(main())
