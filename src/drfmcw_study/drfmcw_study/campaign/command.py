"""`drfmcw campaign`: faults against the nodes' own classes, counting ranges that are valid and wrong."""

import argparse
import concurrent.futures
import dataclasses
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

from rich.console import Console

from drfmcw_physics.settings import ConfigurationError, nearest
from drfmcw_ros.cli import Parser, guarded, write_atomically

from .faults import Fault, faults
from .fuzz import fuzz, summary
from .fuzz_targets import targets
from .measuring import Counts, cases, measure
from .network import NETWORK_SWEEPS, NetworkRow, network_row, network_table, networks
from .report import Row, document, table

R = TypeVar('R')

_QUICK, _FULL = 100, 2000  # sweeps with the fault, per case


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 1 where a range was valid and wrong."""
    parser = Parser(prog='drfmcw campaign', description=__doc__)
    parser.add_argument('--quick', action='store_true', help=f'{_QUICK} sweeps per case instead of {_FULL}')
    parser.add_argument('--fault', action='append', metavar='NAME', help='only this fault (repeatable)')
    parser.add_argument('--out', metavar='DIR', default='campaign', help='results; what is there is not tried again')
    parser.add_argument('--report', metavar='FILE', help='write the report, as docs/reliability.md')
    parser.add_argument('--jobs', type=int, default=os.cpu_count() or 1, metavar='N', help='processes (all cores)')
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
    chosen = _chosen(options['fault'])
    links = [] if options['fault'] else networks()
    if options['jobs'] < 1:
        raise ConfigurationError(f'--jobs {options["jobs"]}: at least 1')
    sweeps = _QUICK if options['quick'] else _FULL
    directory = _made(options['out'])
    rows: list[Row] = []
    of_links: list[NetworkRow] = []
    with concurrent.futures.ProcessPoolExecutor(options['jobs']) as pool:
        paths = [directory / f'{_file_name(fault)}_{sweeps}_{options["seed"]}.json' for fault in chosen]
        tried = {
            number: pool.submit(_row, fault.name, fault.size, sweeps, options['seed'])
            for number, (fault, path) in enumerate(zip(chosen, paths, strict=True))
            if not path.exists()
        }
        link_paths = [directory / f'network_{_plain(link.name)}_{sweeps}_{options["seed"]}.json' for link in links]
        linked = {
            number: pool.submit(network_row, link, max(sweeps, NETWORK_SWEEPS), options['seed'])
            for number, (link, path) in enumerate(zip(links, link_paths, strict=True))
            if not path.exists()
        }
        for number, path in enumerate(paths):
            row = _kept(path, Row, tried.get(number))
            rows.append(row)
            console.print(f'{row.fault}, {row.size}: {row.wrong} of {row.sweeps} wrong', highlight=False)
        for number, path in enumerate(link_paths):
            of_link = _kept(path, NetworkRow, linked.get(number))
            of_links.append(of_link)
            console.print(f'{of_link.name}: {of_link.wrong} of {of_link.sweeps} wrong', highlight=False)
    print(table(rows))
    if of_links:
        print(network_table(of_links))
    if options['report']:
        command = f'./drfmcw campaign{" --quick" * options["quick"]} --seed {options["seed"]}'
        write_atomically(options['report'], document(rows, of_links, command))
    return 1 if any(row.wrong for row in rows) or any(row.wrong for row in of_links) else 0


def _kept(path: Path, kind: Callable[..., R], tried: 'concurrent.futures.Future[R] | None') -> R:
    """Return a row as it was found before, or as it is found now, and keep it."""
    if tried is None:
        return _read(path, kind)
    row = tried.result()
    write_atomically(path, json.dumps(dataclasses.asdict(cast(Any, row))) + '\n')
    return row


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


def _row(name: str, size: str, sweeps: int, seed: int) -> Row:
    """Try a fault; by name, since functions do not reach another process."""
    fault = next(fault for fault in faults() if (fault.name, fault.size) == (name, size))
    found: list[Counts] = [measure(case) for case in cases(fault, sweeps, seed)]
    return Row(
        fault.name,
        fault.size,
        sum(c.sweeps for c in found),
        sum(c.valid for c in found),
        sum(c.wrong for c in found),
        sum(c.beyond for c in found),
        max(c.undetected for c in found),
        max(c.worst for c in found),
    )


def _file_name(fault: Fault) -> str:
    return _plain(f'{fault.name}_{fault.size}')


def _plain(text: str) -> str:
    return ''.join(c if c.isalnum() else '_' for c in text)


if __name__ == '__main__':
    sys.exit(main())
