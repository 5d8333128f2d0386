"""What sweeps show of each group of them, and its standard deviations, by their scatter from sweep to sweep."""

import dataclasses

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..features import adc_codes, coherence
from ..features.extractor import (
    SweepFeatures,
    local_noise,
    mean_power,
    median_of_mean,
    quiet_sweeps,
    ramp_spectrum,
    unevenness,
)
from ..recording.grouping import noise_by_bends
from .groups import Groups, joined, pooled
from .known import BEAT_LIMIT, Known
from .recorded_sweeps import RecordedSweeps

STEADY = 8
"""Terms of the ramp that slow changes of the conditions may move from sweep to sweep."""

_FREE = 2  # cosine terms that amplitude, phase and frequency of each sweep take out of the ramp
_TREND = 3  # degree of the polynomial that follows the oscillators' noise
_TREND_ROUNDS = 3
_TREND_ABOVE = 2.5  # standard deviations by which a modulation stands out of it
_TELLING = 7  # consecutive sweeps that tell by their bends how the carrier wanders
_FLUTTER_MEDIAN = 31  # terms over which the variance around one is taken
_SMOOTH = 15  # neighbouring cosine terms that share a variance
_PILED = 0.3  # samples of a sweep that may pile up by chance
_AMPLITUDE_LIMIT = 0.1  # what the link budget is trusted to in each place [dB]
_AMPLITUDE_SHARED = 1.4  # both stations' amplitudes scatter together, which counts their sum twice
_COHERENCE_LIMIT = 0.005  # what the coherence of both lines' noise is trusted to [1]
_MOVEMENT_LIMIT = 1e-5  # what the carrier phase is trusted to [m]


@dataclasses.dataclass(frozen=True)
class Measured:
    """Features of all groups, measured."""

    values: Groups
    std: Groups  # inf where nothing is known to compare with
    quiet: list[np.ndarray]  # sweeps without a burst in each group (S,)


def measured(recorded: RecordedSweeps, known: Known) -> Measured:
    """Return the features of all groups and their standard deviations, finite where `known` tells what to expect."""
    members, scatters = recorded.members, recorded.scatters
    errors_of_range = [s.range - recorded.data.distance[m] for s, m in zip(recorded.sweeps, members, strict=True)]
    range_std, beat_std, amplitude_std = _scatter(recorded, known, errors_of_range)
    harmonic_std, coherence_std = _harmonic_scatter(recorded), _coherence_scatter(recorded, known)
    wave = recorded.parts[0].extract.way_per_phase
    movement_told = any(part.extract.way_per_phase for part in recorded.parts)
    range_told = known.range()
    noise_told, range_limit = known.noise(), known.range_limit()
    smooth = _smooth(recorded)
    counts: list[np.ndarray] = []
    values: list[Groups] = []
    errors: list[Groups] = []
    for g, (rows, sweeps, standing) in enumerate(zip(members, recorded.sweeps, recorded.standing, strict=True)):
        n = len(rows)
        root = np.sqrt(n)
        ramp = ramp_spectrum(sweeps.ramp)
        power, quiet = mean_power(sweeps.power, quiet_sweeps(sweeps.quiet))
        counts.append(quiet)
        around = local_noise(power) / median_of_mean(quiet)[:, None]
        noise, noise_std = recorded.bands.measured(power, sweeps.line.mean(axis=0), quiet)
        noise_std[~noise_told] = np.inf
        ramp_variance, mean_variance = _variances(recorded, sweeps, ramp, noise)
        flutter, steady_variance = _flutter(ramp, scatters)
        ramp_std = np.full(ramp.shape[1:], np.inf)
        ramp_std[:, _FREE:] = np.sqrt(ramp_variance / n)
        burst, burst_std = unevenness(sweeps.quiet) if scatters else (np.zeros((len(recorded.heard), 3)), np.inf)
        error = errors_of_range[g]
        if standing:
            movement, movement_std = _movement_by_phase(sweeps, wave, movement_told)
        else:
            reference_std = recorded.data.reference_std[rows]
            movement, movement_std = _movement_by_range(sweeps, error, reference_std, range_told[g] and movement_told)
        values.append(
            Groups(
                ramp.mean(axis=0),
                flutter,
                power / around,
                sweeps.mean.mean(axis=0),
                sweeps.harmonic.mean(axis=0),
                sweeps.piled.mean(axis=0),
                burst,
                noise,
                recorded.shares[g].mean(axis=0),
                sweeps.beat.mean(),
                sweeps.amplitude.mean(axis=0),
                error.mean(),
                recorded.slope[g],
                movement,
            )
        )
        errors.append(
            Groups(
                ramp_std,
                steady_variance,
                around,
                np.maximum(np.sqrt(mean_variance), 0.01) / root,
                harmonic_std[g] / root,
                np.where(smooth, np.sqrt(sweeps.piled.mean(axis=0) + _PILED), np.inf) / root,
                burst_std,
                noise_std,
                coherence_std[g] / root,
                np.hypot(beat_std[g] / root, BEAT_LIMIT),
                np.hypot(amplitude_std[g] / root, _AMPLITUDE_LIMIT),
                np.hypot(max(range_std[g], 1e-5) / root, range_limit[g]),
                recorded.slope_std[g],
                movement_std,
            )
        )
    return Measured(joined(values), joined(errors), counts)


def _smooth(recorded: RecordedSweeps) -> np.ndarray:
    """Return at which stations noise makes the histogram of codes smooth (S,)."""
    rows = np.concatenate(recorded.members)
    noise = np.min([np.median(s.quiet, axis=(0, 2)) for s in recorded.sweeps], axis=0)
    parts = 2.0 if recorded.data.iq else 1.0  # of a complex sample's power
    samples = (recorded.data.samples[i][rows] for i in recorded.heard)
    return np.array([adc_codes.smooth(x, np.sqrt(n / parts)) for x, n in zip(samples, noise, strict=True)])


def _scatter(
    recorded: RecordedSweeps, known: Known, errors_of_range: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return by what sweeps scatter: range (G,), beat (G,), amplitudes (G, S); inf where nothing tells it."""
    told, groups = known.range(), len(recorded.members)
    expected = np.array(
        [
            np.mean(s.range_std**2 + np.nan_to_num(recorded.data.reference_std[m]) ** 2)
            for s, m in zip(recorded.sweeps, recorded.members, strict=True)
        ]
    )
    range_std, beat_std = np.full(groups, np.inf), np.full(groups, np.inf)
    amplitude_std = np.full((groups, len(recorded.heard)), np.inf)
    if not recorded.scatters:
        range_std[told] = np.sqrt(expected[told])
        return range_std, beat_std, amplitude_std
    if told.any():
        errors = [e[:, None] for e, t in zip(errors_of_range, told, strict=True) if t]
        range_std[told] = pooled(errors, expected[told])[:, 0]
    if len(recorded.heard) == 2:
        beat_std = pooled([s.beat[:, None] for s in recorded.sweeps])[:, 0]
    shared = _AMPLITUDE_SHARED if len(recorded.heard) == 2 else 1.0
    amplitude_std = np.where(known.power(), shared * pooled([s.amplitude for s in recorded.sweeps]), np.inf)
    return range_std, beat_std, amplitude_std


def _harmonic_scatter(recorded: RecordedSweeps) -> np.ndarray:
    """Return by what harmonics scatter from sweep to sweep (G, S, 2 H), alike in both parts of each."""
    if not recorded.scatters:
        return np.full((len(recorded.members), *recorded.sweeps[0].harmonic.shape[1:]), np.inf)
    variance = np.array([s.harmonic.var(axis=0, ddof=1) for s in recorded.sweeps])
    both = variance.reshape(*variance.shape[:2], 2, -1).mean(axis=2)
    counts = np.array([len(s.harmonic) for s in recorded.sweeps])
    both *= _unsure(2 * (counts - 1))[:, None, None]
    return np.sqrt(np.nan_to_num(np.tile(both, 2), nan=np.inf))


def _unsure(freedom: np.ndarray | int) -> np.ndarray:
    """Return by what a variance grows that few sweeps tell, so that residuals over it are 1 in the mean square.

    They are distributed after Student.
    """
    return freedom / np.maximum(freedom - 2.0, 1.0)


def _coherence_scatter(recorded: RecordedSweeps, known: Known) -> np.ndarray:
    """Return by what shares in the coherence scatter from sweep to sweep (G, OFFSETS); inf where not compared."""
    if not (recorded.scatters and len(recorded.heard) == 2 and known.noise().all()):
        return np.full((len(recorded.members), coherence.OFFSETS), np.inf)
    counts = np.array([len(s) for s in recorded.shares])
    # each sweep's share is told beside the mean of both lines' noise, which takes one more sweep from their scatter
    scatter = pooled(recorded.shares) * np.sqrt((counts - 1.0) / (counts - 2.0))[:, None]
    present = np.array([np.any(s != 0.0, axis=0) for s in recorded.shares])
    limit = _COHERENCE_LIMIT * np.sqrt(counts)[:, None]
    return np.where(present, np.hypot(scatter, limit), np.inf)


def _variances(
    recorded: RecordedSweeps, sweeps: SweepFeatures, ramp: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return variances of one sweep of a group: of the ramp's terms but the free ones, and of the means (S, Q).

    Args:
        recorded: all groups.
        sweeps: features of one.
        ramp: cosine series of the same (n, 2 S, K).
        noise: in bands (S, BANDS) [dB of 1 LSB^2 per sample].
    """
    if recorded.scatters:
        variance = ramp[..., _FREE:].var(axis=0, ddof=1)
        mean_variance = sweeps.mean.var(axis=0, ddof=1) * _unsure(len(ramp) - 1)
        return uniform_filter1d(variance, _SMOOTH, mode='nearest', axis=-1), mean_variance
    white = 10.0 ** (np.nanmedian(noise, axis=1) / 10.0)
    variance, mean_variance = recorded.parts[0].extract.white_noise(sweeps, white)
    return variance[:, None], mean_variance


def _flutter(ramp: np.ndarray, scatters: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return variances over what noise makes of them, and what noise makes of them, (2 S, K) each.

    Args:
        ramp: cosine series of a group's sweeps (n, 2 S, K).
        scatters: they are enough to tell a variance; it is 1 else.
    """
    if not scatters:
        return np.ones(ramp.shape[1:]), np.ones(ramp.shape[1:])
    squares = (ramp - ramp.mean(axis=0)) ** 2
    power = squares[..., STEADY:].mean(axis=-1, keepdims=True)
    # a single noisy sweep must not tell how all scatter
    weight = np.minimum(np.median(power, axis=0) / power, 1.0)
    variance = len(ramp) / (len(ramp) - 1) * np.sum(weight * squares, axis=0) / np.sum(weight, axis=0)
    trend = _trend(variance)
    around = trend * local_noise(variance / trend, _FLUTTER_MEDIAN) / median_of_mean((len(ramp) - 1) / 2)
    return variance / around, around


def _trend(variance: np.ndarray) -> np.ndarray:
    """Return the smooth course of spectra of noise (C, K), which a median over neighbours alone would cut off.

    A polynomial through their logarithms over that of the term, without what stands out above.
    """
    term = np.log(np.arange(variance.shape[-1]) + 1.0)
    basis = np.polynomial.chebyshev.chebvander(2.0 * term / term[-1] - 1.0, _TREND)
    result = np.empty(variance.shape)
    for row, values in enumerate(np.log(np.maximum(variance, 1e-300))):
        kept = np.arange(len(values)) >= STEADY
        for _ in range(_TREND_ROUNDS):
            coefficients = np.linalg.lstsq(basis[kept], values[kept], rcond=None)[0]
            above = values - basis @ coefficients
            kept &= above < _TREND_ABOVE * above[kept].std()
        result[row] = basis @ coefficients
    result[:, :STEADY] = result[:, STEADY, None]  # which it does not follow
    return np.exp(result)


def _movement_by_phase(sweeps: SweepFeatures, wave: float, told: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement within a group by the carrier phase [m] (n,), and its deviation: inf if not told.

    Noise of whatever shape shows in how the phase bends from sweep to sweep, where a crane hardly does.
    """
    turned = np.unwrap(sweeps.carrier) * wave
    wander = noise_by_bends(turned) if len(turned) >= _TELLING else 0.0
    std = np.hypot(np.maximum(sweeps.phase_std * wave, wander), _MOVEMENT_LIMIT)
    return turned - turned.mean(), std if told else np.full(len(turned), np.inf)


def _movement_by_range(
    sweeps: SweepFeatures, error: np.ndarray, reference_std: np.ndarray, told: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return what a drive's range shows beyond the reference [m] (n,), and its deviation: inf if not told.

    From sweep to sweep a drive passes more wavelengths than the reference can count, so the phase tells nothing.
    """
    std = np.hypot(sweeps.range_std, np.nan_to_num(reference_std))
    return error - error.mean(), std if told else np.full(len(error), np.inf)
