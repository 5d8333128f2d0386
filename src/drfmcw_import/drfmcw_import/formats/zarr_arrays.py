"""Zarr."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from drfmcw_physics.settings import ConfigurationError, parameter

from .base import Format, Source, largest_array, missing_library


@dataclasses.dataclass(frozen=True)
class ZarrOptions:
    """Options of zarr stores."""

    array: str = parameter('', description='path of the array in the store; needed where it holds several')


def _arrays(group: Any, prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield (path, array) of all arrays of numbers in a group and the groups below it."""
    for name, array in group.arrays():
        if array.dtype.kind in 'iufc' and array.ndim:
            yield prefix + name, array
    for name, below in group.groups():
        yield from _arrays(below, f'{prefix}{name}/')


class ZarrFormat(Format):
    """A directory, as xapres writes it for ApRES; versions 2 and 3, as the installed library reads them."""

    name = 'zarr'
    title = 'zarr `.zarr`'
    suffixes = ('.zarr',)
    options = ZarrOptions

    def sources(self, paths: Sequence[Path]) -> Iterator[Source]:
        """Yield each store's array."""
        for path in paths:
            try:
                import zarr
            except ImportError:
                raise missing_library(path, 'zarr') from None
            try:
                content: Any = zarr.open(str(path), mode='r')
            except Exception as error:  # zarr raises what its store, codecs and metadata meet
                raise ConfigurationError(f'{path}: no zarr store ({error})') from None
            if hasattr(content, 'shape'):
                yield Source(content, str(path))
                continue
            found = dict(_arrays(content))
            key = largest_array({k: v.shape for k, v in found.items()}, self.chosen.array, path)
            yield Source(found[key], f'{path}: {key}')
