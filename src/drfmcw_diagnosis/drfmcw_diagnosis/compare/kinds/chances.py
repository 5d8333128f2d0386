"""Chances of whitened remainders: how probable noise alone makes what an explanation leaves."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import scipy.fft
from scipy import stats

from ..algebra import scaled_inverse
from ..limits import LEFTOVER


@dataclasses.dataclass(frozen=True)
class Remainder:
    """What an explanation leaves of n whitened numbers, seen from one row of one kind."""

    rest: np.ndarray  # (n,) residuals less the explanation, weighted
    weight: np.ndarray  # (n,) by which doubt about the forward models lowers each number
    slopes: np.ndarray  # (P, n) of the explanation's parameters, weighted
    chosen: np.ndarray  # which of them are the row's numbers, in order
    std: np.ndarray  # (G, ...) standard deviations of the row's numbers
    usual_count: int  # sweeps that a group usually holds

    @property
    def nonzero(self) -> np.ndarray:
        """The row's numbers that are compared (m,)."""
        z = self.rest[self.chosen]
        return z[z != 0.0]

    def by_group(self) -> np.ndarray:
        """Return the row's numbers (G, positions)."""
        return self.rest[self.chosen].reshape(len(self.std), -1)


def combined(chances: Sequence[float]) -> float:
    """Return the chance of the least probable of several findings (Bonferroni)."""
    return min(1.0, len(chances) * min(chances))


def amounts(z: np.ndarray, correlated: float, scatter: int) -> list[float]:
    """Return the chances of so much in all numbers of a row together, and in the largest.

    Args:
        z: whitened.
        correlated: numbers that share their noise.
        scatter: degrees of freedom of the standard deviations, 0 where more than a group's scatter gives them. Few
            degrees of freedom make the heavier tails of Student's distribution. With two the squares have no mean, and
            with one not even the numbers have: only the largest counts then.
    """
    count = len(z) / correlated
    scatter = scatter or LEFTOVER.tails_freedom
    heavier = (scatter - 1.0) / max(scatter - 4.0, 0.5)  # variance of the squares, over that of normal noise
    largest = float(np.abs(z).max()) * math.sqrt(scatter / max(scatter - 2.0, 1.0))
    most = min(1.0, len(z) * 2.0 * float(stats.t.sf(largest, scatter)))
    if scatter <= 2:
        return [most]
    return [float(stats.chi2.sf(float(np.mean(z**2)) * count / heavier / LEFTOVER.squares, count / heavier)), most]


def common(rest: np.ndarray) -> list[float]:
    """Return the chances of what all groups have in common over the sweep (G, K): in all terms, and in any window."""
    used = np.any(rest != 0.0, axis=0)
    mean = rest.sum(axis=0) / math.sqrt(len(rest))
    over_time = scipy.fft.idct(mean, norm='ortho')
    windows = [
        np.abs(np.convolve(over_time, np.ones(width), 'valid')).max() / math.sqrt(width) for width in LEFTOVER.windows
    ]
    freedom = np.count_nonzero(used) / LEFTOVER.common_tails
    largest = stats.norm.sf(max(windows) / LEFTOVER.common_tails)
    return [
        float(stats.chi2.sf(np.mean(mean[used] ** 2) * freedom / LEFTOVER.common_tails, freedom)),
        float(min(1.0, len(LEFTOVER.windows) * len(over_time) * 2.0 * largest)),
    ]


def rhythm(rest: np.ndarray) -> float:
    """Return the chance of the most that sweeps of all groups change at one modulation frequency; `rest` (G, K).

    Over the scatter of all frequencies: noise that comes and goes spreads variances wider than steady noise does.
    """
    together = rest[:, np.any(rest != 0.0, axis=0)].sum(axis=0) / math.sqrt(len(rest))
    if not len(together):
        return 1.0
    spread = max(stats.median_abs_deviation(together, scale='normal'), 1.0)
    most = max(np.convolve(together, np.ones(width), 'valid').max() / math.sqrt(width) for width in LEFTOVER.rhythm)
    return float(min(1.0, len(LEFTOVER.rhythm) * len(together) * stats.norm.sf(most / spread / LEFTOVER.flutter_tails)))


def events(left: Remainder) -> float:
    """Return the chance of an event at one time of every sweep: a step, a kink, or a bump of some width.

    No effect of the registry is an event, but several together may imitate one. So an event is fitted together with
    the explanation: what the explanation's parameters can imitate of it does not count.

    Args:
        left: of a row of cosine series, whose standard deviations (G, K) are inf for terms that are free.
    """
    groups, count = left.std.shape
    share = left.weight[left.chosen].reshape(groups, count) / left.std
    shapes = scipy.fft.dct(_shapes(count), norm='ortho', axis=1)  # (M, K)
    remains = shapes @ np.sum(left.by_group() * share, axis=0)
    power = shapes**2 @ np.sum(share**2, axis=0)
    if len(left.slopes):
        slopes = left.slopes
        imitated = shapes @ np.einsum('pgk,gk->kp', slopes[:, left.chosen].reshape(-1, groups, count), share)
        inverse = scaled_inverse(slopes @ slopes.T)
        remains -= imitated @ (inverse @ (slopes @ left.rest))
        least = LEFTOVER.least_power * power
        power = np.maximum(power - np.einsum('mp,pq,mq->m', imitated, inverse, imitated), least)
    largest = np.max(np.abs(remains) / np.sqrt(power))
    return float(min(1.0, len(shapes) * 2.0 * stats.norm.sf(largest / LEFTOVER.tails)))


def _shapes(count: int) -> np.ndarray:
    """Return events over `count` blocks (M, count)."""
    block = np.arange(count)
    at = np.arange(LEFTOVER.edge, count - LEFTOVER.edge)[:, None]
    steps = (block >= at).astype(float)
    kinks = np.maximum(block - at, 0.0)
    bumps = [np.exp(-0.5 * ((block - at) / width) ** 2) for width in LEFTOVER.widths]
    return np.concatenate([steps, kinks, *bumps])
