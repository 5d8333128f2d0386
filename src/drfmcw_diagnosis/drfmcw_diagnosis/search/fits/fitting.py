"""Parameters of effects fitted to one comparison: Levenberg and Marquardt's method on the full forward model."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from drfmcw_physics.settings import declared_parameters
from drfmcw_ros.work.processes import Workers
from drfmcw_sim.effects import Effect

from ...compare.algebra import scaled_inverse
from ...compare.comparison import Comparison
from ...compare.groups import displaces
from ..starts.bank import Candidate
from .fitted import Fitted, FittedEffect, Freedom, Linearised
from .limits import FIT
from .trusting import Trusting
from .whitening import Whitening


def _as_it_is(values: np.ndarray) -> np.ndarray:
    return values


def _stated(covariance: np.ndarray, chosen: Sequence[Candidate], names: Sequence[tuple[int, str]]) -> np.ndarray:
    """Return the standard deviations of fitted parameters (P,), of coefficients about their mean.

    A factor that coefficients have in common changes nothing and is not determined.

    Args:
        covariance: of the parameters (P, P).
        chosen: the effects.
        names: number of the effect and name of each parameter.
    """
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    for number, candidate in enumerate(chosen):
        if candidate.recipe.coefficients and not candidate.held:
            own = [k for k, (i, _) in enumerate(names) if i == number]
            apart = np.eye(len(own)) - 1.0 / len(own)
            std[own] = np.sqrt(np.maximum(np.diag(apart @ covariance[np.ix_(own, own)] @ apart), 0.0))
    return std


def _effects_at(
    start: Sequence[tuple[Candidate, dict[str, float]]],
    names: Sequence[tuple[int, str]],
    point: np.ndarray,
    stated: np.ndarray,
    curvature: np.ndarray,
) -> tuple[FittedEffect, ...]:
    """Return effects with fitted parameters.

    Args:
        start: effects with the values that are not fitted.
        names: number of the effect and name of each parameter.
        point: their values (P,).
        stated: their standard deviations (P,).
        curvature: of the misfit along each (P,).
    """
    fitted = []
    for number, (candidate, values) in enumerate(start):
        mine = {name: k for k, (i, name) in enumerate(names) if i == number}
        own = {name: float(point[k]) for name, k in mine.items()}
        sizes = [curvature[k] for name, k in mine.items() if name == candidate.recipe.size]
        size_std = 1.0 / math.sqrt(max(*sizes, FIT.flat)) if sizes else 0.0
        stds = {name: float(stated[k]) for name, k in mine.items()}
        fitted.append(FittedEffect(candidate, values | own, stds, {}, size_std))
    return tuple(fitted)


def _by_secant(slopes: np.ndarray, weights: np.ndarray, change: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Return slopes (P, n) that say of a step what it did (Broyden's update).

    Args:
        slopes: before it.
        weights: of parameters' changes (P,), those of a unit each.
        change: of the parameters (P,).
        moved: the template's (n,).
    """
    along = weights * change
    return slopes + np.outer(along / max(float(along @ change), FIT.flat), moved - change @ slopes)


def _undistorted(effects: Sequence[Effect]) -> tuple[Effect, ...] | None:
    """Return the effects on which a distortion among `effects` acts, None where there are not both."""
    if not any(e.distorts for e in effects):
        return None
    return tuple(e for e in effects if not (e.distorts or e.bursts)) or None


class Fitting(Trusting):
    """Fits the parameters of effects to one comparison."""

    def __init__(self, comparison: Comparison, jobs: int = 1) -> None:
        """Start with forward models that are trusted without limit.

        Args:
            comparison: recording and model.
            jobs: processes that simulate at once.
        """
        super().__init__(comparison)
        self.workers = Workers(jobs)
        self._slopes: tuple[tuple, np.ndarray] = ((), np.zeros((0, len(comparison.residual))))  # the newest ones

    def fit(
        self,
        start: Sequence[tuple[Candidate, dict[str, float]]],
        steps: int = FIT.steps,
        beside: np.ndarray | float = 0.0,
        freedom: 'Freedom | None' = None,
        linearised: Linearised | None = None,
        near: Fitted | None = None,
        exact: bool = False,
        rounds: int = FIT.rounds,
    ) -> Fitted:
        """Fit the parameters of effects together.

        Args:
            start: effects with the values at which the fit begins.
            steps: at most, of Levenberg and Marquardt's method.
            beside: template of other effects that stay as they are; the result's template contains it.
            freedom: of these others, which may follow to first order; the result's misfit is then that without it.
            linearised: distortions and bursts of an explanation that differs from `start` by some effects; used where
                these hardly change the lines, and as long as their own parameters hardly change.
            near: explanation that shares effects with `start`; where their values are the same, the first step takes
                their slopes, see `slopes`, for those beside the others.
            exact: the fit goes on to the end, and the result's template is that of the full model.
            rounds: at most, in which a distortion is computed anew on the other effects as they were fitted; as many
                before them with it to first order.
        """
        for _ in range(rounds):
            if linearised is None or not self._is_near(start, linearised):
                break
            fitted = self._fit(start, steps, beside, freedom, None, linearised, near, exact)
            acting = [e.values for e in fitted.effects if e.candidate.acts]
            if not linearised.holds(acting):
                break
            if not exact:
                return dataclasses.replace(fitted, linearised=linearised)
            template = beside + self._template([e.build() for e in fitted.effects])
            added = template - (fitted.template - linearised.template(acting))
            linearised = dataclasses.replace(linearised, effects=fitted.effects, added=added)
            start, near = fitted.start, None
            if self._is_settled(fitted, template):
                return self._with_template(dataclasses.replace(fitted, linearised=linearised), template, freedom)
        for _ in range(rounds):
            around = _undistorted([c.build(values) for c, values in start])
            fitted = self._fit(start, steps, beside, freedom, around, near=near, exact=exact)
            if around is None:
                return fitted
            template = beside + self._template([e.build() for e in fitted.effects])
            start = fitted.start
            if self._is_settled(fitted, template):
                break
        return self._with_template(fitted, template, freedom)

    def _is_settled(self, fitted: Fitted, template: np.ndarray) -> bool:
        """Return whether the template with which effects were fitted is near that of the full model."""
        off = float(np.sum(self.whitening(template - fitted.template) ** 2))
        return off < max(FIT.settled, FIT.settled_share * fitted.misfit)

    def _with_template(self, fitted: Fitted, template: np.ndarray, freedom: 'Freedom | None') -> Fitted:
        """Return the same effects with their template by the full model."""
        left = freedom.left if freedom is not None else _as_it_is
        misfit = float(np.sum(left(self.whitening(self.comparison.residual - template)) ** 2))
        evidence = fitted.evidence + (fitted.misfit - misfit) / 2.0
        return dataclasses.replace(fitted, template=template, misfit=misfit, evidence=evidence)

    def _fit(
        self,
        start: Sequence[tuple[Candidate, dict[str, float]]],
        steps: int,
        beside: np.ndarray | float,
        freedom: 'Freedom | None',
        around: tuple[Effect, ...] | None,
        linearised: Linearised | None = None,
        near: Fitted | None = None,
        exact: bool = False,
    ) -> Fitted:
        """Fit with a distortion that acts on the effects `around`, see `Comparison.template`, or with a known one."""
        left = freedom.left if freedom is not None else _as_it_is
        chosen = [c for c, _ in start]
        names = [(i, name) for i, c in enumerate(chosen) for name in c.free]
        point = np.array([start[i][1][name] for i, name in names], float)
        limits = [self.bounds(chosen[i], name) for i, name in names]
        prior = np.array([chosen[i].prior(name) for i, name in names])
        y = self.comparison.residual

        def template_at(p: np.ndarray) -> np.ndarray:
            values = [dict(v) for _, v in start]
            for (i, name), value, (low, high) in zip(names, p, limits, strict=True):
                values[i][name] = float(min(max(value, low), high))
            if linearised is None:
                return beside + self._template([c.build(v) for c, v in zip(chosen, values, strict=True)], around)
            plain = [c.build(v) for c, v in zip(chosen, values, strict=True) if not c.acts]
            known = linearised.template([v for c, v in zip(chosen, values, strict=True) if c.acts])
            return beside + known + (self._template(plain) if plain else 0.0)

        template = template_at(point)
        whitening = self._whitening_of(chosen, template)

        def misfit_of(other: np.ndarray) -> float:
            return float(np.sum(left(whitening(y - other)) ** 2))

        misfit = misfit_of(template)
        known = self._slopes_of(start, near, linearised is not None)
        strides = self._strides(point, chosen, names)
        damping, determined, still = 1e-3, 0, False
        normal = np.eye(len(point))
        at, normal_there = point, normal  # of slopes that no step has updated

        def slopes_here() -> np.ndarray:
            return left(whitening(self._slopes_at(point, template, template_at, chosen, names, strides, known)))

        while still or determined < steps:
            if not still:
                slope = slopes_here()
                normal = slope @ slope.T
                at, normal_there = point, normal
                still, known = bool(known), {}
                determined += not still
            gradient = slope @ whitening(y - template)
            improved = False
            for _ in range(1 if still else 6):
                matrix = normal + damping * np.diag(np.diag(normal) + 1e-30) + np.diag(1e-12 / prior**2)
                trial = point + scaled_inverse(matrix) @ gradient
                trial = np.clip(trial, [low for low, _ in limits], [high for _, high in limits])
                other = template_at(trial)
                value = misfit_of(other)
                if value < misfit:
                    improved = True
                    break
                damping = max(damping, 1e-6) * 10.0
            if not improved and not still:
                break
            if not improved:  # the slopes are those of an earlier point, or beside other effects
                still = False
                continue
            change, fresh = trial - point, not still
            promised = float(change @ (2.0 * gradient - normal @ change))
            slope = _by_secant(slope, np.diag(normal), change, left(whitening(other - template)))
            normal = slope @ slope.T
            gain, misfit, point, template = misfit - value, value, trial, other
            damping *= 0.2
            least = self._least_gain(misfit, exact)
            if gain < least and (fresh or promised < FIT.promised * least):
                break
            still = gain > max((FIT.as_promised if exact else FIT.as_promised_at_first) * promised, least)
        covariance = scaled_inverse(normal_there + np.diag(1e-12 / prior**2))
        if exact and np.any(np.abs(point - at) > FIT.linear * np.sqrt(np.maximum(np.diag(covariance), 0.0))):
            slope = slopes_here()
            normal_there = slope @ slope.T
            covariance = scaled_inverse(normal_there + np.diag(1e-12 / prior**2))
        stated = _stated(covariance, chosen, names)
        fitted = _effects_at(start, names, point, stated, np.diag(normal_there))
        occam = float(np.sum(np.log1p((prior / np.maximum(stated, 1e-12)) ** 2))) / 2.0
        if freedom is None:
            misfit = self.misfit(template)
        evidence = (self.misfit(0.0) - misfit) / 2.0 - occam
        return Fitted(fitted, misfit, template, evidence)

    def _least_gain(self, misfit: float, exact: bool) -> float:
        """Return the gain of a step below which a fit ends: effects that are compared differ by far more."""
        if exact:
            return max(FIT.gained, FIT.gained_share * misfit)
        beyond_chance = misfit - np.count_nonzero(self.comparison.residual)
        return max(FIT.gained_at_first, FIT.gained_share * misfit, FIT.gained_of_left * beyond_chance)

    def _slopes_at(
        self,
        point: np.ndarray,
        template: np.ndarray,
        template_at: Callable[[np.ndarray], np.ndarray],
        chosen: Sequence[Candidate],
        names: Sequence[tuple[int, str]],
        strides: np.ndarray,
        known: Mapping[int, np.ndarray],
    ) -> np.ndarray:
        """Return by how much each parameter changes a template (P, n).

        Args:
            point: the parameters' values (P,).
            template: there (n,).
            template_at: returns it at other values.
            chosen: the effects.
            names: number of the effect and name of each parameter.
            strides: steps of the parameters (P,); in place, those that turn out too long are shortened.
            known: those of some parameters, by their number.
        """
        groups = self.comparison.entries.group
        slopes = np.empty((len(point), len(template)))
        for k, slope in known.items():
            slopes[k] = slope

        def moved(together: list[int]) -> tuple[np.ndarray, np.ndarray]:
            step = np.where(np.isin(np.arange(len(point)), together), strides, 0.0)
            change = template_at(point + step) - template
            if not displaces(chosen[names[together[0]][0]].kind):
                return step, change
            for _ in range(FIT.shorter):  # the phase of a moving crane turns within little
                far = float(np.sum(self.whitening(change) ** 2)) / len(together)
                if far <= FIT.stride**2:
                    break
                step *= FIT.shortened / math.sqrt(far)
                change = template_at(point + step) - template
            return step, change

        sets = [together for together in self._moved_together(chosen, names) if together[0] not in known]
        for together, (step, change) in zip(sets, self.workers.map(moved, sets), strict=True):
            strides[together] = step[together]
            for number, k in enumerate(together):
                own = change if len(together) == 1 else np.where(groups == number, change, 0.0)
                slopes[k] = own / step[k]
        return slopes

    def _slopes_of(
        self, start: Sequence[tuple[Candidate, dict[str, float]]], near: Fitted | None, to_first_order: bool
    ) -> dict[int, np.ndarray]:
        """Return the slopes (n,) of those effects that an explanation has with the same values, by the parameter.

        None where a distortion acts on the sum of all, unless the fit has it `to_first_order`.
        """
        if near is None:
            return {}
        if not to_first_order and any(c.acts for c, _ in (*start, *near.start)):
            return {}
        slopes, first = self.slopes(near), 0
        found: dict[int, np.ndarray] = {}
        for candidate, values in start:
            for effect, own in zip(near.effects, near.spans, strict=True):
                if effect.candidate == candidate and effect.values == values:
                    found |= dict(enumerate(slopes[own], start=first))
            first += len(candidate.free)
        return found

    def linearised(self, fitted: Fitted | None, slopes: np.ndarray) -> Linearised | None:
        """Return the distortions and bursts of an explanation to first order; None where there are none.

        Args:
            fitted: the explanation.
            slopes: of its parameters, see `slopes`.
        """
        if fitted is None or not any(e.candidate.acts for e in fitted.effects):
            return None
        others = [e.build() for e in fitted.effects if not e.candidate.acts]
        added = fitted.template - self._template(others) if others else fitted.template
        acting = [i for i, e in enumerate(fitted.effects) if e.candidate.acts]
        found = {
            (number, name): slope
            for number, i in enumerate(acting)
            for name, slope in zip(fitted.effects[i].candidate.free, slopes[fitted.spans[i]], strict=True)
        }
        return Linearised(fitted.effects, added, found)

    def _is_near(self, start: Sequence[tuple[Candidate, dict[str, float]]], linearised: Linearised) -> bool:
        """Return whether what distorts and bursts is the same, and other effects hardly change the lines."""
        if [c for c, _ in start if c.acts] != [e.candidate for e in linearised.acting]:
            return False
        before = [(e.candidate, e.values) for e in linearised.effects]
        changed = [
            (candidate, values)
            for one, other in ((before, start), (start, before))
            for candidate, values in one
            if not any(candidate == c for c, _ in other)
        ]
        return all(self.comparison.disturbance(c.build(values)) < FIT.still for c, values in changed)

    def _moved_together(self, chosen: Sequence[Candidate], names: Sequence[tuple[int, str]]) -> list[list[int]]:
        """Return which parameters one simulation moves: those of single groups all at once, the others one by one."""
        alone = [[k] for k, (i, _) in enumerate(names) if not chosen[i].recipe.per_group]
        of_groups = (j for j, c in enumerate(chosen) if c.recipe.per_group and c.free)
        return alone + [[k for k, (i, _) in enumerate(names) if i == j] for j in of_groups]

    def _whitening_of(self, chosen: Sequence[Candidate], template: np.ndarray) -> Whitening:
        """Return the whitening of a fit: bursts that a group holds by chance do not drive it.

        Where there are bursts already, their numbers are in doubt for that, see `doubt`: once is enough.
        """
        if not any(c.kind.bursts for c in chosen):
            return self.whitening
        doubt = np.zeros(len(template))
        for kind in self.comparison.kinds:
            if kind.trust.beside_bursts is not None:
                rows = self.comparison.rows(kind)
                doubt[rows] = kind.by_chance(template[rows], self.comparison.std[kind.name].ravel())
        return self.whitening.reweighted(np.minimum(self.whitening.weight, 1.0 / np.sqrt(1.0 + doubt**2)))

    def _step(self, candidate: Candidate, name: str, value: float) -> float:
        """Return the step of a numerical derivative, away from the upper bound."""
        step = candidate.recipe.step(name, value)
        return -step if value + step > self.bounds(candidate, name)[1] else step

    def _strides(self, point: np.ndarray, chosen: Sequence[Candidate], names: Sequence[tuple[int, str]]) -> np.ndarray:
        """Return the steps of the numerical derivatives at a point (P,); arguments as `_slopes_at`."""
        return np.array([self._step(chosen[i], name, at) for (i, name), at in zip(names, point, strict=True)])

    def bounds(self, candidate: Candidate, name: str) -> tuple[float, float]:
        """Return the bounds of a parameter: as declared, and a time no longer than the recording if the recipe says."""
        base = name.partition('[')[0]
        _, declared = declared_parameters(candidate.kind)[base]
        low, high = declared.bounds or (-math.inf, math.inf)
        if base in candidate.recipe.limits:
            low, high = candidate.recipe.limits[base]
        if base == candidate.recipe.carrier[0]:
            return -math.inf, math.inf  # turns by itself
        if base in candidate.recipe.within_recording:
            high = min(high, max(float(np.ptp(self.comparison.data.time)), 1.0))
        if base in candidate.recipe.within_sweep:
            high = min(high, FIT.sweeps * max(sweep.ramp_duration for sweep in self.comparison.data.sweeps[0]))
        return low, high

    def slopes(self, fitted: Fitted | None) -> np.ndarray:
        """Return by how much each parameter of an explanation changes its template (parameters, n), none of None."""
        if fitted is None:
            return np.zeros((0, len(self.comparison.residual)))
        chosen = [e.candidate for e in fitted.effects]
        names = [(i, name) for i, c in enumerate(chosen) for name in c.free]
        around = _undistorted(fitted.build())

        def template_at(p: np.ndarray) -> np.ndarray:
            values = [dict(e.values) for e in fitted.effects]
            for (i, name), value in zip(names, p, strict=True):
                values[i][name] = float(value)
            return self._template([c.build(v) for c, v in zip(chosen, values, strict=True)], around)

        key = tuple((e.key, e.candidate.free, tuple(e.values.items())) for e in fitted.effects)
        if key != self._slopes[0]:
            point = np.array([fitted.effects[i].values[name] for i, name in names])
            template = fitted.template if around is None else template_at(point)
            strides = self._strides(point, chosen, names)
            self._slopes = key, self._slopes_at(point, template, template_at, chosen, names, strides, {})
        return self._slopes[1]
