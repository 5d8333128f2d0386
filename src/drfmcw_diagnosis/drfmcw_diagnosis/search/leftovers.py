"""What an explanation leaves in the data, beyond chance: then something is missing that it does not name."""

import dataclasses
import math

import numpy as np
import scipy.fft
from scipy import stats

from .fitting import Fitted, Fitting, scaled_inverse

_WINDOWS = (2, 4, 8, 16, 32)  # blocks over which a remainder is looked for
_WIDTHS = (1.0, 2.5, 6.0)  # blocks, of events within the sweep
_EDGE = 4  # blocks at the sweep's ends in which no event is looked for
_RHYTHM = (1, 3)  # terms over which a rhythm of random phase spreads
_FLUTTER_TAILS = 1.15  # the same of variances over the median of those around
_BY_SCATTER = {'mean': 1, 'harmonic': 2}  # numbers whose own scatter alone tells their deviation, by kind
_TAILS_FREEDOM = 60  # of Student's distribution, of other deviations
_SQUARES = 1.03  # by which their squares may be larger
_TAILS = 1.05  # by which deviations told by scatter widen a normal distribution's tails


@dataclasses.dataclass(frozen=True)
class Leftover:
    """What one kind of number at one station still holds."""

    kind: str
    station: int
    probability: float  # of so much by chance
    excess: float  # of squared whitened residuals over their number


def leftovers(fitting: Fitting, fitted: Fitted | None) -> list[Leftover]:
    """Return what each kind of number still holds, least probable first.

    What the forward models may be off by counts as noise, see `Fitting.doubt`.
    """
    c = fitting.comparison
    template = fitted.template if fitted else np.zeros(len(c.residual))
    weight = 1.0 / np.sqrt(1.0 + fitting.doubt(fitted) ** 2)
    rest = (c.residual - template) * weight
    slopes = fitting.slopes(fitted) * weight if fitted else np.zeros((0, len(rest)))
    found = []
    usual = int(np.median([len(m) for m in c.members]))
    for kind, station in c.entries.kinds():
        chosen = c.entries.where(kind=kind, station=station)
        z = rest[chosen]
        z = z[z != 0.0]
        if len(z) < (1 if kind == 'piled' else 4):
            continue
        if kind == 'flutter':
            tests = [_rhythm(rest[chosen].reshape(len(c.members), -1))]
        else:
            tests = _amounts(z, kind, usual)
        if kind == 'ramp':
            tests += _common(rest[chosen].reshape(len(c.members), -1))
            tests.append(_events(rest, weight, slopes, chosen, c.std.ramp[:, station]))
        probability = min(1.0, len(tests) * min(tests))
        found.append(Leftover(kind, station, probability, float(np.sum(z**2) - len(z))))
    # no effect of the registry makes codes uneven
    told = ((station, codes) for station, codes in enumerate(c.codes) if codes is not None)
    found += [Leftover('codes', station, codes.probability, codes.excess) for station, codes in told]
    count = len(found)
    found = [dataclasses.replace(f, probability=min(1.0, count * f.probability)) for f in found]
    return sorted(found, key=lambda f: f.probability)


def _amounts(z: np.ndarray, kind: str, sweeps: int) -> list[float]:
    """Return the chances of so much in all numbers of a kind together, and in the largest.

    Args:
        z: whitened, not of sweep by sweep.
        kind: of these numbers.
        sweeps: that a group usually holds: deviations told by their scatter alone make Student's heavier tails.
    """
    # neighbouring bins of a Hann window share their noise
    count = len(z) / (1.9 if kind == 'lines' else 1.1)
    scatter = _BY_SCATTER.get(kind, 0) * (sweeps - 1) or _TAILS_FREEDOM
    heavier = (scatter - 1.0) / max(scatter - 4.0, 0.5)  # variance of the squares, over that of normal noise
    largest = float(np.abs(z).max()) * math.sqrt(scatter / max(scatter - 2.0, 1.0))
    return [
        float(stats.chi2.sf(float(np.mean(z**2)) * count / heavier / _SQUARES, count / heavier)),
        min(1.0, len(z) * 2.0 * float(stats.t.sf(largest, scatter))),
    ]


def _common(rest: np.ndarray) -> list[float]:
    """Return the chances of what all groups have in common over the sweep (G, K): in all terms, and in any window."""
    used = np.any(rest != 0.0, axis=0)
    mean = rest.sum(axis=0) / math.sqrt(len(rest))
    over_time = scipy.fft.idct(mean, norm='ortho')
    windows = [np.abs(np.convolve(over_time, np.ones(width), 'valid')).max() / math.sqrt(width) for width in _WINDOWS]
    freedom = np.count_nonzero(used) / 1.1
    return [
        float(stats.chi2.sf(np.mean(mean[used] ** 2) * freedom / 1.1, freedom)),
        float(min(1.0, len(_WINDOWS) * len(over_time) * 2.0 * stats.norm.sf(max(windows) / 1.1))),
    ]


def _rhythm(rest: np.ndarray) -> float:
    """Return the chance of the most that sweeps of all groups change at one modulation frequency; `rest` (G, K).

    Over the scatter of all frequencies: noise that comes and goes spreads variances wider than steady noise does.
    """
    together = rest[:, np.any(rest != 0.0, axis=0)].sum(axis=0) / math.sqrt(len(rest))
    if not len(together):
        return 1.0
    spread = max(stats.median_abs_deviation(together, scale='normal'), 1.0)
    most = max(np.convolve(together, np.ones(width), 'valid').max() / math.sqrt(width) for width in _RHYTHM)
    return float(min(1.0, len(_RHYTHM) * len(together) * stats.norm.sf(most / spread / _FLUTTER_TAILS)))


def _events(rest: np.ndarray, weight: np.ndarray, slopes: np.ndarray, chosen: np.ndarray, std: np.ndarray) -> float:
    """Return the chance of an event at one time of every sweep: a step, a kink, or a bump of some width.

    No effect of the registry is an event, but several together may imitate one. So an event is looked for as it would
    stand beside the explanation if all were fitted together: what the parameters can imitate of it counts for nothing.

    Args:
        rest: whitened remainder (n,).
        weight: of its numbers (n,).
        slopes: of the explanation's parameters, whitened (P, n).
        chosen: which numbers are those of one channel of the ramp, (G, K) in order.
        std: deviations of these (G, K), inf for those that are free.
    """
    groups, count = std.shape
    share = weight[chosen].reshape(groups, count) / std
    shapes = scipy.fft.dct(_shapes(count), norm='ortho', axis=1)  # (M, K)
    remains = shapes @ np.sum(rest[chosen].reshape(groups, count) * share, axis=0)
    power = shapes**2 @ np.sum(share**2, axis=0)
    if len(slopes):
        imitated = shapes @ np.einsum('pgk,gk->kp', slopes[:, chosen].reshape(-1, groups, count), share)
        inverse = scaled_inverse(slopes @ slopes.T)
        remains -= imitated @ (inverse @ (slopes @ rest))
        power = np.maximum(power - np.einsum('mp,pq,mq->m', imitated, inverse, imitated), 0.02 * power)
    largest = np.max(np.abs(remains) / np.sqrt(power))
    return float(min(1.0, len(shapes) * 2.0 * stats.norm.sf(largest / _TAILS)))


def _shapes(count: int) -> np.ndarray:
    """Return events over `count` blocks (M, count)."""
    block = np.arange(count)
    at = np.arange(_EDGE, count - _EDGE)[:, None]
    steps = (block >= at).astype(float)
    kinks = np.maximum(block - at, 0.0)
    bumps = [np.exp(-0.5 * ((block - at) / width) ** 2) for width in _WIDTHS]
    return np.concatenate([steps, kinks, *bumps])
