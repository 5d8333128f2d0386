"""What every file format offers, and the register of formats."""

import abc
import dataclasses
import importlib
import pkgutil
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np

from drfmcw_physics.settings import ConfigurationError, nearest

Numbers = np.ndarray[Any, Any]


class Array(Protocol):
    """What is read piece by piece: a memory map, a dataset of HDF5 or zarr, or a class of a format's own."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Size of each axis."""

    @property
    def dtype(self) -> Any:
        """Type of the numbers; a structure of two fields counts as complex."""

    def __getitem__(self, key: Any, /) -> Any:
        """Return the part that a tuple of slices selects."""


@dataclasses.dataclass(frozen=True)
class Source:
    """One file, opened."""

    array: Array
    name: str  # of the file, and of the array in it
    times: Numbers | None = None  # start of each sweep since the file's first, where the file states it [s]
    notes: tuple[str, ...] = ()  # what was found in the file, one sentence each


class Format(abc.ABC):
    """One file format; a subclass registers itself under its `name`."""

    name: ClassVar[str]
    title: ClassVar[str]  # one line for the documentation
    suffixes: ClassVar[tuple[str, ...]] = ()  # of files that are taken for this format without being asked
    options: ClassVar[type]  # frozen dataclass of declared settings: the section `options` of the settings file
    registered: ClassVar[dict[str, 'type[Format]']] = {}

    def __init_subclass__(cls) -> None:
        Format.registered[cls.name] = cls

    def __init__(self, options: Any) -> None:
        """Take the options, an instance of `options`."""
        self.chosen = options

    @classmethod
    def takes(cls, paths: Sequence[Path]) -> bool:
        """Return True where the files' names say that they are of this format."""
        return all(path.suffix.lower() in cls.suffixes for path in paths)

    def facts(self, paths: Sequence[Path]) -> dict[str, dict[str, Any]]:
        """Return the settings that the files state or the format fixes, {section: {key: value}}.

        Raises:
            ConfigurationError: the files are not of this format.
        """
        return {}

    def sizes(self, paths: Sequence[Path]) -> dict[str, int]:
        """Return how many of each axis the files state beside their numbers, {axis: size}.

        Raises:
            ConfigurationError: the files are not of this format.
        """
        return {}

    @abc.abstractmethod
    def sources(self, paths: Sequence[Path]) -> Iterable[Source]:
        """Yield the arrays of the files, in order.

        Raises:
            ConfigurationError: a file cannot be read; the message names it.
        """


def known_formats() -> dict[str, type[Format]]:
    """Return {name: format} of every module in this room."""
    package = __name__.rpartition('.')[0]
    for module in pkgutil.iter_modules(importlib.import_module(package).__path__):
        importlib.import_module(f'{package}.{module.name}')
    return dict(sorted(Format.registered.items()))


def choose_format(name: str, paths: Sequence[Path]) -> type[Format]:
    """Return the format named, or the one that the files' names mean.

    Raises:
        ConfigurationError: no such format, or none takes all of the files.
    """
    formats = known_formats()
    if name:
        if name not in formats:
            raise ConfigurationError(f"format: '{name}' is not valid{nearest(name, list(formats))}")
        return formats[name]
    for path in paths:
        if not path.exists():
            raise ConfigurationError(f'{path}: no such file')
    for candidate in formats.values():
        if candidate.takes(paths):
            return candidate
    raise ConfigurationError(
        f"{paths[0]}: its name does not say its format: set 'format' to one of {', '.join(formats)}"
    )


def missing_library(path: Path, library: str) -> ConfigurationError:
    """Return the error for a format whose library is not installed."""
    return ConfigurationError(f'{path}: reading this format needs the Python package {library}, which is not installed')


def spooled(blocks: Iterable[Numbers], columns: int, dtype: Any) -> Numbers:
    """Return rows that do not lie in the file as they are needed, kept on disk and not in memory.

    Args:
        blocks: (rows, columns) each.
        columns: of every block.
        dtype: to keep them in.

    Returns:
        (rows, columns); (rows,) where there is one column.
    """
    with tempfile.TemporaryFile(prefix='drfmcw-import-') as file:
        rows = 0
        for block in blocks:
            np.ascontiguousarray(block, dtype).tofile(file)
            rows += len(block)
        file.flush()
        shape = (rows,) if columns == 1 else (rows, columns)
        if rows == 0:
            return np.empty(shape, dtype)
        return np.memmap(file, dtype, 'r', shape=shape)


def largest_array(arrays: dict[str, tuple[int, ...]], wanted: str, path: Path) -> str:
    """Return the name of the array to read: the one that is wanted, or the only one of the largest size.

    Args:
        arrays: {name: shape} of the numeric ones.
        wanted: name from the options, '' for none.
        path: of the file, for the message.

    Raises:
        ConfigurationError: none, no such array, or several that could be meant.
    """
    if not arrays:
        raise ConfigurationError(f'{path}: holds no array of numbers')
    if wanted:
        if wanted not in arrays:
            raise ConfigurationError(f"{path}: no array '{wanted}'{nearest(wanted, list(arrays))}")
        return wanted
    if len(arrays) > 1:
        listed = ', '.join(f'{name} {"x".join(map(str, shape))}' for name, shape in arrays.items())
        raise ConfigurationError(f'{path}: holds several arrays, set options: array to one of them: {listed}')
    return next(iter(arrays))
