"""Text: CSV, TSV, columns separated by white space."""

import dataclasses
import itertools
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np

from drfmcw_physics.settings import ConfigurationError, parameter

from .base import Format, Numbers, Source, spooled

_LINES = 1 << 16  # parsed at once


@dataclasses.dataclass(frozen=True)
class TextOptions:
    """Options of text files."""

    delimiter: str = parameter(
        'auto', choices=('auto', 'comma', 'semicolon', 'tab', 'space'), description='what separates the columns'
    )
    decimal_comma: bool = parameter(False, description='numbers are written 0,5 and not 0.5')
    columns: list[int] = parameter([], bounds=(0, 4095), description='columns to read, counted from 0; empty: all')
    skip_lines: int = parameter(
        0, bounds=(0, 1e9), description='lines at the beginning to skip; those without a number are skipped anyhow'
    )


_SEPARATORS: dict[str, str | None] = {'comma': ',', 'semicolon': ';', 'tab': '\t', 'space': None}


def _separator(line: str, options: TextOptions) -> str | None:
    if options.delimiter != 'auto':
        return _SEPARATORS[options.delimiter]
    for name in ('tab', 'semicolon', 'comma'):
        separator = _SEPARATORS[name]
        if separator is not None and separator in line and not (separator == ',' and options.decimal_comma):
            return separator
    return None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


class TextFormat(Format):
    """Lines are parsed in pieces and kept as numbers on disk; what begins with # or holds no number is skipped."""

    name = 'text'
    title = 'text `.csv`, `.tsv`, `.txt`'
    suffixes = ('.csv', '.tsv', '.txt', '.asc')
    options = TextOptions

    def sources(self, paths: Sequence[Path]) -> Iterator[Source]:
        """Yield each file's numbers, (rows, columns) or (rows,)."""
        for path in paths:
            try:
                with open(path, encoding='utf-8-sig') as file:
                    yield Source(self._read(file, path), str(path))
            except OSError as error:
                raise ConfigurationError(f'{path}: {error.strerror}') from None
            except UnicodeDecodeError:
                raise ConfigurationError(f'{path}: no text file') from None

    def _read(self, file: TextIO, path: Path) -> Numbers:
        lines = (self._point(line) for line in itertools.islice(file, self.chosen.skip_lines, None))
        first, number = '', self.chosen.skip_lines
        for first in lines:
            number += 1
            words = re.split(r'[\s,;]+', first.strip())
            if words[0] and not first.lstrip().startswith('#') and all(_is_number(w) for w in words if w):
                break
        else:
            raise ConfigurationError(f'{path}: holds no line of numbers')
        separator = _separator(first, self.chosen)
        blocks = self._blocks(itertools.chain([first], lines), separator, path, number)
        head = next(blocks)
        return spooled(itertools.chain([head], blocks), head.shape[1], np.float64)

    def _point(self, line: str) -> str:
        return line.replace(',', '.') if self.chosen.decimal_comma else line

    def _blocks(self, lines: Iterator[str], separator: str | None, path: Path, number: int) -> Iterator[Numbers]:
        """Yield parsed pieces of the file; `number` is that of the first line."""
        columns = self.chosen.columns or None
        while piece := list(itertools.islice(lines, _LINES)):
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter('ignore')  # a piece of nothing but empty lines
                    block = np.loadtxt(piece, delimiter=separator, usecols=columns, ndmin=2)
            except (ValueError, IndexError) as error:
                reason = str(error).split(';')[0]
                raise ConfigurationError(f'{path}: lines from {number} on: {reason}') from None
            if block.size:
                yield block
            number += len(piece)
