"""Where in a remainder a search should begin: the places at which an effect with a sharp shape would fit best.

Echoes, reflections, ripples, sway and spurs fit only within a resolution cell, of which there are hundreds: too many to
simulate each. Their first-order response is a rotating phasor, so transforms of the remainder show the cells at once.
The places only start a search. What an effect does is said by the simulator's forward model alone.
"""

import math

import numpy as np
import scipy.fft
from scipy.ndimage import maximum_filter1d

from drfmcw_physics.constants import SPEED_OF_LIGHT

from .comparison import Comparison
from .features import LINE

_FINE = 8  # transform bins per resolution cell
_PEAKS = 3  # places of each effect
_DECIBEL = 20.0 / math.log(10.0)  # of one neper
_PRODUCTS = np.concatenate([np.arange(0.25, 100.0, 0.1), np.geomspace(100.0, 1000.0, 1000)])  # of two heights [m^2]
_SLOWEST_RIPPLE = 2.0  # periods within the sweep: slower ones are taken out with each sweep's frequency
_FASTEST_SWAY = 5.0  # [Hz]
_SWAY_CELLS = 2048  # at most
_LONGEST = 500.0  # echo [m]

CELLS = {'echo': 350, 'ground_reflection': 200, 'sweep_ripple': 60, 'spur': 1000, 'sway': 1000}
"""Independent places among which each search chooses, by effect."""


def places(comparison: Comparison, residual: np.ndarray, effect: str, station: int) -> tuple[float, ...]:
    """Return values of an effect's sharp parameter at which it promises most, best first.

    Args:
        comparison: recording and model.
        residual: whitened remainder.
        effect: one of `CELLS`.
        station: its number, -1 for none.
    """
    if effect == 'echo':
        return _echoes(comparison, residual)
    if effect == 'ground_reflection':
        return _reflections(comparison, residual)
    if effect == 'sweep_ripple':
        return _ripples(comparison, residual)
    if effect == 'sway':
        return _sways(comparison, residual)
    return () if station < 0 else _spurs(comparison, residual, station)


def _peaks(score: np.ndarray, count: int = _PEAKS, apart: int = _FINE // 2) -> list[int]:
    """Return the places of the largest local maxima, best first."""
    high = np.flatnonzero((score == maximum_filter1d(score, 2 * apart + 1)) & (score > 0.0))
    return [int(k) for k in high[np.argsort(score[high])[::-1][:count]]]


class _Ramp:
    """The ramp's remainder as time series over the sweep, weighted by their noise."""

    def __init__(self, c: Comparison, residual: np.ndarray) -> None:
        groups, channels, self.count = c.std.ramp.shape
        z = residual[c.entries.where(kind='ramp')].reshape(groups, channels, self.count)
        self.step = float(c.time[1] - c.time[0])
        self.stations = channels // 2
        self._over_time = scipy.fft.idct(z / c.std.ramp, norm='ortho', axis=-1)
        self._weight = 1.0 / c.std.ramp**2
        cells = _FINE * self.count
        self.frequency = np.fft.rfftfreq(cells, self.step)  # of a phasor over the sweep [Hz]
        self._cells = cells

    def phasor(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (correlation, its variance) of each group (G, cells) with a phasor, in amplitude and phase sum alike.

        A second path does so: amplitude and phase of what it adds turn with its excess delay. Zero in mid-sweep.
        """
        amplitude = self._over_time[:, : self.stations].sum(axis=1)
        phase = self._over_time[:, self.stations] * math.sqrt(self.stations)
        weight = self._weight[:, : self.stations].sum(axis=1) + self.stations * self._weight[:, self.stations]
        return self._transformed(amplitude + 1j * phase), self._at_cells(weight)

    def ripple(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the same for a sine of the phases' difference, of all groups together (cells,)."""
        return (
            self._transformed(self._over_time[:, -1]).sum(axis=0),
            self._at_cells(self._weight[:, -1]).sum(axis=0),
        )

    def _transformed(self, series: np.ndarray) -> np.ndarray:
        turned = np.fft.fft(series, self._cells, axis=1)[:, : len(self.frequency)]
        return turned * np.exp(1j * math.pi * self.frequency * self.step * (self.count - 1))

    def _at_cells(self, weight: np.ndarray) -> np.ndarray:
        """Return weights per cosine term at the cells' frequencies; half of a phasor's power is in each part."""
        at = 2.0 * self.frequency * self.count * self.step
        return np.stack([np.interp(at, np.arange(self.count), w) for w in weight]) * self.count / 2.0 + 1e-30


def _per_metre(c: Comparison) -> float:
    """Return the beat frequency of one metre of excess path [Hz/m]."""
    return abs(c.data.sweeps[0][0].chirp_rate) / SPEED_OF_LIGHT


def _echoes(c: Comparison, residual: np.ndarray) -> tuple[float, ...]:
    ramp = _Ramp(c, residual)
    correlation, variance = ramp.phasor()
    score = np.abs(correlation.sum(axis=0)) ** 2 / variance.sum(axis=0)
    near = [float(ramp.frequency[k] / _per_metre(c)) for k in _peaks(score)]
    return (*near, *_distant_echoes(c, residual))


def _distant_echoes(c: Comparison, residual: np.ndarray) -> tuple[float, ...]:
    """Return excess ranges of echoes that stand as lines of their own, as far from each station's line."""
    z = residual[c.entries.where(kind='lines')].reshape(len(c.members), -1, c.measured.lines.shape[-1])
    bins = z.shape[-1]
    width = c.data.sweeps[0][0].sample_rate / 2 / (bins - 1)
    distance = np.arange(LINE, min(bins - 1, int(_LONGEST * _per_metre(c) / width)))
    score = np.zeros(len(distance))
    for group, sweeps in zip(z, c.sweeps, strict=True):
        for spectrum, line in zip(group, sweeps.line.mean(axis=0) / width, strict=True):
            at = np.rint(line + distance).astype(int)
            score += np.where(at < bins, spectrum[np.minimum(at, bins - 1)], 0.0)
    return tuple(float(distance[k] * width / _per_metre(c)) for k in _peaks(score, 1))


def _reflections(c: Comparison, residual: np.ndarray) -> tuple[float, ...]:
    ramp = _Ramp(c, residual)
    correlation, variance = ramp.phasor()
    distance = np.array([c.data.distance[m].mean() for m in c.members])
    excess = np.sqrt(distance**2 + 4.0 * _PRODUCTS[:, None]) - distance  # (products, groups)
    turn = np.exp(-2j * math.pi * excess * c.data.sweeps[0][0].center_frequency / SPEED_OF_LIGHT)
    cell = np.rint(excess * _per_metre(c) / ramp.frequency[1]).astype(int).clip(0, len(ramp.frequency) - 1)
    groups = np.arange(len(distance))
    gained = np.sum((correlation[groups, cell] * turn).real, axis=1)
    spent = np.sum(variance[groups, cell], axis=1)
    # within one resolution cell it shows in the level alone
    std = c.std.amplitude
    level = residual[c.entries.where(kind='amplitude')].reshape(std.shape) / std
    gained += _DECIBEL * turn.real @ level.sum(axis=1)
    spent += _DECIBEL**2 * turn.real**2 @ np.sum(1.0 / std**2, axis=1)
    return tuple(float(_PRODUCTS[k]) for k in _peaks(gained**2 / spent))


def _ripples(c: Comparison, residual: np.ndarray) -> tuple[float, ...]:
    ramp = _Ramp(c, residual)
    correlation, variance = ramp.ripple()
    score = np.abs(correlation) ** 2 / variance
    score[ramp.frequency * ramp.count * ramp.step < _SLOWEST_RIPPLE] = 0.0
    return tuple(float(ramp.frequency[k]) for k in _peaks(score))


def _sways(c: Comparison, residual: np.ndarray) -> tuple[float, ...]:
    chosen = c.entries.where(kind='movement')
    rows, group = c.entries.position[chosen], c.entries.group[chosen]
    weight = 1.0 / c.std.movement
    used = weight > 0.0
    if np.count_nonzero(used) < 4:
        return ()
    rows, group, weight, z = rows[used], group[used], weight[used], residual[chosen][used]
    time = c.data.time[rows]
    step = max(0.25 / max(np.ptp(time), 1.0), _FASTEST_SWAY / (_FINE * _SWAY_CELLS))
    frequency = np.arange(1, int(_FASTEST_SWAY / step)) * step
    score = np.empty(len(frequency))
    for part in np.array_split(np.arange(len(frequency)), -(-len(frequency) // 2048)):
        wave = np.exp(2j * math.pi * frequency[part, None] * time)
        for g in np.unique(group):  # a movement is told within its group only
            wave[:, group == g] -= wave[:, group == g].mean(axis=1, keepdims=True)
        wave *= weight
        # least squares with both quadratures
        c_, s_ = wave.real, wave.imag
        cc, ss, cs = np.sum(c_ * c_, axis=1), np.sum(s_ * s_, axis=1), np.sum(c_ * s_, axis=1)
        a, b = c_ @ z, s_ @ z
        score[part] = (ss * a * a - 2.0 * cs * a * b + cc * b * b) / np.maximum(cc * ss - cs * cs, 1e-30)
    return tuple(float(frequency[k]) for k in _peaks(score, apart=2))


def _spurs(c: Comparison, residual: np.ndarray, station: int) -> tuple[float, ...]:
    z = residual[c.entries.where(kind='lines', station=station)].reshape(len(c.members), -1)
    width = c.data.sweeps[0][0].sample_rate / 2 / (z.shape[1] - 1)
    score = z.sum(axis=0) / np.sqrt(np.maximum(np.count_nonzero(z, axis=0), 1))
    joined = np.convolve(score, (0.5, 1.0, 0.5), 'same')  # a Hann window spreads a line over three bins
    found = []
    for k in _peaks(joined, apart=2):
        inside = np.maximum(score[max(k - 1, 0) : k + 2], 0.0)
        offset = np.average(np.arange(max(k - 1, 0), max(k - 1, 0) + len(inside)), weights=inside + 1e-12)
        found.append(float(offset * width))
    return tuple(found)
