"""Scanners of what turns as a phasor over the sweep: a second path, whose phase follows the distance, and a ripple."""

import dataclasses
import itertools
import math

import numpy as np
import scipy.fft

from drfmcw_physics.constants import DECIBELS_PER_NEPER, SPEED_OF_LIGHT
from drfmcw_sim.effects import Recipe

from ...compare.comparison import Comparison
from ...features.limits import SPECTRUM
from ..limits import SCAN
from .scanning import Rest, Values, peaks


@dataclasses.dataclass(frozen=True)
class Phasors:
    """How well the remainder of each group fits A exp(2 pi i f t) over the sweep, t from mid-sweep: arrays (G, cells).

    With A = |A| exp(i a) the correlation is |A| Re(exp(i a) correlation), the template's power
    |A|^2 (power + Re(exp(2 i a) imbalance)).
    """

    frequency: np.ndarray  # (cells,) [Hz]
    correlation: np.ndarray
    power: np.ndarray
    imbalance: np.ndarray

    def gain(self) -> np.ndarray:
        """Return by how much one phasor of any amplitude and phase lowers the misfit of all groups, (cells,)."""
        all_groups = (x.sum(axis=0) for x in (self.correlation, self.power, self.imbalance))
        return Phasors(self.frequency, *all_groups).gain_of_each()

    def gain_of_each(self) -> np.ndarray:
        """Return by how much a phasor of any amplitude and phase lowers the misfit of each group (G, cells)."""
        real, imag = self.correlation.real, -self.correlation.imag
        imbalance = self.imbalance
        solved = (self.power - imbalance.real) * real**2 + (self.power + imbalance.real) * imag**2
        return (solved + 2.0 * imbalance.imag * real * imag) / self._determinant

    def size_of_each(self) -> np.ndarray:
        """Return the amplitude of the phasor that fits each group best (G, cells)."""
        solved = self.power * self.correlation.conj() - self.imbalance.conj() * self.correlation
        return np.abs(solved) / self._determinant

    @property
    def _determinant(self) -> np.ndarray:
        return np.maximum(self.power**2 - np.abs(self.imbalance) ** 2, 1e-12 * self.power**2 + 1e-30)


def _phasors(c: Comparison, residual: np.ndarray, synthesiser: bool) -> Phasors:
    """Return how well phasors fit: those of a synthesiser, in the phases alone, or those of a path, in amplitudes too.

    A second path turns amplitude and phase alike. Its phase has opposite signs in the lines of both stations; the phase
    of a synthesiser has the same sign.
    """
    groups, channels, count = c.std.ramp.shape
    stations = channels // 2
    z = residual[c.entries.where(kind='ramp')].reshape(groups, channels, count) / c.std.ramp
    weight = 1.0 / c.std.ramp**2
    step = float(c.time[1] - c.time[0])
    frequency = np.fft.rfftfreq(SCAN.fine * count, step)[1:]
    turn = 2.0 * math.pi * frequency[:, None] * step * (np.arange(count) - (count - 1) / 2.0)
    basis = scipy.fft.dct(np.cos(turn), norm='ortho') + 1j * scipy.fft.dct(np.sin(turn), norm='ortho')
    if synthesiser:
        amplitude, amplitude_weight = z[:, stations], weight[:, stations]
        phase, phase_weight = np.zeros_like(amplitude), np.zeros_like(amplitude_weight)
    else:
        amplitude, amplitude_weight = z[:, :stations].sum(axis=1), weight[:, :stations].sum(axis=1)
        phase, phase_weight = math.sqrt(stations) * z[:, -1], stations * weight[:, -1]
    return Phasors(
        frequency,
        (amplitude - 1j * phase) @ basis.T,
        (amplitude_weight + phase_weight) @ np.abs(basis.T) ** 2 / 2.0,
        (amplitude_weight - phase_weight) @ basis.T**2 / 2.0,
    )


def path_phasors(c: Comparison, residual: np.ndarray) -> Phasors:
    """Return how well phasors of second paths fit a residual over the numbers' standard deviations (n,)."""
    return _phasors(c, residual, False)


def per_metre(c: Comparison) -> float:
    """Return the beat frequency of one metre of excess path [Hz/m]."""
    return abs(c.data.sweeps[0][0].chirp_rate) / SPEED_OF_LIGHT


def sweep_resolution(c: Comparison) -> float:
    """Return the frequency of one turn over the analysed part of the sweep [Hz]."""
    begin, end = c.data.sweeps[0][0].analysis_window()
    return 1.0 / (end - begin)


def echoes(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return excess lengths of paths beside the direct one [m]."""
    c, residual = rest.comparison, rest.residual
    phasors = path_phasors(c, residual)
    near = [float(phasors.frequency[k] / per_metre(c)) for k in peaks(phasors.gain())]
    return (*near, *_distant_echoes(c, residual))


def _distant_echoes(c: Comparison, residual: np.ndarray) -> tuple[float, ...]:
    """Return excess ranges of echoes that are resolved as lines of their own, equally far from each station's line."""
    z = residual[c.entries.where(kind='lines')].reshape(len(c.members), -1, c.measured.lines.shape[-1])
    bins = z.shape[-1]
    width = c.data.sweeps[0][0].sample_rate / 2 / (bins - 1)
    distance = np.arange(SPECTRUM.line, min(bins - 1, int(SCAN.longest * per_metre(c) / width)))
    score = np.zeros(len(distance))
    for group, sweeps in zip(z, c.sweeps, strict=True):
        for spectrum, line in zip(group, sweeps.line.mean(axis=0) / width, strict=True):
            at = np.rint(line + distance).astype(int)
            score += np.where(at < bins, spectrum[np.minimum(at, bins - 1)], 0.0)
    return tuple(float(distance[k] * width / per_metre(c)) for k in peaks(score, 1))


def reflections(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return products of both antennas' heights above ground that reflects [m^2].

    Fringes are where the crane stands: where the explanation has it, where the reference has it, or beside that by what
    is explained of the range.
    """
    c, residual = rest.comparison, rest.residual
    read = np.array([c.data.distance[m].mean() for m in c.members])
    explained = (c.residual - residual)[c.entries.where(kind='range')]
    beside = np.where(np.isfinite(c.std.range), explained * np.nan_to_num(c.std.range, posinf=0.0), 0.0)
    far = SCAN.beside * SPEED_OF_LIGHT / c.data.sweeps[0][0].center_frequency
    places: list[np.ndarray] = []
    for place in (rest.distance, read, read + beside):
        if all(np.ptp(place - other) > far for other in places):
            places.append(place)
    phasors = path_phasors(c, residual)
    each = (_fringes(c, residual, phasors, place, SCAN.shown * rest.least) for place in places)
    found = dict.fromkeys(x for alike in itertools.zip_longest(*each) for x in alike if x is not None)
    return tuple(found)[: SCAN.reflections * min(len(places), 2)]


def _longer_by(distance: np.ndarray, products: np.ndarray) -> np.ndarray:
    """Return excess lengths of a reflection by products of heights (M,) [m^2] at distances (G,) [m] (M, G) [m]."""
    longer: np.ndarray = np.sqrt(distance**2 + 4.0 * products[:, None]) - distance
    return longer


def _fringes(c: Comparison, residual: np.ndarray, phasors: Phasors, distance: np.ndarray, least: float) -> list[float]:
    """Return products of heights [m^2] whose fringes over the distances of the groups fit best, best first.

    Args:
        c: recording and model.
        residual: what is left of it.
        phasors: of a path, how well they fit that.
        distance: mean of each group (G,) [m].
        least: gain that they show, at least.
    """
    carrier = c.data.sweeps[0][0].center_frequency / SPEED_OF_LIGHT
    # the product changes by R c / (2 f) from fringe to fringe, so fringes are closest at the nearest distance R
    step = max(float(distance.min()) / (2.0 * carrier * SCAN.per_fringe), SCAN.highest / SCAN.heights)
    products = np.arange(step, SCAN.highest, step)
    excess = _longer_by(distance, products)
    turn = np.exp(2j * math.pi * excess * carrier)
    way = c.recorded.way
    if way.any():  # a group's mean is that over the way that the crane drives in it
        turned = _longer_by(distance + 0.5 * way, products) - _longer_by(distance - 0.5 * way, products)
        turn *= np.sinc(turned * carrier)
    cell = np.rint(excess * per_metre(c) / phasors.frequency[0]).astype(int) - 1
    inside = (cell >= 0) & (cell < len(phasors.frequency))
    at = np.arange(len(distance)), cell.clip(0, len(phasors.frequency) - 1)
    correlation = np.where(inside, (turn * phasors.correlation[at]).real, 0.0)
    power = np.where(inside, np.abs(turn) ** 2 * phasors.power[at] + (turn**2 * phasors.imbalance[at]).real, 0.0)
    # where both paths lie in one resolution cell, the reflection shows in the level
    std = c.std.amplitude
    level = residual[c.entries.where(kind='amplitude')].reshape(std.shape) / std
    gained = correlation.sum(axis=1) + DECIBELS_PER_NEPER * turn.real @ level.sum(axis=1)
    spent = power.sum(axis=1) + DECIBELS_PER_NEPER**2 * turn.real**2 @ np.sum(1.0 / std**2, axis=1)
    gain = gained**2 / np.maximum(spent, 1e-30)
    return [float(products[k]) for k in peaks(gain, SCAN.reflections) if gain[k] >= least]


def ripples(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return frequencies of a synthesiser's ripple over the sweep [Hz]."""
    c, residual = rest.comparison, rest.residual
    phasors = _phasors(c, residual, True)
    duration = float(c.time[-1] - c.time[0])
    gain = np.where(phasors.frequency * duration < SCAN.slowest_ripple, 0.0, phasors.gain())
    return tuple(float(phasors.frequency[k]) for k in peaks(gain))
