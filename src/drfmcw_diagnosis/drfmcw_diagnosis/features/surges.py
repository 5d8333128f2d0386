"""How much the power beside a line rises within a sweep, as where another transmitter crosses the band.

Noise is made as strong at all frequencies, so what a steady sweep shows is known beforehand whatever its spectrum, see
`steady`. Only the oscillators' noise, which lies on both sides of a line alike, fluctuates more than white noise: how
much is measured where the power is low, of which no burst takes part.
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre
from scipy.ndimage import minimum_filter1d

from drfmcw_physics.sweep import SweepSettings

from .limits import SPECTRUM, SURGES
from .spectra import gaussian, row_medians

NUMBERS = 1 + 2 * len(SURGES.windows)
"""How many numbers `unevenness` returns."""

_TINY = float(np.finfo(np.float32).tiny)


@dataclasses.dataclass(frozen=True)
class Steady:
    """What steady noise makes of `scores`; W windows."""

    mean: np.ndarray  # (2 W,)
    std: np.ndarray  # of one sweep (2 W,)
    apart: np.ndarray  # (2 W, 2 W) matrix that makes their noise over its standard deviation uncorrelated
    count: int  # sweeps from which all that is known


def measured(samples: np.ndarray, frequency: np.ndarray, weights: np.ndarray, sweep: SweepSettings) -> np.ndarray:
    """Return the largest power in windows of W lengths of each sweep, as standard normals, and its spread (n, W + 1).

    The spread is that of the powers below their median, in the shortest windows, over that of white noise. All are zero
    in sweeps too short for it.

    Args:
        samples: of a station (n, N), real or complex [LSB]; what changes the noise in most of them alike is no surge.
        frequency: of its line (n,) [Hz].
        weights: of the analysis window (N,), zero outside.
        sweep: its settings.
    """
    return _measured(samples, frequency / sweep.sample_rate, weights)


def _measured(samples: np.ndarray, frequency: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return what `measured` does, with frequencies in cycles per sample."""
    count, iq = samples.shape[1], np.iscomplexobj(samples)
    band, kept = _bins(count, iq)
    if kept == 0:
        return np.zeros((len(samples), len(SURGES.windows) + 1))
    flat = _flat(weights)
    spectrum = (np.fft.fft if iq else np.fft.rfft)(samples * flat, axis=1)
    at = np.rint(frequency * count).astype(int) % count
    first = np.clip(at - SPECTRUM.line - SPECTRUM.edge, 0, kept)[:, None]  # of the line's neighbourhood
    used = np.arange(kept) + np.where(np.arange(kept) < first, 0, band - kept)
    beside = np.zeros((len(samples), band), spectrum.dtype)
    white = _whitened(np.take_along_axis(spectrum, SPECTRUM.edge + used, axis=1), flat)
    np.put_along_axis(beside, used, white, axis=1)
    return _largest(beside, np.interp(np.arange(band) * (count / band), np.arange(count), flat), count, kept / band)


def scores(surge: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Return of each sweep of a group by how much it rises and, up to 1, whether it does (n, 2 W).

    Args:
        surge: of the group's sweeps, as `measured` (n, W + 1).
        weights: of the sweeps (n,); None: all count alike.
    """
    spread = max(float(np.average(surge[:, -1], weights=weights)), SURGES.least_spread)
    over = np.maximum(surge[:, :-1] / spread - np.array(SURGES.usual), 0.0)
    return np.concatenate([np.log1p(over), np.minimum(over / SURGES.sure, 1.0)], axis=1)


def steady(sweep: SweepSettings, iq: bool) -> Steady | None:
    """Return what steady noise makes of `scores`, None in sweeps too short for any.

    Args:
        sweep: settings.
        iq: whether the samples are complex.
    """
    if _bins(sweep.sample_count, iq)[1] == 0:
        return None
    first, last = (round(at * sweep.sample_rate / SURGES.block) for at in sweep.analysis_window())
    return _steady(sweep.sample_count, first, last, iq)


@functools.lru_cache(maxsize=16)
def _steady(count: int, first: int, last: int, iq: bool) -> Steady:
    """Return the same of sweeps of `count` samples whose window reaches from block `first` to block `last`."""
    generator = np.random.default_rng(SURGES.seed)
    weights = np.zeros(count)
    weights[first * SURGES.block : last * SURGES.block] = 1.0
    line = np.full(SURGES.group, 0.25)  # of the sample rate
    found = []
    for _ in range(SURGES.groups):
        parts = generator.standard_normal((2 if iq else 1, SURGES.group, count), np.float32)
        noise = parts[0] + 1j * parts[1] if iq else parts[0]
        found.append(scores(_measured(noise, line, weights)))
    values = np.concatenate(found)
    std = np.maximum(values.std(axis=0), SURGES.least_std)
    correlation = np.cov((values / std).T) + SURGES.singular * np.eye(len(std))
    return Steady(values.mean(axis=0), std, np.linalg.inv(np.linalg.cholesky(correlation)), len(values))


def unevenness(
    quiet: Sequence[np.ndarray], surge: Sequence[np.ndarray], weights: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """Return how unevenly power is spread over sweeps (NUMBERS,), and the first's standard deviation if it is steady.

    Logarithm of the mean of the spans' squares over the sweeps, over its median; then the mean of `scores`.

    Args:
        quiet: power in spans of each group's sweeps (n, T).
        surge: of the same, as `measured` (n, W + 1).
        weights: of the sweeps of each group (n,); None: all count alike.
    """
    # what changes over all sweeps of a group alike is no burst; simulated sweeps have no such course
    usual = (np.median(x, axis=0) if weights is None else _median(x, weights) for x in quiet)
    over = [x / np.maximum(middle, _TINY) for x, middle in zip(quiet, usual, strict=True)]
    square = np.concatenate([np.mean(x**2, axis=1) for x in over])
    each = np.concatenate([scores(x, weights) for x in surge])
    every = None if weights is None else np.tile(weights, len(quiet))
    middle = _median(square, every)
    spread = 1.4826 * _median(np.abs(square - middle), every) / middle  # of normal noise
    spread = max(spread, 2.0 / np.sqrt(SPECTRUM.span * quiet[0].shape[1]))  # of white noise in I and Q, the evenest
    skewed = SURGES.skewed * spread**2
    value = np.log(np.average(square, weights=every) / middle) - skewed
    std = float(np.hypot(spread / np.sqrt(len(square)), 0.5 * skewed))
    return np.array([value, *np.average(each, axis=0, weights=every)]), std


def _median(values: np.ndarray, weights: np.ndarray | None) -> float:
    """Return the median of all values (n, ...), of which each row has a weight (n,)."""
    if weights is None:
        return float(np.median(values))
    order = np.argsort(values, axis=None)
    share = np.cumsum(np.repeat(weights, values.size // len(values))[order])
    return float(values.ravel()[order][np.searchsorted(share, 0.5 * share[-1])])


def surge_power(window: int, beyond: float) -> float:
    """Return the power of a burst over that of the noise with which a window of its length [samples] shows it.

    Args:
        window: its length [samples].
        beyond: standard deviations beyond those of a steady sweep.
    """
    # by Wilson and Hilferty, with one degree of freedom per sample
    normal = np.interp(window, SURGES.windows, SURGES.usual) + beyond
    return float((1.0 + normal / np.sqrt(4.5 * window)) ** 3 - 1.0)


def _bins(count: int, iq: bool) -> tuple[int, int]:
    """Return how many bins a band has, and how many of them are kept beside a line; 0 where there are too few."""
    band = (count if iq else count // 2) - 2 * SPECTRUM.edge
    blocks = (band - 2 * SPECTRUM.line - 1) // SURGES.block
    return band, blocks * SURGES.block if blocks >= SURGES.fewest_blocks else 0


def _flat(weights: np.ndarray) -> np.ndarray:
    """Return a window that is flat over most of the one given (N,): where it fades, a filter would show as a surge.

    It rises and falls as smoothly as can be (McKechan, Robinson and Sathyaprakash 2010), so that lines are narrow.
    """
    inside = np.flatnonzero(weights > 0.0)
    count = inside[-1] + 1 - inside[0]
    from_end = np.minimum(np.arange(count), np.arange(count)[::-1]) + 0.5
    x = np.clip(from_end / (SURGES.taper * count), 1e-3, 1.0 - 1e-3)
    flat = np.zeros(len(weights), np.float32)
    flat[inside[0] : inside[-1] + 1] = 1.0 / (1.0 + np.exp(1.0 / x - 1.0 / (1.0 - x)))
    return flat


def _whitened(bins: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Return the bins of a spectrum (n, M) with the same noise in all, lines held down and strong ones left out.

    Args:
        bins: of a spectrum (n, M).
        flat: window of the samples (N,).
    """
    power = bins.real**2 + bins.imag**2
    lines = _near_lines(power, flat)
    noise = _between(_medians(np.where(lines, np.nan, power)), bins.shape[1])
    over = np.sqrt(power / noise)
    held = np.where(lines, 0.0, np.minimum(1.0, SURGES.highest / np.maximum(over, 1e-9)))
    return bins / np.sqrt(noise) * held


def _near_lines(power: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Return which bins are near a strong line, whose power they hold (n, M)."""
    leaked = np.abs(np.fft.rfft(flat, 2 * len(flat)))
    leaked = np.maximum(leaked[:-1:2], leaked[1::2]) / leaked[0]  # up to each whole bin from a line
    leaked = np.maximum.accumulate(leaked[::-1])[::-1]
    least = minimum_filter1d(_medians(power), 3, axis=1)  # a strong line raises the median around it
    over = np.sqrt(power / _between(least, power.shape[1]))
    strong = np.where(over > SURGES.line, over, 0.0)
    near = strong > 0.0
    for apart in range(1, int(np.count_nonzero(leaked * strong.max() > SURGES.leaked))):
        shown = strong * leaked[apart] > SURGES.leaked
        near[:, apart:] |= shown[:, :-apart]
        near[:, :-apart] |= shown[:, apart:]
    return near


def _medians(power: np.ndarray) -> np.ndarray:
    """Return the noise in blocks of bins (n, blocks), by their median; NaN counts as nothing."""
    median, count = row_medians(power.reshape(len(power), -1, SURGES.block))
    middle = median / np.log(2.0)
    usual = np.nanmedian(middle, axis=1, keepdims=True)
    middle = np.where(count < SURGES.block // 4, usual, middle)
    return np.maximum(np.nan_to_num(middle), _TINY)


def _between(blocks: np.ndarray, count: int) -> np.ndarray:
    """Return numbers of blocks (n, blocks) at each of `count` bins, linear from middle to middle."""
    centre = (np.arange(blocks.shape[1]) + 0.5) * SURGES.block - 0.5
    result: np.ndarray = blocks @ np.array([np.interp(np.arange(count), centre, one) for one in np.eye(len(centre))])
    return result


def _course(power: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Return how the noise changes over most of the sweeps (M,): a gain, or the line itself, changes over each alike.

    Args:
        power: over each sweep (n, M).
        flat: window over the sweep (M,).
    """
    shapes = legendre.legvander(np.linspace(-1.0, 1.0, len(flat)), SURGES.course).T
    sizes = power @ np.linalg.pinv(flat**2 * shapes)  # (n, 1 + course)
    usual = np.median(sizes / np.maximum(sizes[:, :1], _TINY), axis=0)
    return np.asarray(np.maximum(usual @ shapes, SURGES.lowest))


def _largest(beside: np.ndarray, flat: np.ndarray, count: int, share: float) -> np.ndarray:
    """Return the largest power in windows, as standard normals, and its spread (n, W + 1).

    Args:
        beside: spectrum of white noise, zero at the line (n, M).
        flat: window over the sweep (M,).
        count: samples of the sweep.
        share: of the bins that are not zero.
    """
    power = np.abs(np.fft.ifft(beside, axis=1)) ** 2
    power /= _course(power, flat)
    power = np.cumsum(np.pad(power, ((0, 0), (1, 0))), axis=1)
    expected = np.cumsum(np.pad(flat**2, (1, 0)))
    found = np.zeros((len(beside), len(SURGES.windows) + 1))
    for number, window in enumerate(SURGES.windows):
        points = round(window * len(flat) / count)
        starts = np.arange(0, len(flat) - points, max(points // 4, 1))
        inside = expected[starts + points] - expected[starts]
        starts, inside = starts[inside > SURGES.inside * points], inside[inside > SURGES.inside * points]
        if points < SURGES.fewest_points or len(starts) < SURGES.fewest_windows:
            continue
        usual = np.maximum(power[:, -1:], _TINY) / expected[-1]
        over = (power[:, starts + points] - power[:, starts]) / (inside * usual)
        normal = gaussian(over, points * share)
        found[:, number] = normal.max(axis=1)
        if number == 0:
            below, middle = np.quantile(normal, (SURGES.below, 0.5), axis=1)
            found[:, -1] = middle - below
    return found
