"""MATLAB .mat: version 5 by SciPy, version 7.3 (which is HDF5) by h5py."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import scipy.io

from drfmcw_physics.settings import ConfigurationError, parameter

from .base import Array, Format, Source, largest_array
from .hdf5 import datasets, opened

_HDF5 = b'\x89HDF\r\n\x1a\n'


@dataclasses.dataclass(frozen=True)
class MatlabOptions:
    """Options of MATLAB files."""

    array: str = parameter('', description='name of the variable; needed where the file holds several')


@dataclasses.dataclass(frozen=True)
class Reversed:
    """A dataset whose axes count in MATLAB's order, which HDF5 stores reversed."""

    stored: Any

    @property
    def shape(self) -> tuple[int, ...]:
        """Sizes as MATLAB shows them."""
        return tuple(self.stored.shape[::-1])

    @property
    def dtype(self) -> Any:
        """Type of the numbers."""
        return self.stored.dtype

    def __getitem__(self, key: tuple[slice, ...]) -> Any:
        """Return a part."""
        return self.stored[key[::-1]].T


class MatlabFormat(Format):
    """Axes count as MATLAB shows them in both versions; version 7.3 is read piece by piece, version 5 at once."""

    name = 'matlab'
    title = 'MATLAB `.mat`, version 5 and 7.3'
    suffixes = ('.mat',)
    options = MatlabOptions

    def sources(self, paths: Sequence[Path]) -> Iterator[Source]:
        """Yield each file's variable."""
        for path in paths:
            try:
                with open(path, 'rb') as file:
                    start = file.read(1024)
            except OSError as error:
                raise ConfigurationError(f'{path}: {error.strerror}') from None
            if _HDF5 in start:
                with opened(path) as content:
                    key = largest_array(
                        {k: v.shape[::-1] for k, v in datasets(content).items()}, self.chosen.array, path
                    )
                    yield Source(Reversed(content[key]), f'{path}: {key}')
            else:
                yield self._version_5(path)

    def _version_5(self, path: Path) -> Source:
        try:
            shapes = {
                name: shape for name, shape, kind in scipy.io.whosmat(path) if kind not in ('cell', 'struct', 'char')
            }
            key = largest_array(shapes, self.chosen.array, path)
            array: Array = scipy.io.loadmat(path, variable_names=[key])[key]
        except ConfigurationError:
            raise
        except Exception as error:  # SciPy raises what its parser meets
            raise ConfigurationError(f'{path}: no MATLAB file ({error})') from None
        return Source(array, f'{path}: {key}')
