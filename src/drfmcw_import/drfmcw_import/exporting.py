"""`export RECORDING --out FILE`: a recording's sweeps as NumPy (.npz), CSV or Parquet."""

import argparse
import os
import sys
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError, nearest
from drfmcw_ros.bag.files import BagError, BagReader
from drfmcw_ros.bag.options import add_damage_option
from drfmcw_ros.commands.cli import Parser, guarded
from drfmcw_ros.graph.messages import stamp_ns

from .look.sweeps import messages, stations

_BATCH = 256  # sweeps written at once


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    result: argparse.ArgumentParser = Parser(prog='drfmcw export', description=__doc__)
    result.add_argument('recording', help='rosbag2 recording: directory, .mcap or .db3 file')
    add_damage_option(result)
    result.add_argument('--out', required=True, metavar='FILE', help='.npz, .csv or .parquet: its name says the format')
    result.add_argument('--station', metavar='NAME', help='only this station')
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    arguments = parser().parse_args(argv)
    status: int = guarded('drfmcw export', lambda: _run(arguments))
    return status


def _run(arguments: argparse.Namespace) -> None:
    count = export(arguments.recording, Path(arguments.out), arguments.station)
    print(f'{count} sweeps: {arguments.out}')


def export(recording: str, out: Path, station: str | None = None) -> int:
    """Write the sweeps of a recording into a file; return their number.

    Raises:
        ConfigurationError: unknown suffix or station, an unreadable recording, missing library or unwritable target.
    """
    if out.suffix not in _WRITERS:
        raise ConfigurationError(f"{out}: '{out.suffix}' is no format of export{nearest(out.suffix, list(_WRITERS))}")
    with BagReader(recording) as bag:
        known = stations(bag)
        if station is not None and station not in known:
            raise BagError(f"{recording}: unknown station '{station}'{nearest(station, known)}")
        return _atomically(out, lambda file: _WRITERS[out.suffix](bag, [station] if station else known, file))


def _atomically(out: Path, write: Callable[[IO[bytes]], int]) -> int:
    """Write a file under a temporary name in the same folder, and rename it when it is complete."""
    partial = None
    try:
        with tempfile.NamedTemporaryFile(dir=out.parent, prefix=f'.{out.name}.', delete=False) as file:
            partial = Path(file.name)
            count = write(file)
        partial.chmod(0o644)
        os.replace(partial, out)
        return count
    except OSError as error:
        raise ConfigurationError(f'{out}: {error.strerror or error}') from None
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)


def _samples(message: Any) -> np.ndarray[Any, Any]:
    """Return (N, 1 or 2) codes of a message."""
    return np.asarray(message.samples, np.int16).reshape(-1, 2 if message.iq else 1)


def _npz(bag: BagReader, names: Sequence[str], file: IO[bytes]) -> int:
    """Write arrays `<station>_samples` (n, N) or (n, N, 2), `_stamp` [ns], `_sweep_id`, `_full_scale`, `_settings`."""
    total = 0
    with zipfile.ZipFile(file, 'w', zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            count = next(c.msgcount for c in bag.connections if c.topic == f'/{name}/if_samples')
            stamps, numbers, scales, shape = [], [], [], None
            with archive.open(f'{name}_samples.npy', 'w', force_zip64=True) as member:
                for message in messages(bag, name):
                    codes = _samples(message)
                    if shape is None:
                        shape = codes.shape
                        size = (count, shape[0]) if shape[1] == 1 else (count, *shape)
                        header = {'descr': '<i2', 'fortran_order': False, 'shape': size}
                        np.lib.format.write_array_header_1_0(member, header)
                    if codes.shape != shape:
                        raise BagError(f"{bag.path}: sweeps of '{name}' differ in length: export as .csv or .parquet")
                    member.write(codes.astype('<i2').tobytes())
                    stamps.append(stamp_ns(message.header.stamp))
                    numbers.append(message.sweep_id)
                    scales.append(message.full_scale)
                if shape is None:
                    np.lib.format.write_array(member, np.empty((0, 0), '<i2'))
            for key, values, kind in (
                ('stamp', stamps, np.int64),
                ('sweep_id', numbers, np.uint64),
                ('full_scale', scales, float),
            ):
                with archive.open(f'{name}_{key}.npy', 'w') as member:
                    np.lib.format.write_array(member, np.array(values, kind))
            total += len(stamps)
    return total


def _csv(bag: BagReader, names: Sequence[str], file: IO[bytes]) -> int:
    """Write a line per sample: station, sweep_id, stamp [ns], sample, i and q [LSB]; no q of real samples."""
    file.write(b'station,sweep_id,stamp,sample,i,q\n')
    total = 0
    for name in names:
        for message in messages(bag, name):
            codes = _samples(message)
            start = f'{name},{message.sweep_id},{stamp_ns(message.header.stamp)}'
            rows = codes.tolist()
            q = [r[1] for r in rows] if message.iq else [''] * len(rows)
            lines = (f'{start},{n},{row[0]},{other}\n' for n, (row, other) in enumerate(zip(rows, q, strict=True)))
            file.write(''.join(lines).encode())
            total += 1
    return total


def _parquet(bag: BagReader, names: Sequence[str], file: IO[bytes]) -> int:
    """Write a row per sweep: station, sweep_id, stamp [ns], full_scale [LSB], iq, samples (I, Q alternate) [LSB]."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ConfigurationError(
            'writing Parquet needs the Python package pyarrow, which is not installed: export as .npz or .csv'
        ) from None
    schema = pyarrow.schema(
        [
            ('station', pyarrow.string()),
            ('sweep_id', pyarrow.uint64()),
            ('stamp', pyarrow.int64()),
            ('full_scale', pyarrow.float64()),
            ('iq', pyarrow.bool_()),
            ('samples', pyarrow.list_(pyarrow.int16())),
        ]
    )
    total = 0
    with pyarrow.parquet.ParquetWriter(file, schema) as writer:
        rows: list[dict[str, Any]] = []
        for name in names:
            for message in messages(bag, name):
                rows.append(
                    {
                        'station': name,
                        'sweep_id': message.sweep_id,
                        'stamp': stamp_ns(message.header.stamp),
                        'full_scale': message.full_scale,
                        'iq': message.iq,
                        'samples': np.asarray(message.samples),
                    }
                )
                total += 1
                if len(rows) >= _BATCH:
                    writer.write_table(pyarrow.Table.from_pylist(rows, schema))
                    rows.clear()
        writer.write_table(pyarrow.Table.from_pylist(rows, schema))
    return total


_WRITERS: dict[str, Callable[[BagReader, Sequence[str], IO[bytes]], int]] = {
    '.npz': _npz,
    '.csv': _csv,
    '.parquet': _parquet,
}


if __name__ == '__main__':
    sys.exit(main())
