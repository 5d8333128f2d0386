"""NumPy: .npy and .npz."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from drfmcw_physics.settings import ConfigurationError, parameter

from .base import Format, Source, largest_array


@dataclasses.dataclass(frozen=True)
class NumpyOptions:
    """Options of NumPy files."""

    array: str = parameter('', description='name of the array in an .npz file; needed where it holds several')


class NumpyFormat(Format):
    """.npy files are mapped, whatever their size; an array of an .npz file is read into memory."""

    name = 'numpy'
    title = 'NumPy `.npy`, `.npz`'
    suffixes = ('.npy', '.npz')
    options = NumpyOptions

    def sources(self, paths: Sequence[Path]) -> Iterator[Source]:
        """Yield each file's array."""
        for path in paths:
            try:
                content = np.load(path, mmap_mode='r', allow_pickle=False)
                if isinstance(content, np.ndarray):
                    yield Source(content, str(path))
                    continue
                with content:
                    shapes = {key: content[key].shape for key in content.files if content[key].dtype.kind in 'iufc'}
                    key = largest_array(shapes, self.chosen.array, path)
                    yield Source(content[key], f'{path}: {key}')
            except (OSError, ValueError, EOFError, KeyError) as error:
                if isinstance(error, ConfigurationError):
                    raise
                raise ConfigurationError(f'{path}: no NumPy file ({error})') from None
