"""One bent ramp in the place of several effects that shape a chirp, which imitate it together, or beside all.

In: an explanation. Out: explanations with an effect of many coefficients in the place of some of its effects.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from drfmcw_sim.effects import Effect

from .fits.fitted import Fitted, FittedEffect, Linearised
from .limits import RIVALS, SEARCH
from .search import Search
from .starts.bank import Candidate, of_coefficients
from .starts.bent import bent_as


def unified(search: Search, fitted: Fitted | None, fewest: int) -> list[Fitted]:
    """Return explanations with one effect of many coefficients for those that shape a chirp, best first.

    It takes the place of all, of its own station's, of all but one, or of one of the other station.

    Args:
        search: with its comparison.
        fitted: explanation; None for one without effects.
        fewest: effects that shape a chirp, of one station or of both, and are worth it; 0 to try it beside all
            effects as well, of a station at which none does.
    """
    places = _places(search, fitted, fewest)
    if not places:
        return []
    slopes = search.slopes(fitted)
    misfit = fitted.misfit if fitted is not None else search.misfit(0.0)
    bending = _Bending(search, fitted, misfit, slopes, search.linearised(fitted, slopes))
    found: list[Fitted] = []
    # in the place of most effects first: if that is as good, an effect beside it is found when it is wanted
    for count in sorted({len(replaced) for replaced, _ in places}, reverse=True):
        chosen = [place for place in places if len(place[0]) == count]
        found += itertools.chain.from_iterable(search.workers.map(bending.fits, chosen))
        if fitted is not None and any(len(f.effects) < len(fitted.effects) and f.misfit < misfit for f in found):
            break
    return sorted(found, key=lambda f: -f.evidence)


def _places(search: Search, fitted: Fitted | None, fewest: int) -> list[tuple[tuple[int, ...], list[Candidate]]]:
    """Return which effects of an explanation may give place, with the candidates of one station that take it."""
    effects = fitted.effects if fitted is not None else ()
    shaping = [i for i, e in enumerate(effects) if e.candidate.kind.shapes_chirp]
    # of several that imitate a bent ramp, one may be what is there beside it
    all_but_one = [tuple(i for i in shaping if i != kept) for kept in shaping if len(shaping) > 1]
    found: dict[tuple, tuple[tuple[int, ...], list[Candidate]]] = {}
    for candidate in of_coefficients(search.comparison.data.stations, search.left_out):
        own = [i for i in shaping if effects[i].key[1] == candidate.station]
        single = [(i,) for i in shaping if i not in own]
        for replaced in {tuple(own), tuple(shaping), *all_but_one, *single}:
            if len(replaced) >= fewest:
                found.setdefault((*candidate.key, replaced), (replaced, []))[1].append(candidate)
    return list(found.values())


def may_look_alike(replaced: Sequence[FittedEffect], further: int) -> bool:
    """Return whether an effect with so many further coefficients may by chance look like those that it replaces.

    As strong as they are, it has a part beyond the noise in each further coefficient, unless chance makes it small.
    """
    strengths = (abs(e.values[e.candidate.recipe.size]) / e.size_std for e in replaced if e.size_std > 0.0)
    return bool(max(1.0, *strengths) ** -further > RIVALS.resembling)


def bends_as_it_must(search: Search, fitted: Fitted) -> bool:
    """Return whether one effect alone shapes a chirp, which no bent ramp resembles by chance."""
    shaping = [e for e in fitted.effects if e.candidate.kind.shapes_chirp]
    bent = list(of_coefficients(search.comparison.data.stations, search.left_out))
    if len(shaping) != 1 or not bent or shaping[0].candidate.recipe.coefficients:
        return False
    fewest = min(len(c.free) for c in bent)
    return not may_look_alike(shaping, fewest - len(shaping[0].candidate.free))


@dataclasses.dataclass(frozen=True)
class _Bending:
    """Fits bent ramps in places of one explanation."""

    search: Search
    fitted: Fitted | None
    misfit: float  # that it leaves
    slopes: np.ndarray  # of its parameters, see `Fitting.slopes`
    linearised: Linearised | None

    def fits(self, place: tuple[tuple[int, ...], list[Candidate]]) -> list[Fitted]:
        """Return explanations with a bent ramp of some numbers of coefficients in one place.

        Only what gains about as much as the effects there, alone and with most coefficients, is fitted with the others,
        from where it bends the chirp as they do. More than the fewest coefficients are tried where they follow more,
        and come near the explanation by it.
        """
        replaced, several = place
        few, *_, many = sorted(several, key=lambda c: len(c.values))
        effects = self.fitted.effects if self.fitted is not None else ()
        others = [(e.candidate, e.values) for i, e in enumerate(effects) if i not in replaced]
        alone = self._alone(many, replaced)
        if alone is None:
            return []
        further = [c for c in several if c is not few]
        first = self._together(others, few, alone)
        if len(self.search.set_aside):  # which may take up what more coefficients follow
            return [first, *(self._together(others, candidate, first) for candidate in further)]
        start = [*first.start[:-1], self._as(many, first.build()[-1:])]
        after = self.search.fit(start, SEARCH.first_steps, linearised=self.linearised)
        gain = first.misfit - after.misfit
        if gain < SEARCH.least or after.misfit - self.misfit > max(SEARCH.far * SEARCH.rival, gain):
            return [first]
        return [first, *(self._together(others, candidate, after) for candidate in further)]

    def _alone(self, candidate: Candidate, replaced: tuple[int, ...]) -> Fitted | None:
        """Return a fit beside the others, to first order; None where it gains by far less than those replaced."""
        search, bends = self.search, list[Effect]()
        rest: np.ndarray | float = 0.0
        freedom = None
        if self.fitted is not None:
            rest = search.without(self.fitted, *replaced).template
            freedom = search.freedom_beside(self.slopes, *(self.fitted.spans[i] for i in replaced))
            bends = [self.fitted.effects[i].build() for i in replaced]
        alone = search.fit([self._as(candidate, bends)], SEARCH.first_steps, rest, freedom)
        least = SEARCH.much * (search.misfit(rest) - self.misfit)
        behind = max(SEARCH.far * SEARCH.rival, least) if replaced else -SEARCH.least
        return alone if alone.misfit - self.misfit < behind else None

    def _together(self, others: Sequence[tuple], candidate: Candidate, bent: Fitted) -> Fitted:
        """Return a fit with the other effects that begins as the last effect of another one is bent."""
        start = [*others, self._as(candidate, bent.build()[-1:])]
        return self.search.fit(start, linearised=self.linearised, near=self.fitted)

    def _as(self, candidate: Candidate, effects: Sequence[Effect]) -> tuple[Candidate, dict[str, float]]:
        """Return where a fit begins: bent as some effects bend the ramp."""
        return candidate, bent_as(candidate, effects, self.search.comparison.recorded.parts[0].steady)
