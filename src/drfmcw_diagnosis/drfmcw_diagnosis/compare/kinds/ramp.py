"""Amplitude and phase over the sweep: their mean course, and how they change from sweep to sweep."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import scipy.fft
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from drfmcw_physics.constants import DECIBELS_PER_NEPER

from ...features.sines import without_strong
from ...features.spectra import gaussian, local_noise, median_of_mean
from ..limits import MODEL, SCATTER
from ..measuring import Evidence
from ..predicting import Expected
from ..recorded_sweeps import RecordedSweeps
from . import chances
from .explained import Explained
from .kind import Kind, Measured, Of, Plotted, Shown, Trust, at_distance


@dataclasses.dataclass(frozen=True, kw_only=True)
class _OfChannels(Kind):
    """Cosine series over the sweep (G, 2 S, K), one of each of the ramp's channels."""

    of: Of = Of.CHANNEL

    def receiver(self, recorded: RecordedSweeps, row: int) -> int:
        """Return the station of a channel, -1 where it belongs to both."""
        return recorded.channels[row].receiver

    def words(self, recorded: RecordedSweeps, row: int) -> str:
        """Return what a channel is called."""
        return recorded.channels[row].words


@dataclasses.dataclass(frozen=True, kw_only=True)
class Ramp(_OfChannels):
    """Mean cosine series of log amplitude [Np] and phase [rad]."""

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean over each group; free terms are not compared."""
        std = np.full((len(evidence.counts), *evidence.ramps[0].shape[1:]), np.inf)
        for row, channel in enumerate(evidence.recorded.channels):
            first = SCATTER.free_phase if channel.of_phase else SCATTER.free_amplitude
            for g, ramp in enumerate(evidence.ramps):
                if evidence.recorded.scatters:
                    variance = _covariance(ramp[:, row, first:], ramp[:, row, first:])
                else:
                    variance = evidence.white[g]['ramp'][row]
                std[g, row, first:] = np.sqrt(variance / len(ramp))
        return np.stack([ramp.mean(axis=0) for ramp in evidence.ramps]), std

    def in_pairs(self, evidence: Evidence) -> tuple[tuple[int, int], np.ndarray]:
        """Return by how much the noise of the phases' sum and difference is correlated (G, K).

        It is where one receiver is far noisier than the other one. Nothing is said of groups in which it is not.
        """
        recorded = evidence.recorded
        shares = np.zeros((len(evidence.ramps), evidence.ramps[0].shape[-1]))
        if not (recorded.scatters and len(recorded.phases) == 2):
            return (0, 0), shares
        one, other = recorded.phases
        first = SCATTER.free_phase
        for share, ramp in zip(shares, evidence.ramps, strict=True):
            both = [ramp[:, row, first:] for row in (one, other)]
            variances = [_covariance(x, x) for x in both]
            found = _covariance(*both) / np.sqrt(np.maximum(variances[0] * variances[1], np.finfo(float).tiny))
            if abs(np.median(found)) > SCATTER.correlated:
                share[first:] = np.clip(found, -SCATTER.fully, SCATTER.fully)
        return (one, other), shares

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return the series of simulated sweeps."""
        return expected.ramp

    def doubt(self, explained: Explained, template: np.ndarray, nonlinear: np.ndarray) -> np.ndarray:
        """Add to it what mirror lines bring by chance of the sweeps' phases, beyond what the scatter shows of it.

        It falls on single terms, over many of which the scatter is smoothed.
        """
        doubt = super().doubt(explained, template, nonlinear)
        if not explained.recorded.scatters:
            return doubt
        around = explained.std['flutter'] / np.array([len(m) for m in explained.recorded.members])[:, None, None]
        changing = _displaced(explained)
        beyond = around * (1.0 + changing) / explained.std[self.name] ** 2 - 1.0
        by_chance: np.ndarray = np.hypot(doubt, np.sqrt(np.maximum(beyond * (changing > 0.0), 0.0)).ravel())
        return by_chance

    def chances(self, left: chances.Remainder) -> list[float]:
        """Look also at what all groups have in common, and for events within the sweep."""
        return [*super().chances(left), *chances.common(left.by_group()), chances.events(left)]

    def profile(self, recorded: RecordedSweeps, z: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return squares over the time in the sweep [s]."""
        groups = len(recorded.members)
        over_time = scipy.fft.idct(z.reshape(groups, -1), norm='ortho', axis=1)
        return recorded.time, np.mean(over_time**2, axis=0) * groups

    def plotted(self, shown: Shown) -> Plotted:
        """Return amplitudes or phases over the time in the sweep [s]."""
        at = shown.group, shown.row
        residual, std, curve = shown.residual[at], shown.std[at], shown.curve[at]
        of_phase = shown.recorded.channels[shown.row].of_phase
        scale, unit = (1.0, 'rad') if of_phase else (DECIBELS_PER_NEPER, 'dB')
        known = np.isfinite(std)
        residual, curve = (scipy.fft.idct(np.where(known, v, 0.0), norm='ortho') * scale for v in (residual, curve))
        usual = np.full(len(residual), math.sqrt(np.mean(std[known] ** 2)) * scale)
        return Plotted(shown.recorded.time, residual, usual, curve, unit, at_distance(shown))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flutter(_OfChannels):
    """Variance of the ramp's terms from sweep to sweep over that of the terms around, 1 for noise alone.

    Its standard deviation stands for the variance around.
    """

    def measured(self, evidence: Evidence) -> Measured:
        """Return variances over those around, and those around."""
        if not evidence.recorded.scatters:
            ones = np.ones((len(evidence.counts), *evidence.ramps[0].shape[1:]))
            return ones, ones
        calm = [ramp[chosen] for ramp, chosen in zip(evidence.ramps, evidence.recorded.calm, strict=True)]
        return _over_neighbours(calm, evidence.recorded.phases)

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return 1 and what effects of random phase add.

        What mirror lines and lines of random phase add is only known well enough to doubt, see `uncertain`.
        """
        around = expected.std[self.name][expected.part.groups]
        result = np.ones(around.shape)
        if expected.fluttering is not None:
            result[..., SCATTER.steady :] += (expected.fluttering / around)[..., SCATTER.steady :]
        return np.maximum(result, 0.0)

    def whitened(self, values: np.ndarray, plain: np.ndarray, std: np.ndarray, recorded: RecordedSweeps) -> np.ndarray:
        """Return variances as standard normals, of the terms that slow changes do not move.

        Where a station hears itself, what moves in its scene changes more of them. Phases of which the noise alone may
        make turns slip are not compared.
        """
        freedom = recorded.freedom[:, None, None]
        over = (gaussian(values, freedom) - gaussian(np.ones(1), freedom)) / SCATTER.flutter_spread
        terms = np.arange(values.shape[-1])
        first = SCATTER.trend_from if recorded.topology.hears_itself else SCATTER.steady
        phases = recorded.phases
        slips = np.any(std[:, phases, SCATTER.steady :].mean(axis=-1) > SCATTER.slipping, axis=1)
        compared = np.broadcast_to((terms >= first) & recorded.scatters, values.shape).copy()
        compared[np.ix_(slips, phases)] = False
        return np.where(compared, over, 0.0)

    def doubt(self, explained: Explained, template: np.ndarray, nonlinear: np.ndarray) -> np.ndarray:
        """Add to it the doubt about what effects of random phase do, which the template holds.

        A strong one leaks into all terms, since each sweep's amplitude, phase and frequency follow a part of it.
        """
        by_group = np.abs(template).reshape(len(explained.recorded.members), -1)
        leaked = MODEL.flutter_leak * by_group.max(axis=1, keepdims=True)
        own = np.maximum(MODEL.own_flutter * by_group, leaked).ravel()
        doubt: np.ndarray = np.hypot(super().doubt(explained, template, nonlinear), own)
        return doubt

    def uncertain(self, explained: Explained, size: np.ndarray) -> np.ndarray:
        """Return by how much an explanation makes the ramp change with the phase of each sweep (n,).

        Bursts do so by no known amount where hardly a sweep is free of them.
        """
        freedom = explained.recorded.freedom[:, None, None]
        ratio = 1.0 + _displaced(explained)
        changing: np.ndarray = gaussian(ratio, freedom) - gaussian(np.ones(1), freedom)
        if explained.bursting:
            changing[[calm.all() or calm.mean() < MODEL.calm for calm in explained.recorded.calm]] = np.inf
        return changing.ravel()

    def chances(self, left: chances.Remainder) -> list[float]:
        """Look for one modulation frequency that all groups share."""
        return [chances.rhythm(left.by_group())]

    def words(self, recorded: RecordedSweeps, row: int) -> str:
        """Return what a channel's change is called."""
        return super().words(recorded, row).replace('over the sweep', 'from sweep to sweep')

    def profile(self, recorded: RecordedSweeps, z: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return squares over the modulation frequency [Hz]."""
        terms = z.reshape(len(recorded.members), -1)
        return _modulation(recorded, terms.shape[1]), np.sum(terms**2, axis=0)

    def plotted(self, shown: Shown) -> Plotted:
        """Return whitened variances over the modulation frequency [Hz]."""
        count = len(shown.whitened)
        x = _modulation(shown.recorded, count)
        return Plotted(x, shown.whitened, np.ones(count), shown.template, 'σ', at_distance(shown))


def _covariance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the covariance of terms of one sweep (K,), smooth over the terms, from a group's sweeps (n, K) each."""
    products = (one - one.mean(axis=0)) * (other - other.mean(axis=0))
    smooth: np.ndarray = uniform_filter1d(products.sum(axis=0) / (len(one) - 1), SCATTER.smooth, mode='nearest')
    return smooth


def _displaced(explained: Explained) -> np.ndarray:
    """Return by how much an explanation makes the ramp change (G, 2 S, K), wherever nearby that may be."""
    changing: np.ndarray = maximum_filter1d(explained.changing(), MODEL.flutter_width, axis=-1)
    return changing


def _over_neighbours(ramps: Sequence[np.ndarray], phases: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return variances over those of the terms around, and the latter, (G, 2 S, K) each.

    A modulation is no noise of the terms around it: what all groups hold of one is taken out of these.

    Args:
        ramps: cosine series of each group's sweeps (n, 2 S, K).
        phases: channels that are phases.
    """
    variance = np.stack([_variance(ramp) for ramp in ramps])
    around = np.stack([_around(v, len(ramp)) for v, ramp in zip(variance, ramps, strict=True)])
    rest = [ramp.copy() for ramp in ramps]
    for channel in phases:
        stds = list(np.sqrt(around[:, channel]))
        left = without_strong([ramp[:, channel] for ramp in ramps], stds, SCATTER.steady)
        for ramp, values in zip(rest, left, strict=True):
            ramp[:, channel] = values
    around = np.stack([_around(_variance(ramp), len(ramp)) for ramp in rest])
    return variance / around, around


def _variance(ramp: np.ndarray) -> np.ndarray:
    """Return the variance of the terms of a group's sweeps (2 S, K)."""
    squares = (ramp - ramp.mean(axis=0)) ** 2
    power = squares[..., SCATTER.steady :].mean(axis=-1, keepdims=True)
    # a single noisy sweep must not determine how all scatter
    weight = np.minimum(SCATTER.noisy * np.median(power, axis=0) / power, 1.0)
    found: np.ndarray = len(ramp) / (len(ramp) - 1) * np.sum(weight * squares, axis=0) / np.sum(weight, axis=0)
    return found


def _around(variance: np.ndarray, count: int) -> np.ndarray:
    """Return the variance around each term (2 S, K), of as many sweeps."""
    trend = _trend(variance)
    steady = local_noise(variance[:, SCATTER.steady :] / trend[:, SCATTER.steady :], SCATTER.flutter_median)
    local = np.pad(steady, ((0, 0), (SCATTER.steady, 0)), 'edge')  # the terms ahead are no noise
    found: np.ndarray = trend * local / median_of_mean((count - 1) / 2)
    return found


def _trend(variance: np.ndarray) -> np.ndarray:
    """Return the smooth course of spectra of noise (C, K), which a median over neighbours alone would cut off.

    A polynomial in the logarithm of the term is fitted to their logarithms, without outliers above it.
    """
    term = np.log(np.arange(variance.shape[-1]) + 1.0)
    basis = np.polynomial.chebyshev.chebvander(2.0 * term / term[-1] - 1.0, SCATTER.trend_degree)
    result = np.empty(variance.shape)
    for row, values in enumerate(np.log(np.maximum(variance, 1e-300))):
        kept = np.arange(len(values)) >= SCATTER.trend_from
        for _ in range(SCATTER.trend_rounds):
            coefficients = np.linalg.lstsq(basis[kept], values[kept], rcond=None)[0]
            above = values - basis @ coefficients
            kept &= above < SCATTER.trend_above * above[kept].std()
        result[row] = basis @ coefficients
    result[:, : SCATTER.trend_from] = result[:, SCATTER.trend_from, None]  # the fit leaves these terms out
    return np.exp(result)


def _modulation(recorded: RecordedSweeps, terms: int) -> np.ndarray:
    """Return the frequencies of the terms of a cosine series over the sweep (terms,) [Hz]."""
    step = float(recorded.time[1] - recorded.time[0])
    return np.arange(terms) / (2.0 * terms * step)


RAMP = Ramp(name='ramp', level='if_samples', axis='ramp_time', averages=True)
FLUTTER = Flutter(name='flutter', level='noise', axis='if_frequency', trust=Trust(usual=MODEL.flutter))
