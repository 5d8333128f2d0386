"""Explanations that fit a recording nearly as well as the one put first: which its data cannot separate."""

import itertools
from collections.abc import Sequence

import numpy as np

from ..search.bent_ramps import may_look_alike
from ..search.fits.fitted import Fitted, FittedEffect
from ..search.limits import RIVALS, SEARCH
from ..search.search import Search
from ..search.starts.bank import Candidate


def rivals(search: Search, fitted: Fitted, exchanged: Sequence[Fitted]) -> list[Fitted]:
    """Return the explanations that fit nearly as well as one, best first; each set of effects once.

    Several effects can be exchanged at once: if neither of two oscillators can be separated from that of the other
    station, four explanations are one answer.

    Args:
        search: of the recording.
        fitted: the explanation.
        exchanged: explanations with one of its effects exchanged.
    """

    def is_near(other: Fitted) -> bool:
        # one effect in the place of several has more freedom than each of them, and needs no excuse for it
        excused = len(other.effects) < len(fitted.effects) or _may_resemble(other, fitted)
        likely = excused or other.evidence > fitted.evidence - RIVALS.worse
        alike = other.misfit - fitted.misfit < SEARCH.rival and likely
        # what fits as well by the noise elsewhere explains something else, but nobody knows which if it fits better
        return alike and (other.misfit <= fitted.misfit or search.apart(other, fitted) < RIVALS.says_the_same)

    single = [other for other in exchanged if other.keys != fitted.keys and is_near(other)]
    several = search.fits(_combined(fitted, single), fitted)
    near = [other for other in several if other.certain and is_near(other)]
    best: dict[tuple, Fitted] = {}  # of the same effects with other parameters
    for other in sorted([*single, *near], key=lambda other: -other.evidence):
        best.setdefault(other.keys, other)
    return list(best.values())


def _may_resemble(other: Fitted, fitted: Fitted) -> bool:
    """Return whether an effect of many coefficients may by chance look like the effect in whose place it stands."""
    if len(other.effects) > len(fitted.effects) or not any(e.candidate.recipe.coefficients for e in other.effects):
        return False
    replaced = [e for e in fitted.effects if e.key not in other.keys and e.size_std > 0.0]
    # without any it is one of many coefficients, too: their evidence decides
    return bool(replaced) and may_look_alike(replaced, other.freedom - fitted.freedom)


def widened(fitted: Fitted, exchanged: Sequence[Fitted]) -> Fitted:
    """Return an explanation whose deviations cover the other places at which the same effects fit nearly as well.

    Mean squares about the best fit over all places, each with its likelihood.
    """
    places = [other for other in exchanged if other.keys == fitted.keys and other.free == fitted.free]
    if not places:
        return fitted
    shares = np.exp([min(0.5 * (fitted.misfit - other.misfit), 0.0) for other in places])
    widened_effects = []
    for effect in fitted.effects:
        same = [_nearest(effect, other) for other in places]
        widened_effects.append(dict(effect.widened))
        for name, std in effect.stds.items():
            if name not in effect.widened:
                squares = np.array([(e.values[name] - effect.values[name]) ** 2 + e.stds[name] ** 2 for e in same])
                variance = (std**2 + shares @ squares) / (1.0 + shares.sum())
                widened_effects[-1][name] = effect.values[name], float(np.sqrt(variance))
    return fitted.with_widened(widened_effects)


def _nearest(effect: FittedEffect, other: Fitted) -> FittedEffect:
    """Return the effect of the same kind in another explanation, where there are several the one at the next place."""
    name = effect.candidate.recipe.scanned
    alike = [e for e in other.effects if e.key == effect.key and e.candidate.free == effect.candidate.free]
    return min(alike, key=lambda e: abs(e.values[name] - effect.values[name]) if name in effect.values else 0.0)


def _combined(fitted: Fitted, single: Sequence[Fitted]) -> list[list[tuple[Candidate, dict[str, float]]]]:
    """Return where fits of explanations begin that have several effects exchanged as each was alone."""
    places = [[(effect.key, effect.candidate, effect.values)] for effect in fitted.effects]
    for other in single:
        gone = [number for number, effect in enumerate(fitted.effects) if effect.key not in other.keys]
        new = [effect for effect in other.effects if effect.key not in fitted.keys]
        if len(gone) == len(new) == 1 and len(places[gone[0]]) <= RIVALS.substitutes:
            places[gone[0]].append((new[0].key, new[0].candidate, new[0].values))
    found = []
    for chosen in itertools.product(*places):
        changed = sum(key not in fitted.keys for key, _, _ in chosen)
        if changed > 1 and len({key for key, _, _ in chosen}) == len(chosen):
            found.append([(candidate, dict(values)) for _, candidate, values in chosen])
    return found[: RIVALS.most]
