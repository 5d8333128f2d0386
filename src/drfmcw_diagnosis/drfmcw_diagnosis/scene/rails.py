"""Samples at a limit: codes that pile up at the rails, and plateaus on which the noise is gone."""

import dataclasses
import math

import numpy as np
from scipy import stats

from .limits import MATERIAL, RAILS
from .material import Material


@dataclasses.dataclass(frozen=True)
class Limit:
    """How a receiver limits."""

    level: float  # of the limit [LSB]
    level_std: float  # [LSB]
    share: float  # of the samples that stand at it [1]
    probability: float  # that so many stand there by chance
    at: np.ndarray  # samples at the limit, shape of `Material.parts`, bool
    pole: tuple[float, float] | None = None  # of a high-pass behind it, and its standard deviation [Hz]


def limit(m: Material) -> Limit | None:
    """Return the limit at which samples stand, None where none does."""
    return _rail(m) or _plateaus(m)


def _rail(m: Material) -> Limit | None:
    codes = m.parts
    if codes.size < RAILS.least or not codes.any():
        return None
    outermost = float(np.abs(codes).max())
    widths = [w for w in RAILS.widths if w <= max(8.0, 4.0 * m.noise) and w <= max(1.0, 0.01 * outermost)]
    found: list[tuple[float, float, np.ndarray, float]] = []
    for sign in (1.0, -1.0):
        side = sign * codes
        tops = -np.partition(-side.ravel(), RAILS.outliers[-1])[: RAILS.outliers[-1] + 1]
        tops.sort()
        for top in (float(tops[-1 - k]) for k in RAILS.outliers):
            piled = _piled(side, top, widths, m.white) if top >= RAILS.high * outermost else None
            if piled is not None:
                found.append(piled)
                break
    if not found:
        return None
    levels = [level for level, *_ in found]
    at = np.any([x for _, _, x, _ in found], axis=0)
    std = max(*(s for _, s, *_ in found), (max(levels) - min(levels)) / 2.0)
    return Limit(float(np.mean(levels)), std, float(at.mean()), min(1.0, *(p for *_, p in found)), at)


def _piled(
    side: np.ndarray, top: float, widths: list[int], noise: float
) -> tuple[float, float, np.ndarray, float] | None:
    """Return (level, std [LSB], samples at it, chance) of a rail just below `top`, None where no samples pile up."""
    for width in widths:
        at = side > top - width
        above = int(np.count_nonzero(side > top))
        count = int(at.sum()) - above
        beside = int(np.count_nonzero((side <= top - width) & (side > top - (1 + RAILS.beside) * width)))
        spread = len(np.unique(np.nonzero(at)[1]))  # a spike at one time of every sweep is no limit
        enough = count >= max(RAILS.fewest, RAILS.share * side.size) and spread >= RAILS.fewest // 2
        enough &= above <= RAILS.beyond * count
        # noise spreads a crest over more than one code, whether samples at it follow each other or not
        wall = width == 1 and not above and noise >= RAILS.noisy and count > RAILS.wall * max(beside, 1)
        cut = wall or (_in_runs(at) and _cut_off(side, at))
        if enough and count > RAILS.excess * max(beside, 1) and cut:
            return float(np.median(side[at])), width / math.sqrt(12.0), at, _tail(count, beside)
    return None


def _cut_off(side: np.ndarray, at: np.ndarray) -> bool:
    """Return whether the signal falls off beside the runs at the rail more steeply than from a crest.

    A crest that falls by s within half a run of n samples has fallen by s ((1 + 4 / n)^2 - 1) two samples further.
    """
    fallen = expected = 0.0
    for row, first, end in _runs(at):
        if end - first < 2 or first < 2 or end + 1 >= side.shape[1]:
            continue
        run = side[row, first:end]
        within = max(float(run.max() - run.min()), 1.0)
        fallen += float(run.mean()) - 0.5 * float(side[row, first - 2] + side[row, end + 1])
        expected += within * ((1.0 + 4.0 / len(run)) ** 2 - 1.0)
    return fallen > RAILS.steeper * expected > 0.0


def _in_runs(at: np.ndarray) -> bool:
    """Return True where samples at the rail follow each other, as where a signal exceeds it, and do so repeatedly."""
    together = int(np.count_nonzero(at[:, 1:] & at[:, :-1]))
    return together >= at.sum() // 4 and len(_runs(at)) >= RAILS.fewest // 2


def _tail(count: int, beside: int) -> float:
    """Return a bound of the chance of so many samples at the rail beside so many next to it (Chernoff)."""
    mean = max(float(beside), 1.0)
    return float(np.exp(min(0.0, count - mean - count * math.log(count / mean))))


def _plateaus(m: Material) -> Limit | None:
    """Return a limit in front of the last filters, behind which plateaus are smooth but may droop."""
    parts = m.parts
    if parts.shape[1] < 2 * RAILS.run:
        return None
    rough = np.abs(np.diff(parts, 4, axis=1))
    kernel = np.ones(16) / 16.0
    local = np.apply_along_axis(np.convolve, 1, rough, kernel, 'same')
    usual = float(np.quantile(local, RAILS.usual))
    if usual < 4.0 * math.sqrt(70.0 / 12.0):  # quantisation alone
        return None
    smooth = np.zeros(parts.shape, bool)
    smooth[:, 2:-2] = local < RAILS.smooth * usual
    smooth &= np.abs(parts) > RAILS.outer * float(np.abs(parts).max())
    runs = [r for r in _runs(smooth) if r[2] - r[1] >= RAILS.run]
    at = np.zeros(parts.shape, bool)
    for row, first, last in runs:
        at[row, first:last] = True
    if at.mean() < RAILS.plateaus or len(runs) < RAILS.fewest:
        return None
    droops = np.array([_droop(parts[row, first:last]) for row, first, last in runs]) * m.rate / (2.0 * np.pi)
    weights = np.array([float(last - first) for _, first, last in runs])
    pole = float(_weighted_median(droops, weights))
    std = MATERIAL.mad_to_std * float(np.median(np.abs(droops - pole))) / math.sqrt(len(runs))
    coupled = pole > 5.0 * std
    flat = parts + np.cumsum(parts, axis=1) * (2.0 * np.pi * pole / m.rate) if coupled else parts
    levels = np.array([float(np.median(flat[row, first:last])) for row, first, last in runs])
    sides = np.array([float(np.median(parts[row, first:last])) for row, first, last in runs]) > 0.0
    level, spread = _level(levels, sides)
    std = max(std, 0.05 * pole)
    # mean of as many absolute values of noise as are independent, below so small a share of the usual one
    single = float(stats.chi2.cdf(8.0 * RAILS.smooth**2, 8))
    chance = float(stats.binom.sf(len(runs) - 1, parts.size // RAILS.run, single))
    return Limit(level, spread, float(at.mean()), chance, at, (pole, std) if coupled else None)


def _runs(mask: np.ndarray) -> list[tuple[int, int, int]]:
    """Return (row, first, end) of the runs of True."""
    padded = np.zeros((mask.shape[0], mask.shape[1] + 2), np.int8)
    padded[:, 1:-1] = mask
    change = np.diff(padded, axis=1)
    rows, firsts = np.nonzero(change == 1)
    _, ends = np.nonzero(change == -1)
    return list(zip(rows.tolist(), firsts.tolist(), ends.tolist(), strict=True))


def _droop(values: np.ndarray) -> float:
    """Return the relative decline per sample of a plateau (n,)."""
    slope = float(np.polyfit(np.arange(len(values)), values, 1)[0])
    return -slope / float(np.mean(values))


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    at = np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())
    return float(values[order[min(int(at), len(values) - 1)]])


def _level(levels: np.ndarray, above: np.ndarray) -> tuple[float, float]:
    """Return half the distance of upper and lower plateaus and its standard deviation [LSB]."""
    if above.all() or not above.any():
        middle = np.abs(levels)
        return float(np.median(middle)), float(np.std(middle) / math.sqrt(len(levels)) + 1.0)
    upper, lower = levels[above], levels[~above]
    spread = math.hypot(float(np.std(upper)) / math.sqrt(len(upper)), float(np.std(lower)) / math.sqrt(len(lower)))
    return 0.5 * abs(float(np.median(upper) - np.median(lower))), 0.5 * spread + 1.0
