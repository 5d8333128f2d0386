"""The search for one more effect that explains a recording, or for one instead of another: starts and fits."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import stats

from ..compare.groups import displaces
from ..compare.steadiness import LIMITS as STEADINESS
from ..compare.steadiness import odds_of_one_size
from .fits.fitted import Fitted, FittedEffect, Freedom, Linearised, cells_of
from .limits import SEARCH
from .promising import Promising
from .starts.bank import Candidate, recipes
from .starts.scanners import resolution


class Search(Promising):
    """Searches the bank with one comparison."""

    def fits(self, starts: Sequence[list[tuple[Candidate, dict[str, float]]]], known: Fitted) -> list[Fitted]:
        """Return explanations, each fitted from its start, which has some effects of a `known` one exchanged."""
        linearised = self.linearised(known, self.slopes(known)) if starts else None
        return self.workers.map(lambda start: self.fit(start, linearised=linearised, near=known), starts)

    def again(self, fitted: Fitted) -> Fitted:
        """Return an explanation fitted again from its present values.

        Distortions are known to first order there. What bursts do is no smooth function of their parameters.
        """
        linearised = fitted.linearised
        if linearised is None and not any(e.candidate.kind.bursts for e in fitted.effects):
            linearised = self.linearised(fitted, self.slopes(fitted))
        return self.fit(fitted.start, 4, linearised=linearised, near=fitted, exact=True)

    def trusted(self, fitted: Fitted) -> Fitted:
        """Trust the models as far as an explanation allows, and return it fitted again."""
        self.trust(fitted)
        return self.again(fitted)

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
        rounded = c.rows_of_kinds(lambda kind: kind.rounded)
        unchanged = rounded[template[rounded] < SEARCH.unchanged]
        before, after = (self.whitening(c.residual - f.template)[unchanged] for f in (others, together))
        by_rounding = max(float(before @ before - after @ after), 0.0)
        return float(overlap @ overlap) / max(float(template @ template), 1e-30) + by_rounding

    def credible(self, fitted: Fitted, beside: np.ndarray | float) -> bool:
        """Return whether an explanation's last effect is certain, and no other one, drift of the power or noise.

        A drift of the power resembles a second path; noise resembles a modulation, whose size may still be wrong.

        Args:
            fitted: the explanation.
            beside: template of the other effects.
        """
        *others, last = fitted.effects
        if not fitted.certain or not self._is_other(last.candidate, last.values, others):
            return False
        if last.candidate.kind.fluctuates:
            odds = odds_of_one_size(self.comparison, fitted.build(), STEADINESS.any_size)
            return odds[-1] > STEADINESS.unlikely
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
            if effect.candidate.kind.fluctuates and effect.candidate.recipe.scanned:
                fitted = self._shifted(fitted, number)
            if not effect.candidate.recipe.lookalikes:
                continue
            fitted = self._relocated(fitted, number)
            if effect.candidate.recipe.fringes:
                others = (self._relocated(other, number) for other in self._standing_elsewhere(fitted))
                better = min(others, key=lambda f: f.misfit, default=fitted)
                fitted = better if better.misfit < fitted.misfit - SEARCH.same else fitted
        return fitted

    def _shifted(self, fitted: Fitted, number: int) -> Fitted:
        """Return an explanation with the best rate about that of an effect of random phase.

        What random phases leave open follows a part of it: within a resolution cell, several rates fit best around.
        """
        candidate = fitted.effects[number].candidate
        name = candidate.recipe.scanned
        step = SEARCH.shift * resolution(self.comparison, candidate.recipe)

        def refined(shift: float) -> Fitted:
            start = list(fitted.start)
            start[number] = candidate, start[number][1] | {name: start[number][1][name] + shift}
            return self.fit(start)

        best = min(self.workers.map(refined, [-step, step]), key=lambda f: f.misfit)
        return best if best.certain and best.misfit < fitted.misfit - SEARCH.same else fitted

    def _standing_elsewhere(self, fitted: Fitted) -> list[Fitted]:
        """Return an explanation with a delay for an error of the reference that it resembles, or the other way round.

        Only the error of the reference says that the crane stands elsewhere, where a reflection has other fringes.
        """
        found = []
        slopes, templates = self.slopes(fitted), self.whitening(self.templates)
        moving = np.array([displaces(c.kind) for c in self.bank], bool)
        other = (bool(c.recipe.size) and self._is_other(c, c.values, fitted.effects) for c in self.bank)
        tried = np.fromiter(other, bool)
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
        candidate, rest = fitted.effects[number].candidate, self.without(fitted, number)
        residual = self.comparison.residual - rest.template
        freedom = self.freedom_beside(self.slopes(fitted), fitted.spans[number])
        goal = self.misfit(rest.template) - fitted.misfit
        added = self._added(fitted, number, rest, freedom)

        def finished(alone: Fitted) -> Fitted | None:
            return self._finished([*rest.start[:number], *alone.start, *rest.start[number:]], fitted, goal)

        with self.amid(rest):
            promising = self._promising(residual, rest.effects, freedom, candidate.effect)
            begun: list[dict[str, float]] = []
            for _, _, values in promising:
                # of one place, the best start is enough
                if not candidate.recipe.lookalikes or all(_is_elsewhere(candidate, values, v) for v in begun):
                    begun.append(values)
            points = [(candidate, values) for values in begun[: SEARCH.fringes]]
            tried = self.workers.map(lambda point: self._alone(point, rest, freedom, added, goal), points)
            alone = sorted((f for f in tried if f is not None), key=lambda f: f.misfit)
            # the others hardly do more in the end than they do to first order
            behind = SEARCH.behind_elsewhere * abs(alone[0].misfit - added.misfit) if alone else 0.0
            worth = (f for f in alone if f.misfit - alone[0].misfit < max(SEARCH.far * SEARCH.rival, behind))
            refits = self.workers.map(finished, list(worth))
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
        candidate: Candidate = point[0]
        same = [e for e in fitted.effects if e.key == candidate.key and e.candidate.free == candidate.free]
        share = SEARCH.hopeless_elsewhere if same else SEARCH.hopeless
        if alone.misfit - fitted.misfit > max(SEARCH.far * SEARCH.rival, share * goal):
            return None
        if not same or alone.misfit < fitted.misfit - SEARCH.same:
            return alone
        values = alone.effects[0].values
        if candidate.recipe.lookalikes and all(_is_elsewhere(candidate, values, e.values) for e in same):
            return alone  # an alias adds what the right place does
        apart = self.whitening(alone.template - fitted.template)
        apart = apart if freedom is None else freedom.left(apart)
        return None if float(apart @ apart) < SEARCH.returned * goal else alone

    def _finished(
        self,
        start: Sequence[tuple[Candidate, dict[str, float]]],
        fitted: Fitted,
        goal: float,
        linearised: Linearised | None = None,
    ) -> Fitted | None:
        """Return a fit with one effect of an explanation exchanged; None of what stays far behind it at first.

        Args:
            start: where it begins.
            fitted: the explanation.
            goal: gain of the effect that is exchanged.
            linearised: distortions and bursts of the explanation, see `fit`.
        """
        begun = self.fit(start, SEARCH.first_steps, linearised=linearised, near=fitted)
        if begun.misfit - fitted.misfit > _margin(goal):
            return None
        return self.fit(begun.start, linearised=linearised)

    def without(self, fitted: Fitted, *numbers: int) -> Fitted:
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
        slopes = self.slopes(current)
        freedom = Freedom(self.whitening(slopes)) if current is not None else None
        linearised = self.linearised(current, slopes)
        promising = self._promising(residual, current.effects if current else (), freedom, least=SEARCH.least)
        chosen: dict[tuple, list] = {}
        # of those whose gain is what their size makes it: of others, refinement may leave little
        most = max((gain for gain, candidate, _ in promising if candidate.recipe.size), default=0.0)
        for gain, candidate, values in promising:
            if gain < SEARCH.least:
                break
            if gain < SEARCH.hardly * most and not candidate.acts:
                continue  # far behind, see `_least_share`
            begun = chosen.setdefault((candidate.key, candidate.free), [])
            if len(begun) < SEARCH.starts:
                begun.append((gain, candidate, values))
        kinds = sorted(chosen.values(), key=lambda begun: -begun[0][0])[: SEARCH.tried]
        base = current.start if current else []
        held = [(dataclasses.replace(candidate, held=True), values) for candidate, values in base]

        def begun_at(points: list[tuple[float, Candidate, dict[str, float]]]) -> Fitted:
            first = points[0][1]
            # what acts on all others, noise too, is no sum with them; either way they follow to first order
            others, added = (held, 0.0) if first.acts else ([], beside)

            def fits(starts: Sequence[tuple[Candidate, dict[str, float]]], steps: int) -> list[Fitted]:
                at = [self.fit([*others, start], steps, added, freedom) for start in starts]
                return sorted(at, key=lambda f: f.misfit)

            starts = [(candidate, values) for _, candidate, values in points]
            if first.acts:  # it takes long to simulate: only the best start is refined
                return fits([fits(starts, 0)[0].start[-1]], SEARCH.steps_to_size)[0]
            if not first.recipe.size:
                return fits(starts, SEARCH.steps_to_size)[0]
            if len(starts) == 1 and first.recipe.order == 1:
                return fits(starts, 0)[0]  # one linear start gains what it promises
            if len(starts) > SEARCH.foremost:
                starts = [f.start[-1] for f in fits(starts, 0)[: SEARCH.foremost]]
            return fits(starts, SEARCH.first_steps)[0]

        def refined(begun: Fitted) -> Fitted:
            start = [*base, begun.start[-1]]
            return self.fit(start, SEARCH.joint_steps, linearised=linearised, near=current, rounds=SEARCH.joint_rounds)

        def finished(begun: Fitted) -> Fitted:
            return self.fit(begun.start, linearised=linearised)

        self.report('effects that promise something', 0.3)
        before = self.misfit(beside)
        gaining = [f for f in self.workers.map(begun_at, kinds) if f.misfit < before - SEARCH.least]
        starts = self._without_mistaken_bursts(sorted(gaining, key=lambda f: f.misfit))
        if starts:
            best_gain = before - starts[0].misfit
            starts = [s for s in starts if before - s.misfit > _least_share(s.effects[-1].candidate) * best_gain]
        self.report('refinement', 0.6)
        begun = self.workers.map(refined, starts[: SEARCH.refined])
        best = min((f.misfit for f in begun), default=0.0)
        margin = _margin(before - best)
        near = [f for f in begun if f.misfit - best <= margin]
        far = [f for f in begun if f.misfit - best > margin]
        return sorted([*self.workers.map(finished, near), *far], key=lambda f: -f.evidence)

    def _without_mistaken_bursts(self, begun: list[Fitted]) -> list[Fitted]:
        """Return explanations, best first, without the bursts that a distortion outdoes.

        Harmonics that come and go from sweep to sweep look like bursts, and only the doubt beside a distortion knows of
        them. So where bursts are best, each distortion is compared with them as if it were there.
        """
        others = [f for f in begun if not f.effects[-1].candidate.kind.bursts]
        if not others or others[0] is begun[0]:
            return begun
        for one in others:
            if one.effects[-1].candidate.kind.distorts:
                whitening = self.whitening_of(one)
                own, theirs = (whitening(self.comparison.residual - f.template) for f in (one, begun[0]))
                if own @ own < theirs @ theirs:
                    return others
        return begun

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
            added = self.whitening(fitted.template - self.without(fitted, number).template)
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
            rest = self.without(fitted, left_out)
            base = rest.start
            goal = self.misfit(rest.template) - fitted.misfit
            freedom = self.freedom_beside(slopes, own)
            added = self._added(fitted, left_out, rest, freedom)

            def refined(
                point: tuple,
                base: list = base,
                goal: float = goal,
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
                return self._finished([*base, point], fitted, goal, linearised)

            with self.amid(rest):
                points = self._substitutes(rest, SEARCH.promised * goal, freedom)
                points += self._elsewhere(fitted.effects[left_out], rest, points)
                others = self.workers.map(refined, points)
            for other in others:
                if other is None or not self.credible(other, rest.template):
                    continue
                if other.keys == fitted.keys and other.free == fitted.free:
                    if all(self._differ(other, known) for known in (fitted, *elsewhere)):
                        elsewhere.append(other)
                    continue
                known = found.get((other.keys, other.free))
                if known is None or other.misfit < known.misfit:
                    found[other.keys, other.free] = other
        return sorted([*found.values(), *elsewhere], key=lambda f: -f.evidence)

    def _elsewhere(self, effect: FittedEffect, rest: Fitted, known: Sequence[tuple]) -> list[tuple[Candidate, dict]]:
        """Return an effect as it is, at each other station of the pair where it is not among the starts known.

        Of many places that a parameter may have, the starts need not hold its own.
        """
        own = effect.candidate
        if own.acts:
            return []  # what a receiver does to its samples shows at this receiver
        tried = {candidate.key for candidate, _ in known if not candidate.recipe.scanned}
        stations = [s for s in self.comparison.data.stations if own.station not in ('', s)]
        moved = [dataclasses.replace(own, station=s) for s in stations if (own.effect, s) not in tried]
        return [(c, effect.values) for c in moved if self._is_other(c, effect.values, rest.effects)]

    def apart(self, one: Fitted, other: Fitted) -> float:
        """Return the squared distance between what two explanations add."""
        return float(np.sum(self.whitening(one.template - other.template) ** 2))

    def _differ(self, one: Fitted, other: Fitted) -> bool:
        """Return whether two fits of the same effects add something else, or have one at another of its lookalikes."""
        places = (
            all(_is_elsewhere(e.candidate, e.values, o.values) for o in other.effects if o.key == e.key)
            for e in one.effects
            if e.candidate.recipe.lookalikes
        )
        return any(places) or self.apart(one, other) >= SEARCH.same

    def _substitutes(self, rest: Fitted, least: float, freedom: Freedom | None) -> list[tuple[Candidate, dict]]:
        """Return starting points of a few kinds of effects that promise a gain of at least `least` beside the rest."""
        residual = self.comparison.residual - rest.template
        found: list[tuple[Candidate, dict]] = []
        tried: dict[tuple, list[tuple[np.ndarray, dict[str, float]]]] = {}
        for gain, candidate, values in self._promising(residual, rest.effects, freedom, least=least):
            if gain < least or len(tried) >= SEARCH.few:
                break
            there = tried.setdefault(candidate.key, [])
            if len(there) >= (SEARCH.fringes if candidate.recipe.lookalikes else SEARCH.places):
                continue
            template = self.whitening(self._unit(candidate, values))
            template /= max(float(np.linalg.norm(template)), SEARCH.nothing)
            lookalikes = candidate.recipe.lookalikes
            if all(
                abs(float(template @ other)) < SEARCH.alike or (lookalikes and _is_elsewhere(candidate, values, at))
                for other, at in there
            ):
                there.append((template, values))
                found.append((candidate, values))
        return found


def _margin(gain: float) -> float:
    """Return by how much the misfit of a fit that is not finished may exceed one whose effect gains so much."""
    return max(SEARCH.far * SEARCH.rival, SEARCH.behind * gain)


def _least_share(candidate: Candidate) -> float:
    """Return the share of the largest gain where refinement begins that an effect must have there to be refined."""
    return SEARCH.begun_behind if candidate.recipe.size or candidate.acts else SEARCH.begun_far_behind


def _is_elsewhere(candidate: Candidate, one: Mapping[str, float], other: Mapping[str, float]) -> bool:
    """Return whether values of an effect are at different places of what its recipe scans."""
    name = candidate.recipe.scanned
    return not math.isclose(one[name], other[name], rel_tol=SEARCH.elsewhere)
