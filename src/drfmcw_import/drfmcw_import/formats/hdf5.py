"""HDF5."""

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from drfmcw_physics.settings import ConfigurationError, parameter

from .base import Format, Source, largest_array, missing_library


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open an HDF5 file.

    Raises:
        ConfigurationError: h5py is not installed, or the file cannot be read.
    """
    try:
        import h5py
    except ImportError:
        raise missing_library(path, 'h5py') from None
    try:
        file = h5py.File(path, 'r')
    except OSError as error:
        raise ConfigurationError(f'{path}: no HDF5 file ({error})') from None
    with file:
        yield file


def datasets(file: Any) -> dict[str, Any]:
    """Return {path in the file: dataset} of all that hold numbers, MATLAB's references left out."""
    found: dict[str, Any] = {}

    def take(name: str, item: Any) -> None:
        kind = getattr(getattr(item, 'dtype', None), 'kind', '')
        if kind and kind in 'iufcV' and item.ndim and not name.startswith('#'):
            found[name] = item

    file.visititems(take)
    return found


@dataclasses.dataclass(frozen=True)
class Hdf5Options:
    """Options of HDF5 files."""

    array: str = parameter('', description='path of the dataset in the file; needed where it holds several')


class Hdf5Format(Format):
    """Datasets are read piece by piece; complex ones may be structures of two fields."""

    name = 'hdf5'
    title = 'HDF5 `.h5`, `.hdf5`'
    suffixes = ('.h5', '.hdf5', '.hdf', '.nc')
    options = Hdf5Options

    def sources(self, paths: Sequence[Path]) -> Iterator[Source]:
        """Yield each file's dataset."""
        for path in paths:
            with opened(path) as file:
                found = datasets(file)
                key = largest_array({k: v.shape for k, v in found.items()}, self.chosen.array, path)
                yield Source(found[key], f'{path}: {key}')
