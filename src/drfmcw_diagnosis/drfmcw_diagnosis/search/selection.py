"""Which effects a recording demands: added one by one, dropped again, and exchanged for better ones."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from . import events, path_sets
from .bent_ramps import bends_as_it_must, unified
from .fits.fitted import Fitted, Linearised
from .leftovers import leftovers
from .limits import EVENTS, SEARCH, SELECTION
from .search import Search

_Without = tuple[float, Fitted]  # chance of an effect, and the explanation without it


@dataclasses.dataclass(frozen=True)
class Found:
    """What a search came to."""

    explanation: Fitted | None
    significance: float  # chance of the first effect
    rounds: list[list[Fitted]]  # ranking at each addition
    exchanged: list[Fitted]  # explanations with one effect exchanged, or several by one


def searched(search: Search, false_alarm_rate: float) -> Found:
    """Return the effects that the data demand: added one by one, dropped again, and exchanged for better ones.

    Args:
        search: prepared.
        false_alarm_rate: accepted chance of adding an effect to a recording that needs none.
    """
    current, significance, rounds = forward(search, None, false_alarm_rate)
    current = pruned(search, current, false_alarm_rate)
    if current is None:
        current, significance = _bent_alone(search, rounds, significance, false_alarm_rate)
    else:
        current = _begun_otherwise(search, current, rounds, false_alarm_rate)
    exchanged: list[Fitted] = []
    united: list[Fitted] = []
    for _ in range(SELECTION.exchanged):
        if current is None:
            break
        current = search.trusted(current)
        current = _bent_instead_of_events(search, current, false_alarm_rate) or current
        united = united_with(search, current, false_alarm_rate)
        bent = better_bent(search, current, united, false_alarm_rate)
        if bent is not None:
            united = [current]
            current = _grown(search, bent, rounds, false_alarm_rate)
        simpler = path_sets.fewer(search, current)
        if simpler:
            united = [*united, current]
            current = _grown(search, simpler[0], rounds, false_alarm_rate)
        if _far_beyond_chance(search, current.misfit) and current.misfit > SELECTION.hopeless * search.misfit(0.0):
            break  # something unknown hides everything else
        if len(current.effects) == SELECTION.most and leftovers(search, current)[0].probability < false_alarm_rate:
            break  # one exchange more or less makes no explanation of it
        search.report('rivals', 0.9)
        exchanged = search.exchanges(current)
        fewer = _fewer(search, current, exchanged, false_alarm_rate)
        if fewer is not None:
            current = fewer
            continue
        if not exchanged or exchanged[0].evidence < current.evidence + SELECTION.better:
            break
        current = exchanged[0]
        current, _, more = forward(search, current, false_alarm_rate)
        current = pruned(search, current, false_alarm_rate)
        rounds += more
        united = []
    return Found(current, significance, rounds, [*exchanged, *united])


def _grown(search: Search, begun: Fitted, rounds: list[list[Fitted]], false_alarm_rate: float) -> Fitted:
    """Return an explanation with what it lacks, trusted and fitted again; rankings are appended to `rounds`."""
    grown, _, more = forward(search, begun, false_alarm_rate)
    rounds += more
    found = pruned(search, grown, false_alarm_rate) or begun
    return search.trusted(found)


def _begun_otherwise(search: Search, current: Fitted, rounds: list[list[Fitted]], false_alarm_rate: float) -> Fitted:
    """Return the likelier explanation: the present one, or one that begins with another effect of the first round.

    Tried where one effect is at both stations and shapes both chirps. The strong one may stand for two at one station,
    as a settling for one of a ramp that begins late, and leave to the other what it cannot follow. Neither is then
    exchanged for the right one while the other stays.
    """
    shaping = {e.key for e in current.effects if e.candidate.kind.shapes_chirp}
    if len({name for name, _ in shaping}) == len(shaping):
        return current
    names = {name for name, _ in current.keys}
    other = next((f for f in rounds[0] if f.certain and not names & {name for name, _ in f.keys}), None)
    if other is None:
        return current
    aside = search.set_aside
    more: list[list[Fitted]] = []
    grown = _grown(search, other, more, false_alarm_rate)
    present = search.trusted(current)  # both by the same doubt
    if search.again(grown).evidence < present.evidence + SELECTION.better:
        search.set_aside = aside
        return current
    rounds += more
    return grown


def _bent_alone(
    search: Search, rounds: list[list[Fitted]], significance: float, false_alarm_rate: float
) -> tuple[Fitted | None, float]:
    """Return an explanation that begins with one bent ramp, and its chance, where no effect was found.

    No simple effect need resemble it. Where none fits, there is no explanation, and the chance stays.
    """
    begun = _bent_instead_of_events(search, None, false_alarm_rate)
    if begun is None:
        begun = better_bent(search, None, united_with(search, None, false_alarm_rate), false_alarm_rate)
    if begun is None:
        return None, significance
    (bent,) = begun.effects
    chance = search.probability(search.misfit(0.0) - begun.misfit, len(bent.candidate.free), bent.key)
    return _grown(search, begun, rounds, false_alarm_rate), min(significance, chance)


def united_with(search: Search, current: Fitted | None, false_alarm_rate: float) -> list[Fitted]:
    """Return explanations with one bent ramp in the place of effects that shape a chirp, best first.

    Also beside all effects, where more of the ramp is left than by chance: no simple effect need resemble it. None
    where nothing of it is left, and the only effect that shapes a chirp is too strong to look like one by chance.
    """
    left = any(x.kind == 'ramp' and x.probability < false_alarm_rate for x in leftovers(search, current))
    if current is not None and not left and not len(search.set_aside) and bends_as_it_must(search, current):
        return []
    room = current is None or len(current.effects) < SELECTION.most
    return unified(search, current, 0 if room and left else 1)


def better_bent(search: Search, current: Fitted | None, united: list[Fitted], false_alarm_rate: float) -> Fitted | None:
    """Return an explanation in which one effect takes the place of all that shape a chirp; None where none is better.

    A ramp whose rate changes over the band resembles several small errors of a straight one. It follows much, so in the
    place of one effect, or beside all, it must explain the rest of the ramp. Of those that are about as likely, the one
    of the fewest parameters counts.

    Args:
        search: of the recording.
        current: the explanation; None for one without effects.
        united: explanations with one effect in the place of several, best first.
        false_alarm_rate: chance of what is left of the ramp, at least.
    """
    near: list[Fitted] = []
    for other in united:
        if near and other.evidence <= near[0].evidence - SELECTION.better:
            break
        if _is_better_bent(search, current, other, false_alarm_rate):
            near.append(other)
    return min(near, key=lambda f: f.freedom, default=None)


def _is_better_bent(search: Search, current: Fitted | None, other: Fitted, false_alarm_rate: float) -> bool:
    """Return whether an explanation with a bent ramp takes the place of another; see `better_bent`."""
    more = len(other.effects) - (len(current.effects) if current is not None else 0)
    misfit, evidence = (current.misfit, current.evidence) if current is not None else (search.misfit(0.0), 0.0)
    if more < 0 and other.misfit < misfit + SELECTION.as_well:
        return True
    if other.evidence < evidence + (SELECTION.added if more > 0 else SELECTION.better):
        return False
    return more < 0 or all(x.kind != 'ramp' or x.probability >= false_alarm_rate for x in leftovers(search, other))


def _bent_instead_of_events(search: Search, current: Fitted | None, false_alarm_rate: float) -> Fitted | None:
    """Return an explanation with one bent ramp in the place of the events that are set aside; None if it fits worse.

    No simple effect may resemble that ramp, and an event in mid-sweep may.
    """
    aside = search.set_aside
    if not len(aside):
        return None
    misfit = current.misfit if current is not None else search.misfit(0.0)
    search.set_aside = aside[:0]  # also by how much an event may shift the lines
    search.trust(current)
    plain = search.again(current) if current is not None else None
    bent = better_bent(search, plain, united_with(search, plain, false_alarm_rate), false_alarm_rate)
    by_chance = len(aside)  # what each direction takes up of the noise
    if bent is not None and bent.misfit < misfit + by_chance + SELECTION.as_well:
        return search.trusted(bent)
    search.set_aside = aside
    search.trust(current)
    return None


def _fewer(search: Search, current: Fitted, exchanged: list[Fitted], false_alarm_rate: float) -> Fitted | None:
    """Return an explanation by fewer effects, of which one has other parameters; None where none is better.

    A clock that warms up may have been taken for one that is off and drifts.
    """
    for other in exchanged:
        if other.keys == current.keys and other.free != current.free:
            less = pruned(search, other, false_alarm_rate)
            if less is not None and len(less.effects) < len(current.effects) and less.evidence > current.evidence:
                return less
    return None


def forward(
    search: Search, current: Fitted | None, false_alarm_rate: float
) -> tuple[Fitted | None, float, list[list[Fitted]]]:
    """Return an explanation with effects added, the chance of the first addition, and the ranking of each round.

    Args:
        search: prepared.
        current: effects to begin with, None for none.
        false_alarm_rate: accepted chance of adding an effect to a recording that needs none.
    """
    significance = 1.0
    rounds: list[list[Fitted]] = []
    dropped: set[tuple[str, str]] = set()
    while current is None or len(current.effects) < SELECTION.most:
        search.trust(current)
        if current is not None:
            current = search.again(current)
        ranked = search.best_addition(current)
        beside = current.template if current is not None else 0.0
        before = current.misfit if current is not None else search.misfit(0.0)
        best = _best(search, (f for f in ranked if search.credible(f, beside) and _counts(search, f, before)), before)
        if events.set_aside(search, current, best):
            continue
        rounds.append(ranked)
        needed = current.evidence if current else 0.0
        instead = _without_uncertain(search, ranked, best, needed, dropped)
        if instead is not None:
            current = instead
            continue
        if best is None:
            break
        added = best.effects[-1]
        gain = before - best.misfit - search.imitated(added, current, best)
        chance = search.probability(gain, len(added.candidate.free), added.key)
        if len(rounds) == 1:
            significance = chance
        accepted = false_alarm_rate * (1.0 if current is None else SELECTION.further)
        if chance > accepted or best.evidence <= needed + SELECTION.added:
            break
        beside_others = current is not None and len(current.effects) > 1
        if beside_others and _far_beyond_chance(search, before) and gain < SELECTION.hopeful * before:
            break
        current = _bent(search, _relocated(search, ranked, best, beside))
    return current, significance, rounds


def _counts(search: Search, more: Fitted, before: float) -> bool:
    """Return whether an explanation's last effect gains enough over the misfit before, beside what is set aside."""
    if not len(search.set_aside):
        return True
    as_it_is = search.whitening_of(more, with_unknown=False)
    (share,) = events.over_set_aside(search, more, as_it_is, {len(more.effects) - 1: before - more.misfit})
    return share > EVENTS.faint


def _best(search: Search, ranked: Iterator[Fitted], before: float) -> Fitted | None:
    """Return the explanation with one more effect from which the search goes on, None of none.

    A sway at one of its aliases may follow most of what an offset does, beside which it would be at its own place. So
    an effect of one parameter that gains nearly as much comes first, as long as much more is left.

    Args:
        search: prepared.
        ranked: explanations with one more effect, best first.
        before: misfit without it.
    """
    best = next(ranked, None)
    if best is None or not best.effects[-1].candidate.recipe.lookalikes or not _far_beyond_chance(search, best.misfit):
        return best
    nearly = SELECTION.nearly * (before - best.misfit)
    simple = (f for f in ranked if len(f.effects[-1].candidate.free) == 1 and before - f.misfit > nearly)
    return next(simple, best)


def _relocated(search: Search, ranked: list[Fitted], best: Fitted, beside: np.ndarray | float) -> Fitted:
    """Return the likeliest explanation with one more effect, once others have moved to places that resemble theirs.

    A sway has aliases. Beside a wrong one, an effect that is not there may be about as likely as one that is.

    Args:
        search: prepared.
        ranked: explanations with one more effect, best first.
        best: of those all of whose effects are certain.
        beside: template of the other effects.
    """
    near = [best]
    if any(e.candidate.recipe.lookalikes for e in best.effects[:-1]):
        for other in ranked:
            if len(near) == SELECTION.relocated or other.evidence < best.evidence - SELECTION.better:
                break
            if all(search.apart(other, x) > SEARCH.rival for x in near) and search.credible(other, beside):
                near.append(other)
    return max(map(search.relocated, near), key=lambda f: f.evidence)


def _without_uncertain(
    search: Search, ranked: list[Fitted], best: Fitted | None, needed: float, dropped: set[tuple[str, str]]
) -> Fitted | None:
    """Return an explanation without an earlier effect that a further one makes uncertain; None where none is better.

    A reflection of small height may be taken for a loss of amplitude as long as it follows a part of other effects as
    well. With one of these it is of no height, and another effect should stand in its place.

    Args:
        search: prepared.
        ranked: explanations with one more effect, best first.
        best: of those all of whose effects are certain.
        needed: evidence of the explanation without a further effect.
        dropped: effects that were left out so before; the new ones are added.
    """
    for other in ranked:
        if other.evidence <= needed + SELECTION.added:
            break
        if best is not None and other.evidence < best.evidence + SELECTION.better:
            break
        numbers = [number for number, effect in enumerate(other.effects) if not effect.certain]
        uncertain = {other.effects[number].key for number in numbers}
        if other.effects[-1].certain and uncertain and not uncertain & dropped:
            dropped |= uncertain
            return search.again(search.without(other, *numbers))
    return None


def _bent(search: Search, current: Fitted) -> Fitted:
    """Return an explanation with one effect for several that shape a chirp, where these leave far more of a large rest.

    Strong effects are found one by one, each in part an imitation: a ramp that is bent all over would end as many.
    """
    shaping = sum(e.candidate.kind.shapes_chirp for e in current.effects)
    if shaping < 2 or not current.effects[-1].candidate.kind.shapes_chirp:
        return current
    if not _far_beyond_chance(search, current.misfit):
        return current
    best = min(unified(search, current, 2), key=lambda f: f.misfit, default=current)
    return best if best.misfit < SELECTION.far_less * current.misfit else current


def _far_beyond_chance(search: Search, misfit: float) -> bool:
    """Return whether a misfit is far beyond chance; never, where what is unexplained counts as noise."""
    return misfit > SELECTION.beyond * float(np.count_nonzero(search.comparison.residual))


def pruned(search: Search, found: Fitted | None, false_alarm_rate: float) -> Fitted | None:
    """Return an explanation without the effects that the others leave too little to explain."""
    while found is not None and len(found.effects) > 1:
        found = search.trusted(found)
        slopes = search.slopes(found)
        indispensable, linearised = search.indispensable(found, slopes), search.linearised(found, slopes)
        dispensable = [number for number, needed in enumerate(indispensable) if not needed]

        def without_one(number: int, found: Fitted = found, linearised: Linearised | None = linearised) -> _Without:
            effect = found.effects[number]
            without = search.again(dataclasses.replace(search.without(found, number), linearised=linearised))
            gain = without.misfit - found.misfit - search.imitated(effect, without, found)
            if effect.candidate.kind.bursts:
                gain = search.gain_over(found, without)
            return search.probability(gain, len(effect.candidate.free), effect.key), without

        chances = search.workers.map(without_one, dispensable)
        chance, without = max(chances, key=lambda item: item[0], default=(0.0, found))
        if chance <= false_alarm_rate * SELECTION.further:
            break
        found = without
    return found
