"""Faults that the histogram of an ADC's codes shows: stuck bits, missing codes, limits at which samples pile up.

Noise with a standard deviation of several codes makes the histogram of the samples smooth, whatever the signal: its
fourth differences are those of counting noise alone. A stuck bit leaves combs of empty codes; a converter with gaps
leaves steps at their ends. Without this test, such a fault would pass for a higher noise floor and a leakage. A limiter
leaves more samples at the outermost codes than at the next ones, which noise never does.
"""

import dataclasses

import numpy as np
from scipy import stats

from .limits import CODES

_DIFFERENCE = np.array([1.0, -4.0, 6.0, -4.0, 1.0])


@dataclasses.dataclass(frozen=True)
class Codes:
    """How uneven a station's codes are."""

    probability: float  # of as much unevenness by chance
    excess: float  # sum of squared differences over their variances, less its expectation
    low: float  # codes between which the excess lies [LSB]
    high: float


def smooth(samples: np.ndarray, noise: float) -> bool:
    """Return whether noise makes the histogram of codes smooth; arguments as those of `evenness`."""
    return _is_smooth(_in_steps(samples)[1], noise)


def piled(samples: np.ndarray) -> np.ndarray:
    """Return how many more samples a sweep has at its outermost codes than at the next ones, beyond chance (n,).

    Args:
        samples: (n, N), also analogue ones, or complex [LSB]. Analogue ones are rounded to codes that lie elsewhere for
            each sweep: whether a crest just reaches a further code is chance.
    """
    if np.iscomplexobj(samples):
        return piled(samples.real) + piled(samples.imag)
    apart = np.arange(len(samples)) * CODES.golden % 1.0 - 0.5
    codes = np.rint(samples + (CODES.within * apart[:, None]).astype(np.float32))
    more = np.zeros(len(codes))
    for outermost in (codes.max(axis=1), codes.min(axis=1)):
        depth = np.abs(codes - outermost[:, None])
        more += 2.0 * (depth < CODES.outermost).sum(axis=1) - (depth < 2 * CODES.outermost).sum(axis=1)
    return np.maximum(more - CODES.pile, 0.0)


def _in_steps(samples: np.ndarray) -> tuple[np.ndarray, int]:
    """Return codes in steps from the lowest, and the step [LSB]: above 1 if the lowest bits are always 0."""
    codes = samples.ravel().astype(np.int64) - int(samples.min())
    step = max(int(np.gcd.reduce(codes)), 1)
    return codes // step, step


def _is_smooth(step: int, noise: float) -> bool:
    return noise >= CODES.least_noise * step


def evenness(samples: np.ndarray, noise: float) -> Codes | None:
    """Return how uneven the codes of one station are, None where there is too little noise or too few counts.

    Args:
        samples: int16, any shape [LSB].
        noise: standard deviation per sample [LSB].
    """
    codes, step = _in_steps(samples)
    if not _is_smooth(step, noise):
        return None
    counts = np.bincount(codes).astype(float)[CODES.rail : -CODES.rail]
    if len(counts) < CODES.neighbours:
        return None
    around = np.convolve(counts, np.full(CODES.neighbours, 1.0 / CODES.neighbours), 'same')[2:-2]
    enough = around >= CODES.least_count
    z = np.convolve(counts, _DIFFERENCE, 'valid')[enough] / np.sqrt((_DIFFERENCE @ _DIFFERENCE) * around[enough])
    if len(z) < CODES.neighbours:
        return None
    freedom = len(z) / CODES.correlated
    chances = (
        float(stats.chi2.sf(float(np.mean(z**2)) * freedom / CODES.tails, freedom)),
        min(1.0, len(z) * 2.0 * float(stats.norm.sf(float(np.abs(z).max()) / CODES.tails))),
    )
    code = int(samples.min()) + step * (np.flatnonzero(enough) + CODES.rail + 2)
    weight = np.cumsum(np.where(np.abs(z) > min(CODES.stands_out, float(np.abs(z).max())) - 1e-9, z**2, 0.0))
    low, high = code[np.searchsorted(weight, [0.05 * weight[-1], 0.95 * weight[-1]]).clip(0, len(code) - 1)]
    return Codes(min(1.0, len(chances) * min(chances)), float(np.sum(z**2) - len(z)), float(low), float(high))
