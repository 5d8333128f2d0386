"""Measured remainder: what no effect explains of a recording, as smooth curves that are simulated but are no physics.

A file holds terms. A term is one quantity of a station or of the path over the time in the sweep or the IF frequency,
and over one covariate (distance, IF frequency of the line, board temperature, time) between the values of which it is
interpolated linearly; beyond them it stays as at the nearest. The format is that of numpy's npz, see
docs/diagnosis.md.
"""

import dataclasses
import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Role
from drfmcw_ros.commands.cli import write_atomically

from ..effects import ActsOn, Effect, Stage
from ..measurements import Measurements, Response, Station

FORMAT = 'drfmcw measured remainder'
VERSION = 1

AXES = ('', 'range', 'if_frequency', 'board_temperature', 'time')
"""Covariates of a term, '' where it is the same in every sweep."""

STATION_QUANTITIES = ('log_amplitude', 'phase', 'gain', 'noise', 'random_power', 'background', 'background_q')
PATH_QUANTITIES = ('delay', 'start_delay')

UNITS = {
    'log_amplitude': 'Np',
    'phase': 'rad',
    'gain': 'dB',
    'noise': 'dB',
    'random_power': '1/Hz',
    'background': '1',
    'background_q': '1',
    'delay': 's',
    'start_delay': 's',
}
"""Of the values; powers and amplitudes without unit are relative to full scale."""

_OVER_SAMPLES = ('background', 'background_q')


@dataclasses.dataclass(frozen=True, eq=False)
class Term:
    """One quantity over a covariate (M,) and a grid (P,)."""

    quantity: str
    station: str  # '' of the path
    axis: str  # covariate, one of `AXES`
    axis_station: str  # whose line or board the covariate is of, '' for distance and time
    at: np.ndarray  # (M,) values of the covariate, increasing; one where axis is ''
    grid: np.ndarray  # (P,) time in the sweep [s] or IF frequency [Hz]; one 0 for a single number
    values: np.ndarray  # (M, P)

    def over(self, covariate: np.ndarray) -> np.ndarray:
        """Return the values at each of n values of the covariate (n, P)."""
        if len(self.at) == 1:
            return np.repeat(self.values, len(covariate), axis=0)
        place = np.interp(covariate, self.at, np.arange(len(self.at)))
        below = np.minimum(place.astype(int), len(self.at) - 2)
        share = (place - below)[:, None]
        result: np.ndarray = (1.0 - share) * self.values[below] + share * self.values[below + 1]
        return result


@dataclasses.dataclass(frozen=True, eq=False)
class MeasuredModel:
    """What was measured of one pair of stations."""

    stations: tuple[str, ...]  # (first, second), or the one that hears itself
    recording: str  # from which it was learnt
    terms: tuple[Term, ...]


def covariate(axis: str, station: str, m: Measurements) -> np.ndarray:
    """Return the value of a covariate in each of n measurements (n,).

    Args:
        axis: one of `AXES`.
        station: whose line or board is meant.
        m: the measurements.
    """
    if axis == 'range':
        return m.range
    if axis == 'time':
        return m.time
    if axis == '':
        return np.zeros(len(m))
    own = next(s for s in m.stations if s.name == station)
    if axis == 'board_temperature':
        return own.temperature
    return line_frequency(own, m)


def line_frequency(own: Station, m: Measurements) -> np.ndarray:
    """Return where a station's line stands after distance and T_off, its clocks left out (n,) [Hz]."""
    sweep = own.sweep
    delay = m.range * np.asarray(m.refractive_index) / SPEED_OF_LIGHT
    if sweep.hears_itself:
        return abs(sweep.chirp_rate) * delay
    sign = 1.0 if sweep.role == Role.FIRST else -1.0
    return np.abs(sweep.chirp_rate * (sweep.start_delay + sign * delay))


@dataclasses.dataclass(frozen=True)
class Measured(Effect, name='measured', registered=False):
    """What a recording holds beyond its model and its effects: measured, not physics."""

    acts_on = ActsOn.PHASE | ActsOn.AMPLITUDE | ActsOn.DELAY | ActsOn.SAMPLES | ActsOn.NOISE
    stage = Stage.GEOMETRY  # covariates follow the distance

    model: MeasuredModel
    noisy: bool = True  # draws the random power; the diagnosis predicts its mean instead

    def _acts(self, m: Measurements) -> bool:
        return tuple(s.name for s in m.stations) == self.model.stations

    def _terms(self, station: str, *quantities: str) -> list[Term]:
        return [t for t in self.model.terms if t.station == station and t.quantity in quantities]

    def prepare(self, m: Measurements) -> None:
        """Change delays and powers, and give each station its response."""
        if not self._acts(m):
            return
        found = {id(t): t.over(covariate(t.axis, t.axis_station, m)) for t in self.model.terms}
        for station in m.stations:
            for term in self._terms(station.name, 'gain'):
                station.received_power += found[id(term)][:, 0]
            for term in self._terms(station.name, 'noise'):
                station.noise_density += found[id(term)][:, 0]
            for term in self._terms(station.name, 'log_amplitude'):
                own = found[id(term)]
                station.responses = (*station.responses, Response(term.grid, own, np.zeros(own.shape)))
            for term in self._terms(station.name, 'phase'):
                own = found[id(term)]
                station.responses = (*station.responses, Response(term.grid, np.zeros(own.shape), own))
        for term in self._terms('', 'delay'):
            m.paths[0].delay += found[id(term)][:, 0]
        for term in self._terms('', 'start_delay'):
            m.start_delay += found[id(term)][:, 0]

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Add the background, which repeats, and the random power, which does not."""
        if not self._acts(m):
            return
        for term in self._terms(station.name, *_OVER_SAMPLES):
            target = signal if not station.iq else signal[..., int(term.quantity == 'background_q')]
            own = station.full_scale * term.over(covariate(term.axis, term.axis_station, m))
            target += own.astype(np.float32)
        if not self.noisy or not self._terms(station.name, 'random_power'):
            return
        count, rate = station.sweep.sample_count, station.sweep.sample_rate
        bins = np.arange(count // 2 + 1) * (rate / count)
        std = np.sqrt(self.random_power(station, m, bins) * rate * count * (0.5 if station.iq else 0.25))
        for row, generator in enumerate(streams()):
            deviates = generator.standard_normal((2, len(bins)))
            spectrum = std[row] * (deviates[0] + 1j * deviates[1])
            if station.iq:
                wave = np.fft.ifft(np.concatenate([spectrum, np.zeros(count - len(bins))]))
                signal[row] += np.stack([wave.real, wave.imag], axis=-1).astype(np.float32)
            else:
                signal[row] += np.fft.irfft(spectrum, count).astype(np.float32)

    def random_power(self, station: Station, m: Measurements, frequency: np.ndarray) -> np.ndarray:
        """Return the density of the random power at frequencies (B,) in each of n measurements (n, B) [LSB^2/Hz]."""
        total = np.zeros((len(m), len(frequency)))
        if self._acts(m):
            for term in self._terms(station.name, 'random_power'):
                own = term.over(covariate(term.axis, term.axis_station, m))
                total += [np.interp(frequency, term.grid, row) for row in own]
        return total * station.full_scale**2


# --- file ---


def write_measured(path: Path | str, model: MeasuredModel) -> None:
    """Write a model; the same model gives the same bytes.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    arrays: dict[str, Any] = {
        'format': np.array(FORMAT),
        'version': np.array(VERSION),
        'stations': np.array(model.stations),
        'recording': np.array(model.recording),
    }
    for field in ('quantity', 'station', 'axis', 'axis_station'):
        arrays[field] = np.array([getattr(t, field) for t in model.terms], dtype='U32')
    arrays['unit'] = np.array([UNITS[t.quantity] for t in model.terms], dtype='U8')
    for number, term in enumerate(model.terms):
        arrays |= {f'at_{number}': term.at, f'grid_{number}': term.grid, f'values_{number}': term.values}
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_atomically(path, content.getvalue())


def read_measured(path: Path | str) -> MeasuredModel:
    """Read a model.

    Raises:
        ConfigurationError: no such file, another format or version, or values that do not fit together.
    """
    try:
        with np.load(path, allow_pickle=False) as held:
            arrays = {name: held[name] for name in held.files}
    except FileNotFoundError:
        raise ConfigurationError(f'{path}: no such file') from None
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise ConfigurationError(f'{path}: not a measured remainder: {error}') from None
    if str(arrays.get('format')) != FORMAT:
        raise ConfigurationError(f"{path}: not a measured remainder: 'format' is not '{FORMAT}'")
    if int(arrays.get('version', 0)) != VERSION:
        raise ConfigurationError(f'{path}: version {arrays.get("version", 0)}; this program reads version {VERSION}')
    try:
        fields = zip(*(arrays[f].tolist() for f in ('quantity', 'station', 'axis', 'axis_station')), strict=True)
        terms = tuple(
            Term(quantity, station, axis, of, arrays[f'at_{i}'], arrays[f'grid_{i}'], arrays[f'values_{i}'])
            for i, (quantity, station, axis, of) in enumerate(fields)
        )
        model = MeasuredModel(tuple(arrays['stations'].tolist()), str(arrays['recording']), terms)
    except (KeyError, ValueError, TypeError) as error:
        raise ConfigurationError(f'{path}: lacks an array: {error}') from None
    for number, term in enumerate(terms):
        _check(term, model.stations, f'{path}: term {number}')
    return model


def _check(term: Term, stations: tuple[str, ...], where: str) -> None:
    """Refuse a term that cannot be simulated."""
    valid = PATH_QUANTITIES if not term.station else STATION_QUANTITIES
    if term.quantity not in valid:
        of = f"station '{term.station}'" if term.station else 'the path'
        raise ConfigurationError(f"{where}: '{term.quantity}' is no quantity of {of}")
    if term.station and term.station not in stations:
        raise ConfigurationError(f"{where}: unknown station '{term.station}'")
    if term.axis not in AXES:
        raise ConfigurationError(f"{where}: unknown axis '{term.axis}'")
    if term.axis in ('if_frequency', 'board_temperature') and term.axis_station not in stations:
        raise ConfigurationError(f"{where}: unknown station '{term.axis_station}' of its axis")
    shape = (len(term.at), len(term.grid)) if term.at.ndim == term.grid.ndim == 1 else None
    if shape is None or term.values.shape != shape or not min(shape):
        raise ConfigurationError(f'{where}: {term.quantity} needs values of shape (at, grid)')
    if any(x.dtype.kind != 'f' or not np.isfinite(x).all() for x in (term.at, term.grid, term.values)):
        raise ConfigurationError(f'{where}: {term.quantity} holds what is no finite number')
    if any(np.any(np.diff(x) <= 0.0) for x in (term.at, term.grid)):
        raise ConfigurationError(f'{where}: at and grid of {term.quantity} must increase')
    if term.quantity == 'random_power' and np.any(term.values < 0.0):
        raise ConfigurationError(f'{where}: a negative power')
