"""Fewer effects in the place of several that range and beat frequency alone show, which imitate them together.

In: an explanation. Out: explanations in which fewer effects take the place of all of that kind. A reference whose scale
is off by more than any air explains, beside its offset, had been taken for air, a delay and both ADC clocks.
"""

import dataclasses
import itertools

import numpy as np

from .fits.fitted import Fitted
from .limits import SELECTION
from .search import Search
from .starts.bank import Candidate


@dataclasses.dataclass(frozen=True)
class PathLimits:
    """Which effects are of the path alone, and how many sets of them are tried."""

    kinds: tuple[str, ...] = ('range', 'beat')
    """Kinds of numbers that show the path alone."""

    share: float = 0.98
    """Share of an effect's power in these from which on nothing else shows it [1]; chosen."""

    largest: int = 3
    """Effects of a set at most; chosen: a set of four follows nearly any curve over ten distances."""

    fitted: int = 6
    """Sets of one size that are fitted, those that promise most; chosen."""

    parallel: float = 1e-6
    """Share of an effect's power that the others of a set must leave of it [1]; chosen."""


LIMITS = PathLimits()


def fewer(search: Search, fitted: Fitted) -> list[Fitted]:
    """Return explanations with the fewest effects of the path that fit as well as all of an explanation, best first.

    Args:
        search: prepared, which trusts the models as far as the explanation demands.
        fitted: the explanation.
    """
    c = search.comparison
    replaced = [i for i, e in enumerate(fitted.effects) if _of_path(search, c.template([e.build()]))]
    if len(replaced) < 2:
        return []
    others = [e for i, e in enumerate(fitted.effects) if i not in replaced]
    kept = [point for i, point in enumerate(fitted.start) if i not in replaced]
    rest = search.whitening(c.residual - c.template([e.build() for e in others]))
    tried = [
        i
        for i, candidate in enumerate(search.bank)
        if candidate.recipe.may_vanish
        and candidate.recipe.order == 1
        and candidate.key not in search.doubted
        and candidate.key not in {e.key for e in others}
        and _of_path(search, search.templates[i])
    ]
    units = search.whitening(search.templates[tried].astype(float))
    length = np.linalg.norm(units, axis=1)
    units /= length[:, None]
    gram, along = units @ units.T, units @ rest
    for count in range(1, min(len(replaced), LIMITS.largest + 1)):
        sets = [
            s
            for s in itertools.combinations(range(len(tried)), count)
            if len({search.bank[tried[i]].key for i in s}) == count
        ]
        if not sets:
            continue
        chosen = np.array(sets)
        normal = gram[chosen[:, :, None], chosen[:, None, :]] + LIMITS.parallel * np.eye(count)
        sizes = np.linalg.solve(normal, along[chosen][..., None])[..., 0]
        gains = np.einsum('mk,mk->m', sizes, along[chosen])
        starts = []
        for number in np.argsort(-gains)[: LIMITS.fitted]:
            several = zip(chosen[number], sizes[number], strict=True)
            starts.append([*kept, *(_scaled(search, search.bank[tried[i]], size / length[i]) for i, size in several)])
        near = [f for f in search.fits(starts, fitted) if f.certain and f.misfit < fitted.misfit + SELECTION.as_well]
        if near:
            return sorted(near, key=lambda f: -f.evidence)
    return []


def _of_path(search: Search, template: np.ndarray) -> bool:
    """Return whether range and beat frequency alone show what an effect adds (n,)."""
    rows = search.comparison.entries.where(kind=LIMITS.kinds)
    return float(np.sum(template[rows] ** 2)) > LIMITS.share * max(float(np.sum(template**2)), 1e-30)


def _scaled(search: Search, candidate: Candidate, scale: float) -> tuple[Candidate, dict[str, float]]:
    """Return a candidate and its values with the size scaled, within its bounds."""
    size = candidate.recipe.size
    low, high = search.bounds(candidate, size)
    return candidate, candidate.values | {size: min(max(candidate.values[size] * scale, low), high)}
