"""Readings of a frequency counter, typed or from a CSV file."""

import csv
import dataclasses
import math
import re
from collections.abc import Sequence
from pathlib import Path

from drfmcw_physics.settings import ConfigurationError, nearest, read_text

CLOCKS = ('reference', 'adc')
_COLUMNS = ('clock', 'frequency', 'temperature', 'std')
_TYPED = re.compile(r'(?P<clock>\w+):(?P<frequency>[^@]+)(@(?P<temperature>.+))?')
_FARTHEST = 500.0  # of a clock from its nominal frequency: what StationCalibration can hold [ppm]


@dataclasses.dataclass(frozen=True)
class Reading:
    """One reading of one clock of a station."""

    clock: str  # one of CLOCKS
    frequency: float  # [Hz]
    temperature: float  # of the board [degC]
    std: float = math.nan  # one standard deviation [Hz]; NaN: that of the counter


def typed(text: str, temperature: float) -> Reading:
    """Return the reading that `CLOCK:FREQUENCY[@TEMPERATURE]` states, as `reference:100.0037e6@25` [Hz, degC].

    Args:
        text: as typed.
        temperature: of the board where the text gives none [degC].

    Raises:
        ConfigurationError: not of that form, or an unknown clock.
    """
    found = _TYPED.fullmatch(text.strip())
    if found is None:
        raise ConfigurationError(f"--reading '{text}': expected CLOCK:FREQUENCY@TEMPERATURE, as reference:100e6@25")
    where = f"--reading '{text}'"
    board = temperature if found['temperature'] is None else _number(found['temperature'], where, 'temperature')
    return Reading(_clock(found['clock'], where), _number(found['frequency'], where, 'frequency'), board)


def read_csv(path: Path | str) -> list[Reading]:
    """Return the readings of a CSV file: columns clock, frequency [Hz], temperature [degC] and perhaps std [Hz].

    Raises:
        ConfigurationError: the file cannot be read, lacks a column, or a line holds something else.
    """
    rows = csv.DictReader(line for line in read_text(path).splitlines() if line.strip() and not line.startswith('#'))
    names = [name.strip() for name in rows.fieldnames or ()]
    for name in names:
        if name not in _COLUMNS:
            raise ConfigurationError(f"{path}: unknown column '{name}'{nearest(name, _COLUMNS)}")
    for name in _COLUMNS[:3]:
        if name not in names:
            raise ConfigurationError(f"{path}: column '{name}' is missing; expected {', '.join(_COLUMNS)}")
    readings = []
    for number, row in enumerate(rows, 1):
        where = f'{path}: reading {number}'
        cells = {str(key).strip(): (value or '').strip() for key, value in row.items() if not isinstance(value, list)}
        values = {name: _number(cells.get(name, ''), where, name) for name in ('frequency', 'temperature')}
        std = _number(cells['std'], where, 'std') if cells.get('std') else math.nan
        readings.append(Reading(_clock(cells.get('clock', ''), where), **values, std=std))
    if not readings:
        raise ConfigurationError(f'{path}: holds no reading')
    return readings


def deviations(readings: Sequence[Reading], clock: str, nominal: float) -> tuple[list[float], list[float], list[float]]:
    """Return frequency over nominal minus one [1], board temperature [degC] and standard deviation [1] of one clock.

    Raises:
        ConfigurationError: a reading is no reading of that clock: another unit, another clock.
    """
    own = [reading for reading in readings if reading.clock == clock]
    for reading in own:
        off = (reading.frequency / nominal - 1.0) * 1e6
        if not abs(off) <= _FARTHEST:
            raise ConfigurationError(
                f'a reading of {reading.frequency:.10g} Hz is {off:+.4g} ppm off the nominal {nominal:.10g} Hz of the '
                f'{clock} clock; {_FARTHEST:g} ppm are plausible (--{clock}-nominal sets the nominal frequency)'
            )
        if reading.std <= 0.0:
            raise ConfigurationError(f'a reading of the {clock} clock has the standard deviation {reading.std:g} Hz')
    return (
        [(reading.frequency - nominal) / nominal for reading in own],
        [reading.temperature for reading in own],
        [reading.std / nominal for reading in own],
    )


def _clock(name: str, where: str) -> str:
    if name not in CLOCKS:
        raise ConfigurationError(f"{where}: unknown clock '{name}'{nearest(name, CLOCKS)}")
    return name


def _number(text: str, where: str, name: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ConfigurationError(f"{where}: {name} '{text}' is no number") from None
    if not math.isfinite(value):
        raise ConfigurationError(f"{where}: {name} '{text}' is no number")
    return value
