"""Which effects of an explanation are there beyond doubt, although the explanation leaves something over.

A real effect predicts what it was not fitted to: its size agrees from distance to distance and from kind
to kind of number, and fitted without one distance it predicts that distance. An imitation of something unknown
has a size of its own wherever it is measured. Both are measured on cells, a cell being the numbers of one kind at one
station in one group of sweeps.

What the range alone shows is a smooth curve of distance, time or temperature, which something unknown may be as well.
So an effect of that kind is also in doubt where it leaves much of the range's error unexplained, and where others of
that kind, which may nearly cancel it, make it many times less certain than it would be without them.
"""

import dataclasses

import numpy as np
from scipy import stats

from drfmcw_sim.effects import Effect

from ..compare.algebra import scaled_inverse
from .fitting import Fitted, FittedEffect, Fitting, cells_of, series_of


@dataclasses.dataclass(frozen=True)
class StandingLimits:
    """What an effect must show; chosen on recordings by another hand, see docs/diagnosis.md."""

    over_groups: float = 0.1  # mean squared relative difference of its size from group to group, beyond noise [1]
    over_kinds: float = 0.2  # the same from kind to kind [1]
    predicted: float = 0.5  # share of its gain in each group that a fit without this group predicts, at least [1]
    clean: float = 0.05  # rest of a cell over the effect's power in it, below which the cell counts as clean [1]
    uneven: float = 1e-4  # chance of a converter's codes below which its numbers are no evidence [1]
    evidence: float = 0.2  # share of its gain that lies in clean cells, at least [1]
    probability: float = 1e-4  # chance of the gain in clean cells, at most [1]
    alone: float = 0.98  # share of its power in one group above which no other group can confirm it [1]
    by_range: float = 0.98  # share of its power in the range above which nothing else shows it [1]
    left: float = 0.05  # rest of the range over what an effect that the range alone shows explains of it, at most [1]
    inflated: float = 5.0  # standard deviation beside others that the range alone shows, over that without them [1]


LIMITS = StandingLimits()


@dataclasses.dataclass(frozen=True)
class Standing:
    """How well one effect of an explanation stands by itself."""

    over_groups: float  # see `StandingLimits`
    over_kinds: float
    predicted: float
    evidence: float
    probability: float
    testable: bool  # more than one group shows it
    gain: float  # misfit that it explains beside the others
    left: float = 0.0  # of effects that the range alone shows
    inflated: float = 1.0  # likewise

    @property
    def stands(self) -> bool:
        """True where the effect is there beyond doubt."""
        return (
            self.testable
            and self.over_groups < LIMITS.over_groups
            and self.over_kinds < LIMITS.over_kinds
            and self.predicted > LIMITS.predicted
            and self.evidence > LIMITS.evidence
            and self.probability < LIMITS.probability
            and self.left < LIMITS.left
            and self.inflated < LIMITS.inflated
        )


def standings(fitting: Fitting, fitted: Fitted) -> list[Standing]:
    """Return how well each effect of an explanation stands by itself, in order."""
    entries = fitting.comparison.entries
    whitening = fitting.whitening
    rest = whitening(fitting.comparison.residual - fitted.template)
    slopes = whitening(fitting.slopes(fitted))
    groups, kinds, cells = entries.group, series_of(entries), cells_of(entries)
    converters = _of_uneven_converters(fitting)
    changes = _without_each_group(rest, slopes, groups)[groups]
    moved = np.einsum('np,pn->n', changes, slopes)
    by_range = [_by_range(fitting, effect) for effect in fitted.effects]
    inflations = _inflations(fitted, slopes, by_range)
    found = []
    for number, own in enumerate(fitted.spans):
        others = [e.build() for i, e in enumerate(fitted.effects) if i != number]
        added = whitening(fitted.template - (fitting.comparison.template(others) if others else 0.0))
        moved_own = np.einsum('np,pn->n', changes[:, own], slopes[own])
        free = own.stop - own.start
        standing = _standing(rest, added, moved, moved_own, groups, kinds, cells, converters, free)
        left = _left_of_range(fitting, fitted, others) if by_range[number] else 0.0
        found.append(dataclasses.replace(standing, left=left, inflated=inflations[number]))
    return found


def _left_of_range(fitting: Fitting, fitted: Fitted, others: list[Effect]) -> float:
    """Return the rest of the range over what an effect beside `others` explains of it, as measured noise has it."""
    c = fitting.comparison
    whitening = fitting.whitening_of(fitted, with_unknown=False)
    rows = np.concatenate([c.rows(kind) for kind in c.kinds if kind.level == 'range'])
    rest = whitening(c.residual - fitted.template)[rows]
    added = whitening(fitted.template - (c.template(others) if others else 0.0))[rows]
    return float((rest @ rest - np.count_nonzero(rest)) / max(float(added @ added), 1e-30))


def _inflations(fitted: Fitted, slopes: np.ndarray, alike: list[bool]) -> list[float]:
    """Return by how much effects that the range alone shows make each other less certain; 1 for all others.

    Args:
        fitted: the explanation.
        slopes: whitened derivatives of its template by its parameters (P, n).
        alike: whether the range alone shows each effect.
    """
    spans = fitted.spans
    by_range = [i for i, alone in enumerate(alike) if alone]
    std = np.sqrt(np.diag(scaled_inverse(slopes @ slopes.T)))
    found = [1.0] * len(spans)
    for i in by_range:
        other = {k for j in by_range if j != i for k in range(spans[j].start, spans[j].stop)}
        kept = [k for k in range(len(slopes)) if k not in other]
        alone = np.sqrt(np.diag(scaled_inverse(slopes[kept] @ slopes[kept].T)))
        own = [kept.index(k) for k in range(spans[i].start, spans[i].stop)]
        found[i] = float(np.max(std[spans[i]] / alone[own], initial=1.0))
    return found


def _by_range(fitting: Fitting, effect: FittedEffect) -> bool:
    """Return whether an effect, alone, shows in the range and in nothing else."""
    if effect.candidate.acts:
        return False
    c = fitting.comparison
    added = fitting.whitening.weight * c.template([effect.build()])
    power = sum(float(np.sum(added[c.rows(kind)] ** 2)) for kind in c.kinds if kind.level == 'range')
    return power > LIMITS.by_range * float(added @ added)


def _of_uneven_converters(fitting: Fitting) -> np.ndarray:
    """Return which numbers an ADC with uneven codes may have made (n,)."""
    c = fitting.comparison
    found = np.zeros(len(c.residual), bool)
    for station, codes in enumerate(c.codes):
        if codes is not None and codes.probability < LIMITS.uneven:
            for kind in c.kinds:
                if kind.of_converter:
                    found[c.rows(kind, station)] = True
    return found


def _without_each_group(rest: np.ndarray, slopes: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Return by how much the parameters change when each group is left out of the fit (G, P), to first order."""
    normal = slopes @ slopes.T
    changes = []
    for group in range(groups.max() + 1):
        inside = slopes[:, groups == group]
        inverse = scaled_inverse(normal - inside @ inside.T)
        changes.append(-inverse @ (inside @ rest[groups == group]))
    return np.array(changes)


def _standing(
    rest: np.ndarray,
    added: np.ndarray,
    moved: np.ndarray,
    moved_own: np.ndarray,
    groups: np.ndarray,
    kinds: np.ndarray,
    cells: np.ndarray,
    converters: np.ndarray,
    free: int,
) -> Standing:
    """Return how well an effect stands by itself; arrays (n,), whitened.

    Args:
        rest: what the explanation leaves.
        added: what the effect adds to it.
        moved: by how much the explanation changes in each group when it is fitted without this group.
        moved_own: the same by the effect's own parameters alone.
        groups: number of each number's group.
        kinds: of its kind and station.
        cells: of its cell.
        converters: which numbers an uneven ADC may have made.
        free: parameters of the effect.
    """
    gain = (rest + added) ** 2 - rest**2
    left = rest - moved
    predicted = (left + added + moved_own) ** 2 - left**2
    total = max(float(gain.sum()), 1e-30)
    power, excess = np.bincount(cells, added**2), np.bincount(cells, rest**2 - (rest != 0.0))
    clean = (np.maximum(excess, 0.0) < LIMITS.clean * power)[cells] & ~converters
    by_group = np.bincount(groups, added**2)
    return Standing(
        over_groups=_unevenness(rest, added, groups),
        over_kinds=_unevenness(rest, added, kinds),
        predicted=float(predicted.sum()) / total,
        evidence=float(gain[clean].sum()) / total,
        probability=float(stats.chi2.sf(max(float(gain[clean].sum()), 0.0), free)),
        testable=bool(by_group.max() < LIMITS.alone * by_group.sum()),
        gain=total,
    )


def _unevenness(rest: np.ndarray, added: np.ndarray, parts: np.ndarray) -> float:
    """Return the mean squared relative difference of an effect's size from part to part, less what noise makes of it.

    In each part the size that fits best is 1 + (added . rest) / (added . added) times that of the explanation, with a
    variance of 1 / (added . added); parts count by their power.
    """
    power, overlap = np.bincount(parts, added**2), np.bincount(parts, added * rest)
    used = power > 0.0
    squares = overlap[used] ** 2 / power[used]
    return float((squares.sum() - np.count_nonzero(used)) / max(power.sum(), 1e-30))
