"""`drfmcw campaign`: faults against the nodes' own classes, counting ranges that are valid and wrong."""

import argparse
import dataclasses
import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console

from drfmcw_physics.settings import ConfigurationError, nearest
from drfmcw_ros.commands.cli import Parser, guarded, write_atomically
from drfmcw_ros.work.cluster import on_cluster
from drfmcw_ros.work.processes import WorkFailed, unordered

from .faults import Fault, faults
from .fuzz import fuzz, summary
from .fuzz_targets import targets
from .network import NETWORK_SWEEPS, NetworkRow, network_table, networks
from .report import Row, document, table
from .trying import Try, tried

R = TypeVar('R', Row, NetworkRow)

_QUICK, _FULL = 100, 2500  # sweeps with the fault, per case


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 1 where a range was valid and wrong."""
    parser = Parser(prog='drfmcw campaign', description=__doc__)
    parser.add_argument('--quick', action='store_true', help=f'{_QUICK} sweeps per case instead of {_FULL}')
    parser.add_argument('--fault', action='append', metavar='NAME', help='only this fault (repeatable)')
    parser.add_argument(
        '--out', metavar='DIR', default='campaign', help='results; an interrupted campaign resumes there'
    )
    parser.add_argument('--report', metavar='FILE', help='write the report, as docs/reliability.md')
    parser.add_argument('--jobs', type=int, default=os.cpu_count() or 1, metavar='N', help='processes (all cores)')
    parser.add_argument('--scheduler', metavar='ADDRESS', help='Dask scheduler whose workers do it: tcp://host:8786')
    parser.add_argument('--fuzz', type=float, metavar='MINUTES', help='fuzz all inputs instead, for so long')
    parser.add_argument('--corpus', type=Path, metavar='DIR', help='inputs that --fuzz starts from and adds to')
    parser.add_argument('--seed', type=int, default=1, help='of all random numbers')
    arguments = parser.parse_args(argv)
    work = _run if arguments.fuzz is None else _fuzz
    return guarded(parser.prog, lambda: work(arguments, Console(stderr=True)))


def _fuzz(arguments: argparse.Namespace, console: Console) -> int:
    """Fuzz every input; failing inputs are left in --out."""
    if not 0.0 < arguments.fuzz < math.inf:
        raise ConfigurationError(f'--fuzz {arguments.fuzz:g}: a number of minutes above 0')
    directory = _made(arguments.out)
    state = fuzz(targets(), arguments.fuzz, arguments.seed, arguments.corpus)
    print(summary(state))
    for found in state:
        for number, data in enumerate(found.failures.values()):
            write_atomically(directory / f'{found.target.name}_{number}', data)
    return 1 if any(found.failures for found in state) else 0


def _made(name: str) -> Path:
    directory = Path(name)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f'--out {directory}: {error.strerror}') from None
    return directory


def _run(arguments: argparse.Namespace, console: Console) -> int:
    options = vars(arguments)
    chosen, links = _chosen(options['fault']), [] if options['fault'] else networks()
    if options['jobs'] < 1:
        raise ConfigurationError(f'--jobs {options["jobs"]}: at least 1')
    sweeps, seed = _QUICK if options['quick'] else _FULL, options['seed']
    directory = _made(options['out'])
    tries = [Try(fault.name, fault.size, sweeps, seed) for fault in chosen]
    tries += [Try(link.name, '', max(sweeps, NETWORK_SWEEPS), seed) for link in links]
    paths = [directory / f'{_file_name(order)}_{order.sweeps}_{seed}.json' for order in tries]
    missing = [number for number, path in enumerate(paths) if not path.exists()]
    try:
        for number, row in _results([tries[number] for number in missing], options, console):
            write_atomically(paths[missing[number]], json.dumps(dataclasses.asdict(row)) + '\n')
            name = row.name if isinstance(row, NetworkRow) else f'{row.fault}, {row.size}'
            console.print(f'{name}: {row.wrong} of {row.sweeps} wrong', highlight=False)
    except WorkFailed as error:
        raise ConfigurationError(f'a worker died ({error}); call again to resume') from None
    rows = [_read(path, Row) for path in paths[: len(chosen)]]
    of_links = [_read(path, NetworkRow) for path in paths[len(chosen) :]]
    print(table(rows))
    if of_links:
        print(network_table(of_links))
    if options['report']:
        command = f'./drfmcw campaign{" --quick" * options["quick"]} --seed {seed}'
        write_atomically(options['report'], document(rows, of_links, command))
    return 1 if any(row.wrong for row in rows) or any(row.wrong for row in of_links) else 0


def _results(orders: list[Try], options: dict[str, Any], console: Console) -> Iterator[tuple[int, Row | NetworkRow]]:
    """Yield (index of the order, its row) as processes, or the workers of a Dask cluster, finish."""
    if options['scheduler'] is None or not orders:
        return unordered(tried, orders, options['jobs'])
    return on_cluster(tried, orders, options['scheduler'], lambda line: console.print(line, highlight=False))


def _read(path: Path, kind: Callable[..., R]) -> R:
    try:
        return kind(**json.loads(path.read_text(encoding='utf-8')))
    except (OSError, ValueError, TypeError) as error:
        raise ConfigurationError(f'{path}: {error}; remove it to try the fault again') from None


def _chosen(names: list[str] | None) -> list[Fault]:
    known = faults()
    for name in names or []:
        if name not in {fault.name for fault in known}:
            raise ConfigurationError(f"--fault '{name}'{nearest(name, [fault.name for fault in known])}")
    return [fault for fault in known if not names or fault.name in names]


def _file_name(order: Try) -> str:
    return ''.join(c if c.isalnum() else '_' for c in f'{order.fault}_{order.size or "network"}')


if __name__ == '__main__':
    sys.exit(main())
