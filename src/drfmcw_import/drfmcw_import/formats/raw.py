"""Raw numbers without a header: .bin, .dat, .raw."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError, parameter

from .base import Format, Numbers, Source

TYPES = ('int8', 'uint8', 'int16', 'uint16', 'int32', 'uint32', 'float32', 'float64')


@dataclasses.dataclass(frozen=True)
class RawOptions:
    """Options of raw files."""

    type: str = parameter('int16', choices=TYPES, description='type of the numbers')
    byte_order: str = parameter('little', choices=('little', 'big'), description='which byte comes first')
    header_bytes: int = parameter(0, unit='B', bounds=(0, 1e12), description='bytes before the first number, skipped')
    columns: int = parameter(
        0, bounds=(0, 4096), description='numbers that belong to one instant, as a second axis; 0: one axis only'
    )


def mapped(path: Path, dtype: Any, header_bytes: int = 0, columns: int = 0) -> Numbers:
    """Return the numbers of a raw file as a memory map, (n,) or (n / columns, columns).

    Raises:
        ConfigurationError: the file cannot be read, is empty, or its size does not fit.
    """
    dtype = np.dtype(dtype)
    try:
        size = path.stat().st_size - header_bytes
    except OSError as error:
        raise ConfigurationError(f'{path}: {error.strerror}') from None
    row = dtype.itemsize * max(columns, 1)
    if size <= 0:
        raise ConfigurationError(f'{path}: holds nothing behind its first {header_bytes} bytes')
    if size % row:
        raise ConfigurationError(
            f'{path}: {size} bytes are no multiple of {row}, the size of one row of {dtype} numbers'
        )
    shape = (size // row, columns) if columns else (size // row,)
    try:
        return np.memmap(path, dtype, 'r', header_bytes, shape)
    except OSError as error:
        raise ConfigurationError(f'{path}: {error.strerror}') from None


class RawFormat(Format):
    """The file is mapped, whatever its size."""

    name = 'raw'
    title = 'raw integers or floats `.bin`, `.raw`'
    suffixes = ('.bin', '.raw')
    options = RawOptions

    def sources(self, paths: Sequence[Path]) -> Iterator[Source]:
        """Yield each file's numbers."""
        order = '<' if self.chosen.byte_order == 'little' else '>'
        dtype = np.dtype(self.chosen.type).newbyteorder(order)
        for path in paths:
            yield Source(mapped(path, dtype, self.chosen.header_bytes, self.chosen.columns), str(path))
