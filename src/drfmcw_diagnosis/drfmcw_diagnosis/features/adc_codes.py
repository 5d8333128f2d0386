"""What the codes of an ADC tell: bits that stick, codes that are missing, and limits at which samples pile up.

Noise of some codes' width makes the histogram of the samples smooth, whatever the signal: its fourth differences
are those of counts alone. A stuck bit leaves combs of empty codes, a converter with gaps steps at their ends. Noise and
mean of the samples would pass for a higher floor and a leakage. A limiter leaves more samples at the outermost code
than at the next, which noise never does.
"""

import dataclasses

import numpy as np
from scipy import stats

_DIFFERENCE = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
_LEAST_NOISE = 4.0  # standard deviation from which on the noise makes the histogram smooth [codes]
_LEAST_COUNT = 25.0  # in a code's neighbourhood, for counts to be normal
_NEIGHBOURS = 9  # codes whose mean count tells the deviation of one
_RAIL = 5  # codes next to the smallest and to the largest, in which a limiter piles samples up
_CORRELATED = 2.7  # fourth differences share their counts: sum of their squared correlations
_STANDS_OUT = 4.0  # deviations from which on a difference counts for where the excess lies
_PILE = 3  # samples more than at the next code that a sweep may have at its outermost ones by chance
_TAILS = 1.05  # by which they may be larger


@dataclasses.dataclass(frozen=True)
class Codes:
    """How uneven a station's codes are."""

    probability: float  # of so much by chance
    excess: float  # of squared differences over their deviations, less their number
    low: float  # codes between which the excess lies [LSB]
    high: float


def smooth(samples: np.ndarray, noise: float) -> bool:
    """Return whether noise makes the histogram of codes smooth; arguments as those of `evenness`."""
    return _is_smooth(_in_steps(samples)[1], noise)


def piled(samples: np.ndarray) -> np.ndarray:
    """Return how many more samples a sweep has at its outermost codes than at the next ones, beyond chance (n,).

    Args:
        samples: (n, N), also before the ADC, whose codes they are rounded to, or complex [LSB].
    """
    if np.iscomplexobj(samples):
        return piled(samples.real) + piled(samples.imag)
    codes = np.rint(samples)
    more = np.zeros(len(codes))
    for outermost, inwards in ((codes.max(axis=1), -1.0), (codes.min(axis=1), 1.0)):
        at, beside = ((codes == code[:, None]).sum(axis=1) for code in (outermost, outermost + inwards))
        more += at - beside
    return np.maximum(more - _PILE, 0.0)


def _in_steps(samples: np.ndarray) -> tuple[np.ndarray, int]:
    """Return codes in steps from the lowest, and the step [LSB]: an ADC of fewer bits may leave the lowest at zero."""
    codes = samples.ravel().astype(np.int64) - int(samples.min())
    step = max(int(np.gcd.reduce(codes)), 1)
    return codes // step, step


def _is_smooth(step: int, noise: float) -> bool:
    return noise >= _LEAST_NOISE * step


def evenness(samples: np.ndarray, noise: float) -> Codes | None:
    """Return how uneven the codes of one station are, None where noise or counts are too few to tell.

    Args:
        samples: int16, any shape [LSB].
        noise: standard deviation per sample [LSB].
    """
    codes, step = _in_steps(samples)
    if not _is_smooth(step, noise):
        return None
    counts = np.bincount(codes).astype(float)[_RAIL:-_RAIL]
    if len(counts) < _NEIGHBOURS:
        return None
    around = np.convolve(counts, np.full(_NEIGHBOURS, 1.0 / _NEIGHBOURS), 'same')[2:-2]
    told = around >= _LEAST_COUNT
    z = np.convolve(counts, _DIFFERENCE, 'valid')[told] / np.sqrt((_DIFFERENCE @ _DIFFERENCE) * around[told])
    if len(z) < _NEIGHBOURS:
        return None
    freedom = len(z) / _CORRELATED
    chances = (
        float(stats.chi2.sf(float(np.mean(z**2)) * freedom / _TAILS, freedom)),
        min(1.0, len(z) * 2.0 * float(stats.norm.sf(float(np.abs(z).max()) / _TAILS))),
    )
    code = int(samples.min()) + step * (np.flatnonzero(told) + _RAIL + 2)
    weight = np.cumsum(np.where(np.abs(z) > min(_STANDS_OUT, float(np.abs(z).max())) - 1e-9, z**2, 0.0))
    low, high = code[np.searchsorted(weight, [0.05 * weight[-1], 0.95 * weight[-1]]).clip(0, len(code) - 1)]
    return Codes(min(1.0, len(chances) * min(chances)), float(np.sum(z**2) - len(z)), float(low), float(high))
