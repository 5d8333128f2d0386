"""`drfmcw campaign`: faults against the nodes' own classes, counting ranges that are valid and wrong."""

import dataclasses
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from drfmcw_physics.settings import ConfigurationError, nearest
from drfmcw_ros.cli import Parser, guarded, write_atomically
from drfmcw_ros.processes import WorkFailed, unordered

from .faults import Fault, faults
from .measuring import Counts, cases, measure
from .report import Row, document, table

_QUICK, _FULL = 100, 2000  # sweeps with the fault, per case


@dataclasses.dataclass(frozen=True)
class _Try:
    """One fault to try, by name, since functions do not reach another process."""

    fault: str
    size: str
    sweeps: int
    seed: int


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
    parser.add_argument('--seed', type=int, default=1, help='of all random numbers')
    arguments = parser.parse_args(argv)
    return guarded(parser.prog, lambda: _run(arguments, Console(stderr=True)))


def _run(arguments: object, console: Console) -> int:
    options = vars(arguments)
    chosen = _chosen(options['fault'])
    if options['jobs'] < 1:
        raise ConfigurationError(f'--jobs {options["jobs"]}: at least 1')
    sweeps = _QUICK if options['quick'] else _FULL
    directory = Path(options['out'])
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f'--out {directory}: {error.strerror}') from None
    paths = [directory / f'{_file_name(fault)}_{sweeps}_{options["seed"]}.json' for fault in chosen]
    missing = [number for number, path in enumerate(paths) if not path.exists()]
    tries = [_Try(chosen[number].name, chosen[number].size, sweeps, options['seed']) for number in missing]
    try:
        for number, row in unordered(_row, tries, options['jobs']):
            write_atomically(paths[missing[number]], json.dumps(dataclasses.asdict(row)) + '\n')
            console.print(f'{row.fault}, {row.size}: {row.wrong} of {row.sweeps} wrong', highlight=False)
    except WorkFailed as error:
        raise ConfigurationError(f'a worker process died ({error}); call again to resume') from None
    rows = [_read(path) for path in paths]
    print(table(rows))
    if options['report']:
        command = f'./drfmcw campaign{" --quick" * options["quick"]} --seed {options["seed"]}'
        write_atomically(options['report'], document(rows, command))
    return 1 if any(row.wrong for row in rows) else 0


def _read(path: Path) -> Row:
    try:
        return Row(**json.loads(path.read_text(encoding='utf-8')))
    except (OSError, ValueError, TypeError) as error:
        raise ConfigurationError(f'{path}: {error}; remove it to try the fault again') from None


def _chosen(names: list[str] | None) -> list[Fault]:
    known = faults()
    for name in names or []:
        if name not in {fault.name for fault in known}:
            raise ConfigurationError(f"--fault '{name}'{nearest(name, [fault.name for fault in known])}")
    return [fault for fault in known if not names or fault.name in names]


def _row(order: _Try) -> Row:
    """Try a fault at all distances."""
    fault = next(fault for fault in faults() if (fault.name, fault.size) == (order.fault, order.size))
    found: list[Counts] = [measure(case) for case in cases(fault, order.sweeps, order.seed)]
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
    return ''.join(c if c.isalnum() else '_' for c in f'{fault.name}_{fault.size}')


if __name__ == '__main__':
    sys.exit(main())
