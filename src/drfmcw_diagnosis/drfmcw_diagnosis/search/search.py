"""The search for one more effect that explains a recording, or one in the place of another: bank, templates, fits."""

import collections
import dataclasses
import math
from collections.abc import Callable, Collection, Sequence

import numpy as np
from scipy import stats

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_ros.processes import Workers
from drfmcw_sim.effects import Effect

from ..compare.comparison import Comparison
from .bank import RECIPES, Candidate, at_stations, candidates
from .fitting import Fitted, FittedEffect, Fitting, Freedom
from .places import CELLS, cell, places

RIVAL = 16.0
"""Squared distance below which two explanations are one answer (4 sigma)."""

_TRIED = 12  # kinds of effects that are tried in each round, by what their templates promise
_REFINED = 5  # of them that are refined, by what they bring where the refinement begins
_STARTS = 6  # places of each kind at which a refinement begins
_LEAST = 14.0  # promised gain of a place that is tried: too little to be accepted, refinement included
_FIRST_STEPS = 2  # of refinement by which one of them is chosen
_STEPS_TO_SIZE = 4  # where a template cannot simply be scaled
_OFF = 0.01  # by which a model may be off throughout, relative to what it adds
_FAINT = 0.1  # length of a template below which it may be rounding only
_ALIKE = 0.9  # cosine between the templates of a size and of twice the size, if they are more than rounding
_NOTHING = 1e-6  # length of a template, of an effect that this recording cannot show
_REFLECTION = 0.1  # of a turn by which a reflection's carrier phase is trusted
_FEW = 6  # kinds of rivals that are refined
_PLACES = 2  # of each
_FRINGES = 6  # places of a reflection, which resemble each other
_PROMISED = 0.3  # of what an effect explains, that an exchange for it must promise
_FAR = 4.0  # times the distance of a rival, within which an exchange is refined to the end
_BEHIND = 0.2  # of what an effect explains, by which an exchange for it may then be behind
_OF_A_KIND = 2  # effects at one station, where there may be several
_SAME = 4.0  # squared distance below which two fits of the same effects are the same (2 sigma)
_KEPT = 512  # templates
_PARALLEL = 0.02  # of a template's power that counts, however much of it an explanation may follow
_BEYOND_LEVEL = 16.0  # gain that a second path must bring elsewhere than in the received power, which may wander


class Search(Fitting):
    """Searches the bank with one comparison; keeps the templates of the bank."""

    def __init__(
        self,
        comparison: Comparison,
        progress: Callable[[str, float], None] | None = None,
        without: Collection[str] = (),
        jobs: int = 1,
    ) -> None:
        """Compute the templates of the bank.

        Args:
            comparison: recording and model.
            progress: called with what is done and the share done.
            without: effects that are not searched for.
            jobs: processes that fit at once.
        """
        super().__init__(comparison)
        self._workers = Workers(jobs)
        self._kept: dict[tuple, np.ndarray] = {}
        self._left_out = without
        self.report = progress or (lambda text, share: None)
        data = comparison.data
        groups = [int(data.group[m[0]]) for m in comparison.members]
        bank = list(candidates(data.stations, data.calibration, groups, without))
        self.report('templates of the registry', 0.0)
        templates = self._workers.map(self._shown, bank)
        self.bank = [candidate for candidate, template in zip(bank, templates, strict=True) if template is not None]
        shown = [template for template in templates if template is not None]
        self.templates = np.array(shown, np.float32).reshape(len(shown), len(comparison.residual))
        self.untested = sorted({c.effect for c in bank} - {c.effect for c in self.bank})
        self._places = collections.Counter(c.key for c in self.bank)

    def _shown(self, candidate: Candidate) -> np.ndarray | None:
        """Return the template of a candidate, None of what the recording cannot show."""
        template = self._template([candidate.build()])
        return template.astype(np.float32) if self._shows(candidate, template) else None

    def _shows(self, candidate: Candidate, template: np.ndarray) -> bool:
        """Return whether the recording can show an effect: what does not grow with the size is rounding."""
        length, recipe = float(np.linalg.norm(template)), candidate.recipe
        if candidate.effect == 'slant_geometry' and not self.comparison.known.range().any():
            return False  # the measured distance that stands in for the reference is the slant one
        if length > _FAINT:
            return True
        if length <= _NOTHING or not recipe.size:
            return False
        twice = {
            name: value + 20.0 * math.log10(2.0) if recipe.decibel else 2.0 * value
            for name, value in candidate.values.items()
            if name.partition('[')[0] == recipe.size
        }
        other = self._template([candidate.moved(**twice).build()])
        return float(template @ other) > _ALIKE * length * float(np.linalg.norm(other))

    @property
    def places(self) -> int:
        """How many independent places are searched: what chance is counted over."""
        stations = self.comparison.data.stations
        scanned = [
            CELLS[effect] * len(at_stations(effect, recipe, stations))
            for effect, recipes in RECIPES.items()
            for recipe in recipes
            if recipe.scanned and effect not in self._left_out
        ]
        return sum(self._places.values()) + sum(scanned)

    def _scanned(self, residual: np.ndarray, only: str = '') -> list[Candidate]:
        """Return the places at which the remainder itself says that effects of sharp shape should begin."""
        found = []
        stations, receivers = self.comparison.data.stations, self.comparison.receivers
        wave = SPEED_OF_LIGHT / self.comparison.data.sweeps[0][0].center_frequency
        for effect, recipes in RECIPES.items():
            for recipe in recipes:
                if not recipe.scanned or effect in self._left_out or only not in ('', effect):
                    continue
                for station in at_stations(effect, recipe, stations):
                    number = receivers.index(station) if station in receivers else -1
                    for place in places(self.comparison, residual, effect, number, recipe.scanned):
                        found.append(Candidate(effect, station, recipe.at(wave), dict(recipe.start) | place))
        return found

    def _unit(self, candidate: Candidate, values: dict | None = None) -> np.ndarray:
        """Return the template of a place; kept."""
        values = values or candidate.values
        key = (candidate.effect, candidate.station, tuple(sorted(values.items())))
        if key not in self._kept:
            if len(self._kept) >= _KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = self._template([candidate.build(values)]).astype(np.float32)
        return self._kept[key]

    def settled(self, fitted: Fitted) -> Fitted:
        """Return an explanation whose lengths are told by the echo's delay and not by its carrier phase alone.

        The carrier's phase tells a length to a fraction of a millimetre, but not which of many wavelengths it is, and a
        reflector may shift it. The misfit at whole turns around the best is a parabola by the delay itself: its vertex
        is the length, its curvature the deviation.
        """
        told = [dict(effect.told) for effect in fitted.effects]
        for number, effect in enumerate(fitted.effects):
            name, period = effect.candidate.recipe.turn
            if not name:
                continue
            fitted = self._nearest_turn(fitted, number, name, period)
            fits = []
            for shift in (-period, 0.0, period):
                start = [(e.candidate, dict(e.values)) for e in fitted.effects]
                start[number][1][name] += shift
                fits.append(self.fit(start, 4))
            left, middle, right = (f.misfit for f in fits)
            curvature = left - 2.0 * middle + right
            if curvature <= 0.0:
                continue
            vertex = 0.5 * (left - right) / curvature
            value = fits[1].effects[number].values[name] + float(np.clip(vertex, -1.0, 1.0)) * period
            std = math.hypot(period * math.sqrt(2.0 / curvature), period * _REFLECTION)
            fitted, told[number] = fits[1], {name: (value, std)}
        return fitted.with_told(told)

    def _nearest_turn(self, fitted: Fitted, number: int, name: str, period: float) -> Fitted:
        """Return the explanation with the whole number of turns that fits best."""
        while True:
            others = []
            for turns in (-3, -2, -1, 1, 2, 3):
                start = [(e.candidate, dict(e.values)) for e in fitted.effects]
                start[number][1][name] += turns * period
                others.append(self.fit(start, 4))
            best = min(others, key=lambda f: f.misfit)
            if best.misfit >= fitted.misfit - 0.01:
                return fitted
            fitted = best

    def _promising(
        self, residual: np.ndarray, beside: Sequence[FittedEffect], freedom: Freedom | None, only: str = ''
    ) -> list[tuple[float, Candidate, dict]]:
        """Return (promised gain, candidate, values) of the bank's places, best first.

        Args:
            residual: that they should explain.
            beside: effects of the explanation that is there already.
            freedom: of that explanation, which may follow.
            only: effect that is tried, '' for all.
        """
        scanned = [c for c in self._scanned(residual, only) if self._is_other(c, c.values, beside)]
        kept = [i for i, c in enumerate(self.bank) if only in ('', c.effect) and self._is_other(c, c.values, beside)]
        chosen = [*(self.bank[i] for i in kept), *scanned]
        weighted = (residual * self._weight**2).astype(np.float32)
        templates = np.concatenate(
            [self.templates[kept], np.array([self._unit(c) for c in scanned]).reshape(len(scanned), len(weighted))]
        )
        overlap = templates @ weighted
        power = self._power(templates, freedom)
        found = [
            self._scaled(candidate, float(o), float(p), residual, freedom)
            for candidate, o, p in zip(chosen, overlap, power, strict=True)
            if p > _NOTHING**2
        ]
        return sorted(found, key=lambda item: -item[0])

    def _is_other(self, candidate: Candidate, values: dict[str, float], beside: Sequence[FittedEffect]) -> bool:
        """Return whether a place is that of another effect than those beside it, or of a second one of a kind."""
        same = [e for e in beside if e.key == candidate.key]
        if len(same) >= _OF_A_KIND:
            return False
        name, width = candidate.recipe.scanned, cell(self.comparison, candidate.effect)
        return all(candidate.recipe.repeats and abs(e.values[name] - values[name]) > width for e in same)

    def _power(self, templates: np.ndarray, freedom: Freedom | None) -> np.ndarray:
        """Return the squared lengths of templates (..., n) beyond what an explanation may follow of them."""
        whitened = templates * self._weight.astype(np.float32)
        power = np.einsum('...j,...j->...', whitened, whitened)
        if freedom is None:
            return power
        return np.maximum(power - freedom.followed(whitened), _PARALLEL * power)

    def _scaled(
        self, candidate: Candidate, overlap: float, power: float, residual: np.ndarray, freedom: Freedom | None
    ) -> tuple[float, Candidate, dict]:
        """Return what scaling one template promises, and the values with which to begin."""
        recipe, values = candidate.recipe, dict(candidate.values)
        scale, gain = overlap / power, overlap**2 / power
        if not recipe.size:  # the size is found by refinement
            return gain if overlap > 0.0 else 0.0, candidate, values
        if recipe.per_group:
            return self._scaled_by_group(candidate, residual)
        turn, quarter = recipe.quadrature
        if turn:
            second = self._unit(candidate, dict(values) | {turn: values.get(turn, 0.0) + quarter})
            second_power = max(float(self._power(second, freedom)), 1e-30)
            second_scale = float((second * self._weight**2) @ residual) / second_power
            gain += second_scale**2 * second_power
            angle = math.atan2(second_scale, scale)
            values[turn] = values.get(turn, 0.0) + quarter * angle / (math.pi / 2.0)
            scale = math.hypot(scale, second_scale)
        if recipe.decibel:
            if scale <= 0.0:
                return 0.0, candidate, values
            values[recipe.size] += 20.0 * math.log10(scale)
        else:
            values[recipe.size] *= scale
        low, high = self.bounds(candidate.effect, recipe.size)
        values[recipe.size] = min(max(values[recipe.size], low), high)
        return gain, candidate, values

    def _scaled_by_group(self, candidate: Candidate, residual: np.ndarray) -> tuple[float, Candidate, dict]:
        """Return what scaling a template in each group on its own promises, and the values with which to begin."""
        template = self._template([candidate.build()])
        gain, values = 0.0, {}
        low, high = self.bounds(candidate.effect, candidate.recipe.size)
        for number, (name, value) in enumerate(candidate.values.items()):
            inside = self.comparison.entries.group == number
            power = float(template[inside] @ template[inside])
            overlap = float(template[inside] @ residual[inside])
            scale = overlap / power if power > 0.0 else 0.0
            gain += scale * overlap
            values[name] = min(max(scale * value, low), high)
        return gain, candidate, values

    def freedom(self, fitted: Fitted | None) -> Freedom | None:
        """Return what an explanation can follow, None without effects."""
        if fitted is None or not fitted.effects:
            return None
        return Freedom(self.slopes(fitted) * self._weight)

    def fits(self, starts: Sequence[list[tuple[Candidate, dict[str, float]]]]) -> list[Fitted]:
        """Return explanations fitted from where each begins."""
        return self._workers.map(self.fit, starts)

    def again(self, fitted: Fitted) -> Fitted:
        """Return an explanation fitted again from where it is."""
        told = [e.told for e in fitted.effects]
        return self.fit([(e.candidate, e.values) for e in fitted.effects], 4).with_told(told)

    def imitated(self, effect: FittedEffect, others: Fitted | None) -> float:
        """Return the gain that an effect may owe to what the models of the others are off by, all in its favour."""
        if others is None:
            return 0.0
        template = np.abs(self._template([effect.build()])) * self._weight
        doubt = _OFF * np.abs(others.template) * self._weight
        return float((template @ doubt) ** 2 / max(float(template @ template), 1e-30))

    def credible(self, fitted: Fitted, beside: np.ndarray | float) -> bool:
        """Return whether an explanation's last effect is certain, another one, and more than a wander of the power.

        Args:
            fitted: the explanation.
            beside: template of the other effects.
        """
        *others, last = fitted.effects
        if not fitted.certain or not self._is_other(last.candidate, last.values, others):
            return False
        if not last.candidate.recipe.fringes:
            return True
        elsewhere = ~self.comparison.entries.where(kind='amplitude')
        before, after = (
            np.sum(((self.comparison.residual - t) * self._weight)[elsewhere] ** 2) for t in (beside, fitted.template)
        )
        return bool(before - after > _BEYOND_LEVEL)

    def relocated(self, fitted: Fitted) -> Fitted:
        """Return an explanation with the rays from the ground where they fit best beside the effects that came later.

        The fringes of different heights resemble each other: what is not yet explained may hide the right one.
        """
        number = next((i for i, e in enumerate(fitted.effects) if _is_reflection(e.candidate)), None)
        if number is None:
            return fitted
        candidate, rest = fitted.effects[number].candidate, self._without(fitted, number)
        residual = self.comparison.residual - rest.template
        begun = self._promising(residual, rest.effects, self.freedom(rest), candidate.effect)[:_FRINGES]
        base = [(e.candidate, e.values) for e in rest.effects]
        fits = self.fits([[*base, (candidate, values)] for _, _, values in begun])
        best = min(fits, key=lambda f: f.misfit, default=fitted)
        return best if best.certain and best.misfit < fitted.misfit - _SAME else fitted

    def _without(self, fitted: Fitted, number: int) -> Fitted:
        """Return an explanation without one of its effects, the others as they are; misfit and evidence stay."""
        kept = tuple(e for i, e in enumerate(fitted.effects) if i != number)
        template = self._template([e.build() for e in kept]) if kept else np.zeros_like(fitted.template)
        return dataclasses.replace(fitted, effects=kept, template=template)

    def best_addition(self, current: Fitted | None) -> list[Fitted]:
        """Return explanations with one more effect than `current`, refined, best first."""
        beside = current.template if current else 0.0
        residual = self.comparison.residual - beside
        freedom = self.freedom(current)
        promising = self._promising(residual, current.effects if current else (), freedom)
        chosen: dict[tuple, list] = {}
        for gain, candidate, values in promising:
            if gain < _LEAST:
                break
            begun = chosen.setdefault((candidate.key, candidate.free), [])
            if len(begun) < _STARTS:
                begun.append((gain, candidate, values))
        kinds = sorted(chosen.values(), key=lambda begun: -begun[0][0])[:_TRIED]
        base = [(e.candidate, e.values) for e in current.effects] if current else []

        def begun_at(places_of: list) -> Fitted:
            # a distortion takes long; one linear place is as good as its promise
            linear = len(places_of) == 1 and places_of[0][1].recipe.size
            effect = Effect.registry[places_of[0][1].effect]
            steps = _FIRST_STEPS if places_of[0][1].recipe.size else _STEPS_TO_SIZE
            steps = 0 if linear or effect.distorts() or effect.bursts() else steps
            at = [self.fit([(candidate, values)], steps, beside, freedom) for _, candidate, values in places_of]
            return min(at, key=lambda f: f.misfit)

        def refined(start: Fitted) -> Fitted:
            return self.fit([*base, *((e.candidate, e.values) for e in start.effects)])

        self.report('effects that promise something', 0.3)
        enough = self.misfit(beside) - _LEAST
        starts = [start for start in self._workers.map(begun_at, kinds) if start.misfit < enough]
        self.report('refinement', 0.6)
        results = self._workers.map(refined, sorted(starts, key=lambda f: f.misfit)[:_REFINED])
        return sorted(results, key=lambda f: -f.evidence)

    def probability(self, gain: float, freedom: int, key: tuple[str, str]) -> float:
        """Return the chance that noise alone gains as much somewhere (Bonferroni).

        Every kind of effect has the same share of the false alarms, whatever the number of places it may take.
        """
        count = (len(self._places) + len(CELLS)) * self._places.get(key, CELLS.get(key[0], 1))
        return float(min(1.0, count * stats.chi2.sf(max(gain, 0.0), max(freedom, 1))))

    # --- exchanges ---

    def exchanges(self, fitted: Fitted) -> list[Fitted]:
        """Return explanations with one effect exchanged for another, or for itself elsewhere, best first.

        Elsewhere is another place, or other parameters of the same effect.

        Only those that come near the explanation, or fit better, are refined to the end.
        """
        found: dict[tuple, Fitted] = {}
        elsewhere: list[Fitted] = []
        for left_out in range(len(fitted.effects)):
            rest = self._without(fitted, left_out)
            base = [(e.candidate, e.values) for e in rest.effects]
            goal = self.misfit(rest.template) - fitted.misfit

            def refined(place: tuple, base: list = base, goal: float = goal) -> Fitted | None:
                begun = self.fit([*base, place], _FIRST_STEPS)
                if begun.misfit - fitted.misfit > max(_FAR * RIVAL, _BEHIND * goal):
                    return None
                return self.fit([(e.candidate, e.values) for e in begun.effects])

            for other in self._workers.map(refined, self._substitutes(rest, _PROMISED * goal)):
                if other is None or not self.credible(other, rest.template):
                    continue
                if other.keys == fitted.keys and other.free == fitted.free:
                    if all(self.apart(other, known) >= _SAME for known in (fitted, *elsewhere)):
                        elsewhere.append(other)
                    continue
                known = found.get((other.keys, other.free))
                if known is None or other.misfit < known.misfit:
                    found[other.keys, other.free] = other
        return sorted([*found.values(), *elsewhere], key=lambda f: -f.evidence)

    def apart(self, one: Fitted, other: Fitted) -> float:
        """Return the squared distance between what two explanations add."""
        return float(np.sum(((one.template - other.template) * self._weight) ** 2))

    def _substitutes(self, rest: Fitted, least: float) -> list[tuple[Candidate, dict]]:
        """Return the places of few kinds of effects that promise at least so much beside the rest."""
        residual = self.comparison.residual - rest.template
        found: list[tuple[Candidate, dict]] = []
        tried: dict[tuple, list[np.ndarray]] = {}
        for gain, candidate, values in self._promising(residual, rest.effects, self.freedom(rest)):
            if gain < least or len(tried) >= _FEW:
                break
            there = tried.setdefault(candidate.key, [])
            if len(there) >= (_FRINGES if _is_reflection(candidate) else _PLACES):
                continue
            template = self._unit(candidate, values) * self._weight
            template /= max(float(np.linalg.norm(template)), _NOTHING)
            if all(abs(float(template @ other)) < _ALIKE for other in there):
                there.append(template)
                found.append((candidate, values))
        return found


def _is_reflection(candidate: Candidate) -> bool:
    """Return whether a place is that of a path whose fringes follow the distance, other than an echo's."""
    return candidate.recipe.fringes and not candidate.recipe.turn[0]
