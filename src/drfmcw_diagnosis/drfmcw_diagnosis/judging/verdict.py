"""The verdict: whether the effects found explain a recording, and which of them stand if something is left over."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import stats

from ..compare import steadiness
from ..search import courses, events
from ..search.bent_ramps import unified
from ..search.fits.fitted import Fitted
from ..search.leftovers import Leftover, leftovers
from ..search.limits import EVENTS, SEARCH, SELECTION
from ..search.search import Search
from ..search.selection import Found, better_bent, forward, pruned, united_with
from . import bursts, curves, paths, standing, stretches
from .receivers import harmonics
from .rivals import rivals, widened
from .standing import standings


@dataclasses.dataclass(frozen=True)
class VerdictLimits:
    """When a remainder counts against an explanation."""

    adequate: float = EVENTS.adequate
    """Remainder over what is explained [1], of one kind of number at one station or of all together, below which an
    explanation holds whatever its significance: forward models are not exact; chosen, as the interface states it."""

    largest: float = 400.0
    """Remainder of all together, at most [1]; chosen: 20 standard deviations are no error of a model."""

    outdone: float = 1e-6
    """Chance of an explanation fitting so much better with one effect exchanged, below which something is left; chosen:
    one of many tried does so by chance."""

    rounds: int = 3
    """Times that the search goes on from the effects that stand; chosen."""


LIMITS = VerdictLimits()


@dataclasses.dataclass(frozen=True)
class Judgement:
    """What is said of a recording."""

    verdict: str  # of the interface
    explanation: Fitted | None
    alternatives: list[Fitted]
    exchanged: list[Fitted]  # explanations with one effect exchanged
    significance: float  # chance of a mismatch this large
    remainder: list[Leftover]  # what is left beyond chance, least probable first


def judged(search: Search, found: Found, false_alarm_rate: float) -> Judgement:
    """Return the verdict on a recording.

    Effects that leave nothing beyond chance explain it, unless an event without a name explains as much as one of them,
    a modulation scatters as noise does, two effects nearly cancel, one line is a harmonic of another, or parts of the
    numbers show an effect with several sizes. A remainder far smaller than what they explain is reported and changes
    nothing, provided that every effect stands by itself beside it, see `standing`: a small effect may imitate what a
    large one leaves. Beside a larger one only those effects are named that stand.

    Args:
        search: of the recording.
        found: what it came to.
        false_alarm_rate: accepted chance of finding a mismatch where there is none.
    """
    current = found.explanation
    left = _significant(search, current, false_alarm_rate)
    significance = min([found.significance, *(x.probability for x in left)])
    if current is None:
        return Judgement('unexplained' if left else 'consistent', None, [], [], significance, left)
    if not _holds(search, current, left) or _is_outdone(search, current, found.exchanged):
        current = established(search, current, false_alarm_rate)
        if current is None:
            left = _significant(search, None, false_alarm_rate)
            return Judgement('unexplained', None, [], [], significance, left)
        current, exchanged = _at_best_places(search, current)
        exchanged += united_with(search, current, false_alarm_rate)
        alternatives = [f for f in rivals(search, current, exchanged) if all(s.stands for s in standings(search, f))]
        current, alternatives = _at_their_stations(search, current, alternatives)
        current = widened(current, exchanged)
        left = _significant(search, current, false_alarm_rate)
        beside = 'explained' if _holds(search, current, left) else 'partial'
        verdict = 'ambiguous' if alternatives else beside
        current, alternatives = _fewest_kinds_first(current, alternatives, exchanged)
        return Judgement(verdict, current, alternatives, exchanged, significance, left)
    current, alternatives = _at_their_stations(search, current, rivals(search, current, found.exchanged))
    current = widened(current, found.exchanged)
    verdict = 'ambiguous' if alternatives else 'explained'
    current, alternatives = _fewest_kinds_first(current, alternatives, found.exchanged)
    return Judgement(verdict, current, alternatives, found.exchanged, significance, left)


def _at_best_places(search: Search, current: Fitted) -> tuple[Fitted, list[Fitted]]:
    """Return an explanation with the same effects where they fit best and stand, and it with one of them exchanged.

    An alias of a sway stands, too, as long as nobody asks for another one beside the effects that were found after it.
    """
    exchanged = search.exchanges(current)
    elsewhere = (f for f in exchanged if (f.keys, f.free) == (current.keys, current.free))
    best = next(elsewhere, None)  # they are sorted
    if best is None or best.evidence < current.evidence + SELECTION.better:
        return current, exchanged
    best = search.trusted(best)
    if not all(one.stands for one in standings(search, best)):
        search.trust(current)  # to which it is fitted
        return current, exchanged
    return best, search.exchanges(best)


def _fewest_kinds_first(
    found: Fitted, alternatives: list[Fitted], exchanged: Sequence[Fitted]
) -> tuple[Fitted, list[Fitted]]:
    """Return explanations that the data cannot separate, of as many effects that of the fewest kinds put first.

    What one station has, the other is likely to have, too: their oscillators are of one make.
    """

    def kinds(one: Fitted) -> int:
        return len({name for name, _ in one.keys})

    as_many = [a for a in alternatives if len(a.effects) == len(found.effects)]
    first = min(as_many, key=kinds, default=found)
    if kinds(first) >= kinds(found):
        return found, alternatives
    return widened(first, exchanged), [found, *(a for a in alternatives if a is not first)]


def _at_their_stations(search: Search, fitted: Fitted, alternatives: list[Fitted]) -> tuple[Fitted, list[Fitted]]:
    """Return explanations without those whose modulations the sweeps one by one show to be the other station's."""
    for number, gain in enumerate(steadiness.gains_over_other_station(search.comparison, fitted.build())):
        if abs(gain) < SEARCH.rival:
            continue
        effect = fitted.effects[number]
        own, other = effect.key, (effect.key[0], steadiness.other_station(search.comparison, effect.key[1]))
        if gain < 0.0:
            moved = dataclasses.replace(effect.candidate, station=other[1]), effect.values
            fitted = search.fit([*fitted.start[:number], moved, *fitted.start[number + 1 :]])
            own, other = other, own
        alternatives = [f for f in alternatives if f.keys != fitted.keys and (own in f.keys or other not in f.keys)]
    return fitted, alternatives


def established(search: Search, found: Fitted, false_alarm_rate: float) -> Fitted | None:
    """Return the effects that are there beyond doubt beside something unknown, None where there is none.

    Effects that do not stand by themselves are dropped, the least convincing first, and not tried again until others
    stand. Then events without a name are set aside, other numbers that the rest does not explain count by the scatter
    that they really have, and the search goes on from what stands. In the end the search tries none that was dropped.
    """
    current: Fitted | None = found
    dropped: frozenset[tuple[str, str]] = frozenset()
    before: tuple[tuple[str, str], ...] | None = None
    for _ in range(LIMITS.rounds):
        current = _bent(search, _standing(search, current), false_alarm_rate)
        dropped |= search.doubted
        keys = current.keys if current is not None else ()
        if keys == before:
            search.doubted |= dropped.difference(keys)
        before = keys
        search.count_as_noise(current, _without_name(search, current), search.templates_beside(current))
        more, _, _ = forward(search, current, false_alarm_rate)
        more = pruned(search, more, false_alarm_rate)
        if more is None or more.keys == before:
            break
        current = more
    current = _standing(search, current)
    # what was in doubt at one station may be a rival of the same at the other one, and of what adds the same
    stands = {effect for effect, _ in current.keys} if current is not None else set()
    search.doubted |= {(effect, station) for effect, station in dropped if effect not in stands}
    for effect in current.effects if current is not None else ():
        search.doubted -= search.alike(effect)
    return current


def _bent(search: Search, current: Fitted | None, false_alarm_rate: float) -> Fitted | None:
    """Return an explanation with one bent ramp in the place of effects that imitate it, if it stands and fits better.

    What something unknown brought beside them may have hidden it.
    """
    if current is None:
        return None
    other = better_bent(search, current, united_with(search, current, false_alarm_rate), false_alarm_rate)
    if other is None:
        return current
    other = search.trusted(other)
    if all(one.stands for one in standings(search, other)):
        return other
    search.trust(current)  # to which it is fitted
    return current


def _without_name(search: Search, fitted: Fitted | None) -> np.ndarray:
    """Return events, curves and second paths without a name beside an explanation, as `events.left` does."""
    as_measured = search.whitening_of(fitted, with_unknown=False)
    found = events.left(search, fitted, as_measured)
    found = np.concatenate([found, paths.left(search, fitted, as_measured.beside(found))])
    return np.concatenate([found, curves.left(search, fitted, as_measured)])


def _standing(search: Search, fitted: Fitted | None) -> Fitted | None:
    """Return an explanation without the effects that do not stand by themselves; the search no longer tries these."""
    search.doubted = frozenset()
    while fitted is not None:
        fitted = search.trusted(fitted)
        found = standings(search, fitted)
        doubtful = [i for i, one in enumerate(found) if not one.stands]
        if not doubtful:
            break
        # what has no evidence of its own may spoil what the fits without one part predict of the others
        worst = min(doubtful, key=lambda i: (found[i].has_evidence, found[i].predicted))
        completed = _completed(search, fitted, worst) if found[worst].has_evidence else None
        if completed is None and found[worst].is_event:
            completed = _bent_beyond_events(search, fitted, worst)
        if completed is not None:
            fitted = completed
            continue
        search.give_up(fitted.effects[worst])
        fitted = search.again(search.without(fitted, worst)) if len(fitted.effects) > 1 else None
        search.set_aside = _without_name(search, fitted)
    search.doubted -= set(fitted.keys if fitted is not None else ())
    return fitted


def _bent_beyond_events(search: Search, fitted: Fitted, doubtful: int) -> Fitted | None:
    """Return an explanation with a bent ramp in the place of an effect that an event outdoes; None where none stands.

    The effect may resemble most of that ramp, and an event all of it.
    """
    kind, recipe = fitted.effects[doubtful].candidate.kind, fitted.effects[doubtful].candidate.recipe
    if not kind.shapes_chirp or recipe.coefficients:
        return None
    united = [f for f in unified(search, fitted, 1) if f.misfit < fitted.misfit]
    for other in united:
        if other.evidence <= united[0].evidence - SELECTION.better:
            break
        bent = search.trusted(other)
        if all(one.stands for one in standings(search, bent)):
            return bent
    search.trust(fitted)
    return None


def _completed(search: Search, fitted: Fitted, doubtful: int) -> Fitted | None:
    """Return an explanation with one more effect, beside which a doubtful one stands as it does itself; None without.

    Each of two strong effects may be uneven as long as the other one is missing. What neither explains may hide both,
    so it counts as noise in the meantime.
    """
    if len(fitted.effects) == SELECTION.most:
        return None
    before, noisier = search.set_aside, search.noisier
    search.count_as_noise(fitted, _without_name(search, fitted), search.templates_beside(fitted))
    around = search.trusted(fitted)
    more = [f for f in search.best_addition(around) if search.credible(f, around.template)]
    search.set_aside, search.noisier = before, noisier
    search.trust(fitted)
    for other in (search.again(f) for f in more):
        found = standings(search, other)
        if found[doubtful].stands and found[-1].stands:
            return other
    return None


def _significant(search: Search, fitted: Fitted | None, false_alarm_rate: float) -> list[Leftover]:
    found = [x for x in leftovers(search, fitted) if x.probability < false_alarm_rate]
    of_path = paths.leftover(search, fitted)
    return found if of_path is None else sorted([*found, of_path], key=lambda x: x.probability)


def _holds(search: Search, fitted: Fitted, left: list[Leftover]) -> bool:
    """Return whether an explanation holds but for a remainder that changes none of its effects.

    Bursts need not stand: how many a distance holds is chance.
    """
    if max(bursts.of_lines(search, fitted)) > bursts.LIMITS.nearer:
        return False
    if not left:
        return not _is_imitation(search, fitted)
    of_codes = any(_rows(search, x).size == 0 for x in left)  # ADC codes, on which no effect acts
    explained = _explained(search, fitted)
    exact = {kind.name for kind in search.comparison.kinds if kind.exact}
    excess = sum(x.at_least(x.excess) for x in left)
    small = excess < min(LIMITS.adequate * explained, LIMITS.largest) and not any(x.kind in exact for x in left)
    if of_codes or not (small or all(_is_adequate(search, fitted, x) for x in left)):
        return False
    found = zip(fitted.effects, standings(search, fitted), strict=True)
    return all(one.stands or effect.candidate.kind.bursts for effect, one in found)


_INSTEAD = (
    (events.beyond_events, EVENTS.beaten),
    (courses.beyond_courses, courses.LIMITS.beaten),
    (stretches.beyond_stretches, stretches.LIMITS.beaten),
    (curves.beyond_steps, curves.LIMITS.beaten),
    (paths.beyond_paths, paths.LIMITS.beaten),
)
"""What has no name and may stand for effects: by how much these gain more, and how much that must be."""


def _is_imitation(search: Search, fitted: Fitted) -> bool:
    """Return whether effects that leave nothing beyond chance may stand for something else."""
    if any(min(beyond(search, fitted)) < least for beyond, least in _INSTEAD):
        return True
    if min(steadiness.odds_of_one_size(search.comparison, fitted.build())) < steadiness.LIMITS.unlikely:
        return True
    if max(steadiness.amplitude_modulations(search.comparison, fitted.build())) > steadiness.LIMITS.of_amplitude:
        return True
    cancelled = any(power > standing.LIMITS.cancelled for power in standing.cancellations(search, fitted))
    return cancelled or any(harmonics(search, fitted)) or any(standing.uneven(search, fitted))


def _explained(search: Search, fitted: Fitted) -> float:
    """Return by how much an explanation lowers the sum of the squares of all numbers, as they are."""
    residual = search.comparison.residual
    return float(np.sum(residual**2) - np.sum((residual - fitted.template) ** 2))


def _is_outdone(search: Search, fitted: Fitted, exchanged: Sequence[Fitted]) -> bool:
    """Return whether it fits far better than by chance with one effect exchanged for one of more parameters.

    Then something is left, although no kind of number shows it by itself. The other explanation is not named for it: a
    free velocity at each distance follows whatever drifts, but has too many parameters to be likelier than a sway.
    """
    explained = _explained(search, fitted)
    for other in exchanged:
        gain, more = fitted.misfit - other.misfit, other.freedom - fitted.freedom
        if gain > LIMITS.adequate * explained and stats.chi2.sf(gain, max(more, 1)) < LIMITS.outdone:
            return True
    return False


def _is_adequate(search: Search, fitted: Fitted, left: Leftover) -> bool:
    """Return whether a remainder is small beside what an explanation explains of the same numbers."""
    residual, rows = search.comparison.residual, _rows(search, left)
    before, after = (float(np.sum((residual - t)[rows] ** 2)) - len(rows) for t in (0.0, fitted.template))
    return left.at_least(after) < LIMITS.adequate * before


def _rows(search: Search, left: Leftover) -> np.ndarray:
    """Return where the numbers of a remainder stand; none of ADC codes, which are not fitted."""
    return np.flatnonzero(search.comparison.entries.where(kind=left.kind, station=left.station))
