"""Terms of a measured remainder that add power of random phase to the IF: noise in bands, and narrow lines."""

import numpy as np

from drfmcw_sim.synthesis.measured import Term

from ..compare.comparison import Comparison
from .evidence import LeftOver
from .limits import LEARNING
from .smoothing import Sample, Smooth, smooth


def noise_terms(left: LeftOver, station: int) -> tuple[Smooth | None, tuple[Term, ...]]:
    """Return what changes a station's noise in bands, as a change of its floor and as added power."""
    c = left.comparison
    curve = smooth(left.noise(station), left.covariates((c.receivers[station],)), False)
    if curve is None:
        return None, ()
    axis, name = curve.covariate, c.receivers[station]
    before = _at_points(left, curve, 10.0 ** (left.predicted['noise'][:, station] / 10.0))
    floor = _at_points(left, curve, _floor(c, station)[:, None])
    change = before * (10.0 ** (curve.values / 10.0) - 1.0)
    less = np.maximum(np.minimum(change.min(axis=1, keepdims=True), 0.0), (LEARNING.least_floor - 1.0) * floor)
    more = np.maximum(change - less, 0.0)
    rate = c.recorded.sample_rate
    bands = (np.arange(change.shape[1]) + 0.5) * (rate / 2.0 / change.shape[1])
    power = more / _noise_width(c) / _full_scale(c, station) ** 2
    terms = [Term('random_power', name, axis.axis, axis.station, curve.at, bands, power)]
    if np.any(less):
        drop = 10.0 * np.log10(1.0 + less / floor)
        terms.append(Term('noise', name, axis.axis, axis.station, curve.at, np.zeros(1), drop))
    return curve, tuple(terms)


def _at_points(left: LeftOver, curve: Smooth, values: np.ndarray) -> np.ndarray:
    """Return values of the groups (G, P) at the points of a curve's covariate (M, P); gaps hold the row's mean."""
    over = curve.covariate.values
    order = np.argsort(over)
    filled = np.where(np.isfinite(values), values, np.nanmean(values, axis=1, keepdims=True))
    return np.stack([np.interp(curve.at, over[order], column[order]) for column in filled.T], axis=1)


def _floor(comparison: Comparison, station: int) -> np.ndarray:
    """Return the variance of the additive noise of a station's samples in each group (G,) [LSB^2]."""
    result = np.empty(len(comparison.members))
    heard = comparison.heard[station]
    for part in comparison.parts:
        result[part.groups] = part.steady.stations[heard].noise_std() ** 2 * comparison.recorded.topology.parts
    return result


def _noise_width(comparison: Comparison) -> float:
    """Return the width over which the noise of a sample spreads [Hz]."""
    rate = comparison.recorded.sample_rate
    return rate if comparison.recorded.topology.iq else rate / 2.0


def _full_scale(comparison: Comparison, station: int) -> float:
    return float(np.median(comparison.data.full_scale[comparison.heard[station]]))


def line_terms(left: LeftOver, station: int) -> tuple[Term, ...]:
    """Return narrow lines of random phase in a station's spectrum as added power."""
    c = left.comparison
    sample = left.lines(station)
    values = sample.values
    weight = np.where(np.isfinite(sample.variance), sample.count[..., None] / sample.variance, 0.0)
    total = weight.sum(axis=(0, 1))
    mean = np.nansum(weight * values, axis=(0, 1)) / np.maximum(total, 1e-300)
    by_group = weight.sum(axis=0)
    groups = np.nansum(weight * values, axis=0) / np.maximum(by_group, 1e-300)
    strong = (mean * np.sqrt(total) > LEARNING.narrow) | np.any(groups * np.sqrt(by_group) > LEARNING.narrow, axis=0)
    strong |= np.roll(strong, 1) | np.roll(strong, -1)
    if not strong.any():
        return ()
    chosen = Sample(values[..., strong], sample.count, sample.variance[:, strong])
    curve = smooth(chosen, left.covariates((c.receivers[station],)), False)
    if curve is None:
        return ()
    bins = len(strong)
    power = np.zeros((len(curve.at), bins))
    power[:, strong] = np.maximum(curve.values, 0.0)
    window = c.parts[0].extract.window_power[station]
    density = _deconvolved(power) / (window * _noise_width(c)) / _full_scale(c, station) ** 2
    frequency = np.arange(bins) * (c.recorded.sample_rate / 2.0 / (bins - 1))
    axis = curve.covariate
    return (Term('random_power', c.receivers[station], axis.axis, axis.station, curve.at, frequency, density),)


def _deconvolved(power: np.ndarray) -> np.ndarray:
    """Return the density that a Hann window widens to `power` (M, B) (Richardson and Lucy)."""

    def widened(values: np.ndarray) -> np.ndarray:
        edged = np.pad(values, ((0, 0), (1, 1)), mode='edge')
        result: np.ndarray = (edged[:, :-2] + 4.0 * edged[:, 1:-1] + edged[:, 2:]) / 6.0
        return result

    found = power.copy()
    for _ in range(LEARNING.deconvolved):
        found = found * widened(power / np.maximum(widened(found), 1e-300))
    return found
