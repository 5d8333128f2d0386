"""The white or coloured noise of sweeps, from cells of IF frequency and Doppler shift beside all lines."""

import dataclasses
import itertools
import math

import numpy as np
from scipy.signal import windows

from .limits import NOISE


@dataclasses.dataclass(frozen=True)
class Noise:
    """Noise of each sample: mean square of a real one, or of a complex one."""

    power: np.ndarray  # (N,) at each bin of the sweep's spectrum; its mean is the noise's mean square [LSB^2]
    freedom: float  # degrees of freedom from which the mean was estimated

    @property
    def mean(self) -> float:
        """Mean square [LSB^2]."""
        return float(np.mean(self.power))

    @property
    def evenness(self) -> float:
        """Share of the samples' degrees of freedom that a sum of squares of this noise has [1]."""
        return float(np.mean(self.power) ** 2 / np.mean(self.power**2))


def noise(signal: np.ndarray) -> Noise:
    """Return the noise of sweeps (n, N), real or complex.

    In each band of the IF, cells that stand out are left out and the rest taken as the lower part of an exponential
    distribution. Sweeps enough to separate Doppler shifts leave most cells to the noise: what is the same in every
    sweep holds few of them, whatever its spectrum.
    """
    count, length = signal.shape
    flat = signal - signal.mean(axis=1, keepdims=True)
    fast = windows.hann(length, sym=False) if count >= NOISE.doppler else windows.blackmanharris(length, sym=False)
    cells = np.fft.fft(flat * (fast / np.sqrt(np.sum(fast**2))), axis=1)
    overlap = _overlap(fast)
    if count >= NOISE.doppler:
        slow = windows.hann(count, sym=False)
        cells = np.fft.fft(cells * (slow / np.sqrt(np.sum(slow**2)))[:, None], axis=0)
        cells = cells[NOISE.still : count - NOISE.still + 1]
        overlap *= _overlap(slow)
    power = np.abs(cells) ** 2
    bins = np.arange(length)
    folded = bins if np.iscomplexobj(signal) else np.minimum(bins, length - bins)
    used = np.minimum(bins, length - bins) > NOISE.lowest
    half = length if np.iscomplexobj(signal) else length // 2 + 1
    bands = max(1, min(NOISE.bands, half * len(power) // NOISE.cells, half // NOISE.widest))
    edges = np.linspace(0, half, bands + 1).astype(int)
    levels, middles, freedom = [], [], 0.0
    for low, high in itertools.pairwise(edges):
        own = power[:, (folded >= low) & (folded < high) & used].ravel()
        if own.size:
            level, kept = _exponential(own)
            levels.append(level)
            middles.append(0.5 * (low + high - 1))
            freedom += 2.0 * kept / overlap * (1.0 if np.iscomplexobj(signal) else 0.5)
    least = (2.0 if np.iscomplexobj(signal) else 1.0) / 12.0
    curve = np.interp(folded, middles, levels) if levels else np.full(length, least)
    return Noise(np.maximum(curve, least), max(freedom, 1.0))


def _exponential(power: np.ndarray) -> tuple[float, int]:
    """Return the mean of the exponential distribution that powers follow below where they stand out, and their number.

    The part below a bound b of a mean m has the mean m - b / (exp(b / m) - 1).
    """
    level = float(np.quantile(power, NOISE.quantile)) / -math.log(1.0 - NOISE.quantile)
    kept = power
    for _ in range(NOISE.rounds):
        bound = NOISE.outlier * level
        kept = power[power < bound]
        if not kept.size:
            return max(level, 1e-12), 1
        level = float(kept.mean()) / (1.0 - NOISE.outlier / math.expm1(NOISE.outlier))
    return max(level, 1e-12), int(kept.size)


def _overlap(window: np.ndarray) -> float:
    """Return how many neighbouring cells behind a window stand for one independent power [1]."""
    correlation = np.abs(np.fft.fft(window**2)) ** 2
    return float(np.sum(correlation) / correlation[0])
