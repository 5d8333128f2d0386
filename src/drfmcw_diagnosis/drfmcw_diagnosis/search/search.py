"""The search for one more effect that explains a recording, or for one instead of another: bank, templates, fits."""

import collections
import dataclasses
import math
from collections.abc import Callable, Collection, Sequence

import numpy as np
from scipy import stats

from drfmcw_physics.constants import SPEED_OF_LIGHT

from ..compare.algebra import scaled_inverse
from ..compare.comparison import Comparison
from ..compare.predicting import displaces
from .bank import Candidate, at_stations, candidates, of_coefficients, recipes
from .fitting import Fitted, FittedEffect, Fitting, Freedom, cells_of
from .limits import SEARCH
from .scanners import resolution, starting_points
from .scanning import Rest


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
        super().__init__(comparison, jobs)
        self._kept: dict[tuple, np.ndarray] = {}
        self._left_out = without
        self.doubted: frozenset[tuple[str, str]] = frozenset()
        """Effects, with their stations, that are not tried because they imitate something unknown."""
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
        """Return whether the recording can show an effect; a template that does not grow with its size is rounding."""
        length, recipe = float(np.linalg.norm(template)), candidate.recipe
        if recipe.needs_reference and not self.comparison.known.range().any():
            return False
        if length > SEARCH.faint:
            return True
        if length <= SEARCH.nothing or not recipe.size:
            return False
        twice = {
            name: value + 20.0 * math.log10(2.0) if recipe.decibel else 2.0 * value
            for name, value in candidate.values.items()
            if name.partition('[')[0] == recipe.size
        }
        other = self._template([candidate.moved(**twice).build()])
        return float(template @ other) > SEARCH.alike * length * float(np.linalg.norm(other))

    @property
    def places(self) -> int:
        """Number of independent starting points: what chance is counted over."""
        stations = self.comparison.data.stations
        scanned = (
            recipe.cells * len(at_stations(effect, recipe, stations))
            for effect, recipe in recipes(self._left_out)
            if recipe.scan
        )
        return sum(self._places.values()) + sum(scanned)

    def _scanned(self, residual: np.ndarray, only: str = '') -> list[Candidate]:
        """Return the starting points that scanners find in the remainder."""
        found = []
        rest = Rest(self.comparison, residual, self.comparison.distances(self._place.effects))
        stations, receivers = self.comparison.data.stations, self.comparison.receivers
        wave = SPEED_OF_LIGHT / self.comparison.data.sweeps[0][0].center_frequency
        for effect, recipe in recipes(self._left_out):
            if not recipe.scan or only not in ('', effect):
                continue
            for station in at_stations(effect, recipe, stations):
                number = receivers.index(station) if station in receivers else -1
                for point in starting_points(rest, recipe, number):
                    found.append(Candidate(effect, station, recipe.at(wave), dict(recipe.start) | point))
        return found

    def templates_beside(self, fitted: Fitted | None, scanned: bool = True) -> np.ndarray:
        """Return the templates of all starting points that may be tried beside an explanation (M, n).

        Args:
            fitted: the explanation, None for none.
            scanned: those too that scanners find.
        """
        beside = fitted.effects if fitted is not None else ()
        kept = [i for i, c in enumerate(self.bank) if self._is_other(c, c.values, beside)]
        if not scanned:
            return self.templates[kept]
        template = fitted.template if fitted is not None else 0.0
        found = self._scanned(self.without_set_aside(self.comparison.residual - template))
        units = self._units([(c, c.values) for c in found if self._is_other(c, c.values, beside)])
        added = np.array(units, np.float32).reshape(len(units), len(self.comparison.residual))
        return np.concatenate([self.templates[kept], added])

    def give_up(self, effect: FittedEffect) -> None:
        """Do not try an effect again, nor others that add the same."""
        own = self.whitening.weight * self._template([effect.build()])
        along = self.templates @ (self.whitening.weight * own).astype(np.float32)
        length = np.linalg.norm(self.templates * self.whitening.weight.astype(np.float32), axis=1)
        alike = np.abs(along) > SEARCH.same_shape * np.maximum(length * float(np.linalg.norm(own)), SEARCH.nothing)
        self.doubted |= {effect.key} | {self.bank[i].key for i in np.flatnonzero(alike)}

    def _unit(self, candidate: Candidate, values: dict | None = None) -> np.ndarray:
        """Return the template of a candidate; templates are kept."""
        return self._units([(candidate, values or candidate.values)])[0]

    def _units(self, wanted: Sequence[tuple[Candidate, dict[str, float]]]) -> list[np.ndarray]:
        """Return the templates of candidates with values of their parameters."""

        def simulated(key: tuple) -> np.ndarray:
            candidate, values = missing[key]
            return self._template([candidate.build(values)]).astype(np.float32)

        keys = [
            (c.effect, c.station, tuple(sorted(values.items())), tuple(map(repr, self._around([c.kind]).effects)))
            for c, values in wanted
        ]
        missing = {key: w for key, w in zip(keys, wanted, strict=True) if key not in self._kept}
        found = {key: self._kept[key] for key in keys if key in self._kept}
        found |= zip(missing, self._workers.map(simulated, list(missing)), strict=True)
        self._kept |= {key: found[key] for key in missing}
        for key in list(self._kept)[: max(len(self._kept) - SEARCH.kept, 0)]:
            del self._kept[key]
        return [found[key] for key in keys]

    def _promising(
        self, residual: np.ndarray, beside: Sequence[FittedEffect], freedom: Freedom | None, only: str = ''
    ) -> list[tuple[float, Candidate, dict]]:
        """Return (promised gain, candidate, values) of all starting points, best first.

        The gain counts only what the present explanation cannot follow by a change of its own parameters.

        Args:
            residual: what is left to explain.
            beside: effects of the present explanation.
            freedom: of the present explanation.
            only: effect that is tried, '' for all.
        """
        scanned = [
            c for c in self._scanned(self.without_set_aside(residual), only) if self._is_other(c, c.values, beside)
        ]
        kept = [i for i, c in enumerate(self.bank) if only in ('', c.effect) and self._is_other(c, c.values, beside)]
        chosen = [*(self.bank[i] for i in kept), *scanned]
        weighted = self.whitening.transposed(self.whitening(residual)).astype(np.float32)
        units = np.array(self._units([(c, c.values) for c in scanned])).reshape(len(scanned), len(weighted))
        templates = np.concatenate([self.templates[kept], units])
        overlap = templates @ weighted
        power = self._power(templates, freedom)
        strong = np.flatnonzero(power > SEARCH.nothing**2)
        turned = [(chosen[i], _in_quadrature(chosen[i])) for i in strong if chosen[i].recipe.quadrature[0]]
        self._units(turned)  # all at once, and kept
        found = [self._scaled(chosen[i], float(overlap[i]), float(power[i]), residual, freedom) for i in strong]
        return sorted(found, key=lambda item: -item[0])

    def _is_other(self, candidate: Candidate, values: dict[str, float], beside: Sequence[FittedEffect]) -> bool:
        """Return whether a candidate may be tried beside effects: another kind, or a resolution cell apart."""
        same = [e for e in beside if e.key == candidate.key]
        if len(same) >= SEARCH.of_a_kind or self._is_doubted(candidate):
            return False
        name, width = candidate.recipe.scanned, resolution(self.comparison, candidate.recipe)
        return all(candidate.recipe.repeats and abs(e.values[name] - values[name]) > width for e in same)

    def _is_doubted(self, candidate: Candidate) -> bool:
        """Return whether an effect is not tried at a station, or at both of which one is doubted."""
        stations = {station for effect, station in self.doubted if effect == candidate.effect}
        return candidate.station in stations or bool(stations and not candidate.station)

    def _power(self, templates: np.ndarray, freedom: Freedom | None) -> np.ndarray:
        """Return the squared lengths of templates (..., n) without what an explanation can follow of them."""
        whitened = self.whitening(templates)
        power = np.einsum('...j,...j->...', whitened, whitened)
        if freedom is None:
            return power
        return np.maximum(power - freedom.followed(whitened), SEARCH.parallel * power)

    def _scaled(
        self, candidate: Candidate, overlap: float, power: float, residual: np.ndarray, freedom: Freedom | None
    ) -> tuple[float, Candidate, dict]:
        """Return (promised gain, candidate, values) with the template scaled to the residual."""
        recipe, values = candidate.recipe, dict(candidate.values)
        scale, gain = overlap / power, overlap**2 / power
        if not recipe.size:  # the size is found by refinement
            return gain if overlap > 0.0 else 0.0, candidate, values
        if recipe.per_group:
            return self._scaled_by_group(candidate, residual, freedom)
        if recipe.order > 1:
            if scale <= 0.0:
                return 0.0, candidate, values
            scale = scale ** (1.0 / recipe.order)
        turn, quarter = recipe.quadrature
        if turn:
            second = self._unit(candidate, _in_quadrature(candidate))
            second_power = max(float(self._power(second, freedom)), 1e-30)
            second_scale = float(second @ self.whitening.transposed(self.whitening(residual))) / second_power
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
        low, high = self.bounds(candidate, recipe.size)
        values[recipe.size] = min(max(values[recipe.size], low), high)
        return gain, candidate, values

    def _scaled_by_group(
        self, candidate: Candidate, residual: np.ndarray, freedom: Freedom | None
    ) -> tuple[float, Candidate, dict]:
        """Return (promised gain, candidate, values) with the template scaled to the residual of each group."""
        each, rest = self.whitening(self._by_group(self._unit(candidate))), self.whitening(residual)
        if freedom is not None:
            each, rest = freedom.left(each), freedom.left(rest)
        along = each @ rest
        scales = scaled_inverse(each @ each.T) @ along
        low, high = self.bounds(candidate, candidate.recipe.size)
        scaled = zip(candidate.values.items(), scales, strict=True)
        values = {name: float(min(max(scale * value, low), high)) for (name, value), scale in scaled}
        return float(scales @ along), candidate, values

    def _freedom_beside(self, slopes: np.ndarray, *own: slice) -> Freedom | None:
        """Return the freedom of all effects but some, None without others.

        Args:
            slopes: of the parameters of all, see `slopes`.
            own: where those of each left out stand.
        """
        others = np.delete(slopes, np.r_[own], axis=0)
        return Freedom(self.whitening(others)) if len(others) else None

    def fits(self, starts: Sequence[list[tuple[Candidate, dict[str, float]]]], known: Fitted) -> list[Fitted]:
        """Return explanations, each fitted from its start, which has some effects of a `known` one exchanged."""
        linearised = self.linearised(known, self.slopes(known)) if starts else None
        return self._workers.map(lambda start: self.fit(start, linearised=linearised), starts)

    def again(self, fitted: Fitted) -> Fitted:
        """Return an explanation fitted again from its present values."""
        return self.fit(fitted.start, 4, linearised=fitted.linearised, exact=True)

    def imitated(self, effect: FittedEffect, others: Fitted | None, together: Fitted) -> float:
        """Return the gain that an effect may owe to errors of the other effects' forward models.

        An error is at its worst within a cell, see `cells_of`, and independent from cell to cell. What is rounded, and
        not changed by the effect, may have changed as the others were fitted again.

        Args:
            effect: of an explanation.
            others: the explanation without it, None for none.
            together: the explanation.
        """
        if others is None:
            return 0.0
        c, weight = self.comparison, self.whitening.weight
        template = np.abs(self._template([effect.build()])) * weight
        doubt = SEARCH.off * np.abs(others.template) * weight
        overlap = np.bincount(cells_of(c.entries), template * doubt)
        rounded = np.concatenate([c.rows(kind) for kind in c.kinds if kind.rounded])
        unchanged = rounded[template[rounded] < SEARCH.unchanged]
        before, after = (self.whitening(c.residual - f.template)[unchanged] for f in (others, together))
        by_rounding = max(float(before @ before - after @ after), 0.0)
        return float(overlap @ overlap) / max(float(template @ template), 1e-30) + by_rounding

    def credible(self, fitted: Fitted, beside: np.ndarray | float) -> bool:
        """Return whether an explanation's last effect is certain, differs from the others, and is no mere power drift.

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
            np.sum(self.whitening(self.comparison.residual - t)[elsewhere] ** 2) for t in (beside, fitted.template)
        )
        return bool(before - after > SEARCH.beyond_level)

    def relocated(self, fitted: Fitted) -> Fitted:
        """Return an explanation with effects elsewhere whose places resemble each other, beside those added later.

        The fringes of different heights of a reflector, or the aliases of a sway: effects that are not yet explained
        may hide the right one.
        """
        for number, effect in enumerate(fitted.effects):
            if effect.candidate.recipe.lookalikes:
                fitted = self._relocated(fitted, number)
            if effect.candidate.recipe.fringes:
                others = (self._relocated(other, number) for other in self._standing_elsewhere(fitted))
                better = min(others, key=lambda f: f.misfit, default=fitted)
                fitted = better if better.misfit < fitted.misfit - SEARCH.same else fitted
        return fitted

    def _standing_elsewhere(self, fitted: Fitted) -> list[Fitted]:
        """Return an explanation with a delay for an error of the reference that it resembles, or the other way round.

        Only the error of the reference says that the crane stands elsewhere, where a reflection has other fringes.
        """
        found = []
        slopes, templates = self.slopes(fitted), self.whitening(self.templates)
        moving = np.array([displaces(c.kind) for c in self.bank], bool)
        tried = [bool(c.recipe.size) and self._is_other(c, c.values, fitted.effects) for c in self.bank]
        for number, (effect, own) in enumerate(zip(fitted.effects, fitted.spans, strict=True)):
            others = np.flatnonzero(tried & (moving != displaces(effect.candidate.kind)))
            freedom = Freedom(self.whitening(np.delete(slopes, own, axis=0)))
            added = freedom.left(self.whitening(self._template([effect.build()])))
            shown = freedom.left(templates[others])
            power, along = np.einsum('mj,mj->m', shown, shown), shown @ added
            alike = along**2 > SEARCH.same_shape**2 * power * float(added @ added)
            for i in np.flatnonzero(alike)[:1]:
                other = self.bank[others[i]]
                scaled = {other.recipe.size: other.values[other.recipe.size] * float(along[i] / power[i])}
                start = [*fitted.start[:number], (other, other.values | scaled), *fitted.start[number + 1 :]]
                found.append(self.fit(start, 0))
        return found

    def _relocated(self, fitted: Fitted, number: int) -> Fitted:
        """Return an explanation with one of its effects at the place where all fit best."""
        candidate, rest = fitted.effects[number].candidate, self._without(fitted, number)
        residual = self.comparison.residual - rest.template
        freedom = self._freedom_beside(self.slopes(fitted), fitted.spans[number])
        goal = self.misfit(rest.template) - fitted.misfit
        added = self._added(fitted, number, rest, freedom)

        def refined(point: tuple) -> Fitted | None:
            alone = self._alone(point, rest, freedom, added, goal)
            return None if alone is None else self.fit([*rest.start[:number], *alone.start, *rest.start[number:]])

        with self.amid(rest):
            begun = self._promising(residual, rest.effects, freedom, candidate.effect)[: SEARCH.fringes]
            refits = self._workers.map(refined, [(candidate, values) for _, _, values in begun])
        fits = [f for f in refits if f is not None]
        best = min(fits, key=lambda f: f.misfit, default=fitted)
        return best if best.certain and best.misfit < fitted.misfit - SEARCH.same else fitted

    def _added(self, fitted: Fitted, number: int, rest: Fitted, freedom: Freedom | None) -> Fitted:
        """Return an explanation with one of its effects simply added to the others, as `_alone` tries another one.

        A distortion acts on the sum of all effects, so it may fit far worse than the explanation itself.

        Args:
            fitted: the explanation.
            number: of the effect.
            rest: the others.
            freedom: of the others.
        """
        effect = fitted.effects[number]
        if effect.candidate.acts or not any(e.candidate.acts for e in fitted.effects):
            return fitted
        template = rest.template + self._template([effect.build()])
        left = self.whitening(self.comparison.residual - template)
        left = left if freedom is None else freedom.left(left)
        return dataclasses.replace(fitted, template=template, misfit=max(fitted.misfit, float(left @ left)))

    def _alone(self, point: tuple, rest: Fitted, freedom: Freedom | None, fitted: Fitted, goal: float) -> Fitted | None:
        """Return one effect fitted while the others follow to first order; None of what need not be fitted with them.

        Args:
            point: effect with the values at which its fit begins.
            rest: the others.
            freedom: of the others.
            fitted: explanation with the effect that it shall replace, see `_added`.
            goal: gain of the effect that it replaces there.
        """
        alone = self.fit([point], SEARCH.alone_steps, rest.template, freedom)
        elsewhere = any(e.key == point[0].key and e.candidate.free == point[0].free for e in fitted.effects)
        share = SEARCH.hopeless_elsewhere if elsewhere else SEARCH.hopeless
        if alone.misfit - fitted.misfit > max(SEARCH.far * SEARCH.rival, share * goal):
            return None
        if not elsewhere or alone.misfit < fitted.misfit - SEARCH.same:  # an alias resembles the right place
            return alone
        apart = self.whitening(alone.template - fitted.template)
        apart = apart if freedom is None else freedom.left(apart)
        return None if float(apart @ apart) < SEARCH.returned * goal else alone

    def _without(self, fitted: Fitted, *numbers: int) -> Fitted:
        """Return an explanation without some of its effects, the others as they are; misfit and evidence stay."""
        kept = tuple(e for i, e in enumerate(fitted.effects) if i not in numbers)
        template = self._template([e.build() for e in kept]) if kept else np.zeros_like(fitted.template)
        return dataclasses.replace(fitted, effects=kept, template=template)

    def best_addition(self, current: Fitted | None) -> list[Fitted]:
        """Return explanations with one more effect than `current`, refined, best first."""
        with self.amid(current):
            return self._best_addition(current)

    def _best_addition(self, current: Fitted | None) -> list[Fitted]:
        beside = current.template if current else 0.0
        residual = self.comparison.residual - beside
        slopes = self.slopes(current) if current is not None else np.zeros((0, len(residual)))
        freedom = Freedom(self.whitening(slopes)) if current is not None else None
        linearised = self.linearised(current, slopes)
        promising = self._promising(residual, current.effects if current else (), freedom)
        chosen: dict[tuple, list] = {}
        for gain, candidate, values in promising:
            if gain < SEARCH.least:
                break
            begun = chosen.setdefault((candidate.key, candidate.free), [])
            if len(begun) < SEARCH.starts:
                begun.append((gain, candidate, values))
        kinds = sorted(chosen.values(), key=lambda begun: -begun[0][0])[: SEARCH.tried]
        base = current.start if current else []

        def begun_at(points: list[tuple[float, Candidate, dict[str, float]]]) -> Fitted:
            # a distortion takes long to simulate; one linear starting point gains what it promises
            linear = len(points) == 1 and points[0][1].recipe.size and points[0][1].recipe.order == 1
            steps = SEARCH.first_steps if points[0][1].recipe.size else SEARCH.steps_to_size
            steps = 0 if linear or points[0][1].acts else steps
            at = [self.fit([(candidate, values)], steps, beside, freedom) for _, candidate, values in points]
            return min(at, key=lambda f: f.misfit)

        def refined(alone: Fitted) -> Fitted:
            return self.fit([*base, *alone.start], SEARCH.joint_steps, linearised=linearised)

        def finished(begun: Fitted) -> Fitted:
            return self.fit(begun.start, linearised=linearised)

        self.report('effects that promise something', 0.3)
        enough = self.misfit(beside) - SEARCH.least
        starts = sorted((s for s in self._workers.map(begun_at, kinds) if s.misfit < enough), key=lambda f: f.misfit)
        if starts:
            most = self.misfit(beside) - SEARCH.begun_behind * (self.misfit(beside) - starts[0].misfit)
            starts = [s for s in starts if s.misfit < most or not s.effects[-1].candidate.recipe.size]
        self.report('refinement', 0.6)
        begun = self._workers.map(refined, starts[: SEARCH.refined])
        best = min((f.misfit for f in begun), default=0.0)
        margin = max(SEARCH.far * SEARCH.rival, SEARCH.behind * (self.misfit(beside) - best))
        near = [f for f in begun if f.misfit - best <= margin]
        far = [f for f in begun if f.misfit - best > margin]
        return sorted([*self._workers.map(finished, near), *far], key=lambda f: -f.evidence)

    def probability(self, gain: float, freedom: int, key: tuple[str, str]) -> float:
        """Return the probability that noise alone gains as much for any effect at any starting point (Bonferroni).

        Every kind of effect has the same share of the false alarms, however many starting points it has.
        """
        cells = {effect: recipe.cells for effect, recipe in recipes() if recipe.scan}
        count = (len(self._places) + len(cells)) * self._places.get(key, cells.get(key[0], 1))
        return float(min(1.0, count * stats.chi2.sf(max(gain, 0.0), max(freedom, 1))))

    def indispensable(self, fitted: Fitted, slopes: np.ndarray) -> list[bool]:
        """Return of each effect whether the others can, to first order, by far not explain what it explains.

        Args:
            fitted: the effects.
            slopes: of their parameters, see `slopes`.
        """
        slopes = self.whitening(slopes)
        found = []
        for number, own in enumerate(fitted.spans):
            added = self.whitening(fitted.template - self._without(fitted, number).template)
            power = float(added @ added)
            others = Freedom(np.delete(slopes, own, axis=0))
            left = power - float(others.followed(added))
            found.append(left > max(SEARCH.plenty, SEARCH.own * power))
        return found

    # --- exchanges ---

    def exchanges(self, fitted: Fitted) -> list[Fitted]:
        """Return explanations with one effect exchanged for another, or for itself with other parameters, best first.

        Only those that fit nearly as well as the explanation, or better, are refined to the end.
        """
        found: dict[tuple, Fitted] = {}
        elsewhere: list[Fitted] = []
        slopes = self.slopes(fitted)
        linearised = self.linearised(fitted, slopes)
        for left_out, own in enumerate(fitted.spans):
            rest = self._without(fitted, left_out)
            base = rest.start
            goal = self.misfit(rest.template) - fitted.misfit
            margin = max(SEARCH.far * SEARCH.rival, SEARCH.behind * goal)
            freedom = self._freedom_beside(slopes, own)
            added = self._added(fitted, left_out, rest, freedom)

            def refined(
                point: tuple,
                base: list = base,
                goal: float = goal,
                margin: float = margin,
                rest: Fitted = rest,
                freedom: Freedom | None = freedom,
                added: Fitted = added,
            ) -> Fitted | None:
                candidate: Candidate = point[0]
                if not candidate.acts:
                    alone = self._alone(point, rest, freedom, added, goal)
                    if alone is None:
                        return None
                    point = alone.start[0]
                begun = self.fit([*base, point], SEARCH.first_steps, linearised=linearised)
                if begun.misfit - fitted.misfit > margin:
                    return None
                return self.fit(begun.start, linearised=linearised)

            with self.amid(rest):
                points = self._substitutes(rest, SEARCH.promised * goal, freedom)
                points += self._elsewhere(fitted.effects[left_out], rest, points)
                others = self._workers.map(refined, points)
            for other in others:
                if other is None or not self.credible(other, rest.template):
                    continue
                if other.keys == fitted.keys and other.free == fitted.free:
                    if all(self.apart(other, known) >= SEARCH.same for known in (fitted, *elsewhere)):
                        elsewhere.append(other)
                    continue
                known = found.get((other.keys, other.free))
                if known is None or other.misfit < known.misfit:
                    found[other.keys, other.free] = other
        return sorted([*found.values(), *elsewhere], key=lambda f: -f.evidence)

    def _elsewhere(self, effect: FittedEffect, rest: Fitted, known: Sequence[tuple]) -> list[tuple[Candidate, dict]]:
        """Return an effect as it is, at each other station of the pair where it is not among the starts known."""
        own = effect.candidate
        if own.acts:
            return []  # what a receiver does to its samples shows at this receiver
        tried = {candidate.key for candidate, _ in known}
        stations = [s for s in self.comparison.data.stations if own.station not in ('', s)]
        moved = [dataclasses.replace(own, station=s) for s in stations if (own.effect, s) not in tried]
        return [(c, effect.values) for c in moved if self._is_other(c, effect.values, rest.effects)]

    def unified(self, fitted: Fitted, fewest: int) -> list[Fitted]:
        """Return explanations with one effect of many coefficients for those that shape a chirp, best first.

        It takes the place of all, of one station's, or of all but one.

        Only what gains about as much as these, alone and with most coefficients, is fitted with the other effects.

        Args:
            fitted: explanation.
            fewest: effects that shape a chirp, of one station or of both, and are worth it.
        """
        shaping = [i for i, e in enumerate(fitted.effects) if e.candidate.kind.shapes_chirp]
        # of several that imitate a bent ramp, one may be what is there beside it
        all_but_one = [tuple(i for i in shaping if i != kept) for kept in shaping if len(shaping) > 2]
        tried: dict[tuple, list[Candidate]] = {}
        for candidate in of_coefficients(self.comparison.data.stations, self._left_out):
            own = [i for i in shaping if fitted.effects[i].key[1] == candidate.station]
            for replaced in {tuple(own), tuple(shaping), *all_but_one}:
                if len(replaced) >= fewest:
                    tried.setdefault((*candidate.key, replaced), []).append(candidate)

        if not tried:
            return []
        slopes = self.slopes(fitted)
        linearised = self.linearised(fitted, slopes)

        def gains_as_much(item: tuple[tuple, list[Candidate]]) -> bool:
            (_, _, replaced), several = item
            rest = self._without(fitted, *replaced)
            freedom = self._freedom_beside(slopes, *(fitted.spans[i] for i in replaced))
            most = max(several, key=lambda c: len(c.values))
            alone = self.fit([(most, most.values)], SEARCH.first_steps, rest.template, freedom)
            least = SEARCH.much * (self.misfit(rest.template) - fitted.misfit)
            return alone.misfit - fitted.misfit < max(SEARCH.far * SEARCH.rival, least)

        def refined(start: list[tuple[Candidate, dict[str, float]]]) -> Fitted:
            return self.fit(start, linearised=linearised)

        gains = self._workers.map(gains_as_much, list(tried.items()))
        chosen = [item for item, enough in zip(tried.items(), gains, strict=True) if enough]
        starts = []
        for (_, _, replaced), several in chosen:
            others = [point for i, point in enumerate(fitted.start) if i not in replaced]
            starts += [[*others, (candidate, candidate.values)] for candidate in several]
        return sorted(self._workers.map(refined, starts), key=lambda f: -f.evidence)

    def apart(self, one: Fitted, other: Fitted) -> float:
        """Return the squared distance between what two explanations add."""
        return float(np.sum(self.whitening(one.template - other.template) ** 2))

    def _substitutes(self, rest: Fitted, least: float, freedom: Freedom | None) -> list[tuple[Candidate, dict]]:
        """Return starting points of a few kinds of effects that promise a gain of at least `least` beside the rest."""
        residual = self.comparison.residual - rest.template
        found: list[tuple[Candidate, dict]] = []
        tried: dict[tuple, list[np.ndarray]] = {}
        for gain, candidate, values in self._promising(residual, rest.effects, freedom):
            if gain < least or len(tried) >= SEARCH.few:
                break
            there = tried.setdefault(candidate.key, [])
            if len(there) >= (SEARCH.fringes if candidate.recipe.lookalikes else SEARCH.places):
                continue
            template = self.whitening(self._unit(candidate, values))
            template /= max(float(np.linalg.norm(template)), SEARCH.nothing)
            if all(abs(float(template @ other)) < SEARCH.alike for other in there):
                there.append(template)
                found.append((candidate, values))
        return found


def _in_quadrature(candidate: Candidate) -> dict[str, float]:
    """Return the values of a candidate's parameters with its phase a quarter of a turn on."""
    turn, quarter = candidate.recipe.quadrature
    return candidate.values | {turn: candidate.values.get(turn, 0.0) + quarter}
