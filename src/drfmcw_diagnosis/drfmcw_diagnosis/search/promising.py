"""Which effects promise to explain what is left, and where their fits begin: templates of the bank, scaled to it.

In: a comparison, what an explanation leaves of it. Out: starting points with the gain that each promises, best first.
"""

import collections
import dataclasses
import itertools
import math
from collections.abc import Callable, Collection, Sequence

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_sim.effects import Recipe

from ..compare.algebra import scaled_inverse
from ..compare.comparison import Comparison
from .fits.fitted import Fitted, FittedEffect, Freedom
from .fits.fitting import Fitting
from .fits.whitening import Whitening
from .limits import SCAN, SEARCH
from .starts.bank import Candidate, at_stations, candidates, recipes
from .starts.scanners import resolution, starting_points
from .starts.scanning import Rest


class Promising(Fitting):
    """Keeps the templates of the bank, and ranks what may be added to an explanation by what it promises to gain."""

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
        self.left_out = without
        """Effects that are not searched for."""
        self.doubted: frozenset[tuple[str, str]] = frozenset()
        """Effects, with their stations, that are not tried because they imitate something unknown."""
        self.report = progress or (lambda text, share: None)
        data = comparison.data
        groups = [int(data.group[m[0]]) for m in comparison.members]
        bank = list(candidates(data.stations, data.calibration, groups, without))
        self.report('templates of the registry', 0.0)
        templates = self.workers.map(self._shown, bank)
        self.bank = [candidate for candidate, template in zip(bank, templates, strict=True) if template is not None]
        shown = [template for template in templates if template is not None]
        self.templates = np.array(shown, np.float32).reshape(len(shown), len(comparison.residual))
        self.untested = sorted({c.effect for c in bank} - {c.effect for c in self.bank})
        self._places = collections.Counter(c.key for c in self.bank)
        comparison.sines(SCAN.peaks)  # kept: processes that scan share it

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
            for effect, recipe in recipes(self.left_out)
            if recipe.scan
        )
        return sum(self._places.values()) + sum(scanned)

    def _scanned(self, residual: np.ndarray, only: str = '', least: float = 0.0) -> list[Candidate]:
        """Return the starting points that scanners find in the remainder, of `only` one effect, see `_promising`."""
        rest = Rest(self.comparison, residual, self.comparison.distances(self._place.effects), least)
        stations, receivers = self.comparison.data.stations, self.comparison.receivers
        wave = SPEED_OF_LIGHT / self.comparison.data.sweeps[0][0].center_frequency
        wanted = [
            (effect, recipe, station)
            for effect, recipe in recipes(self.left_out)
            if recipe.scan and only in ('', effect)
            for station in at_stations(effect, recipe, stations)
        ]

        def begun(one: tuple[str, Recipe, str]) -> list[Candidate]:
            effect, recipe, station = one
            number = receivers.index(station) if station in receivers else -1
            candidates = []
            for point in starting_points(rest, recipe, number):
                candidate = Candidate(effect, station, recipe.at(wave), dict(recipe.start) | point)
                low, high = self.bounds(candidate, recipe.scanned)
                within = {recipe.scanned: min(max(candidate.values[recipe.scanned], low), high)}
                candidates.append(dataclasses.replace(candidate, values=candidate.values | within))
            return [candidate for n, candidate in enumerate(candidates) if candidate not in candidates[:n]]

        return list(itertools.chain.from_iterable(self.workers.map(begun, wanted)))

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

    def most_by_one(self, fitted: Fitted | None, whitening: Whitening, rest: np.ndarray, scanned: bool = True) -> float:
        """Return the most that one effect more, as it begins, explains of what an explanation leaves.

        Args:
            fitted: the explanation, None for none.
            whitening: of numbers.
            rest: what it leaves, whitened (n,).
            scanned: count effects too that scanners find.
        """
        templates = whitening(self.templates_beside(fitted, scanned))
        power = np.einsum('mj,mj->m', templates, templates)
        return float(np.max((templates @ rest) ** 2 / np.maximum(power, 1e-12), initial=0.0))

    def give_up(self, effect: FittedEffect) -> None:
        """Do not try an effect again, nor others that add the same."""
        self.doubted |= {effect.key} | self.alike(effect)

    def alike(self, effect: FittedEffect) -> set[tuple[str, str]]:
        """Return which effects of the bank add the same as one does."""
        own = self.whitening.weight * self._template([effect.build()])
        along = self.templates @ (self.whitening.weight * own).astype(np.float32)
        length = np.linalg.norm(self.templates * self.whitening.weight.astype(np.float32), axis=1)
        alike = np.abs(along) > SEARCH.same_shape * np.maximum(length * float(np.linalg.norm(own)), SEARCH.nothing)
        return {self.bank[i].key for i in np.flatnonzero(alike)}

    def _unit(self, candidate: Candidate, values: dict | None = None) -> np.ndarray:
        """Return the template of a candidate; templates are kept."""
        return self._units([(candidate, values or candidate.values)])[0]

    def _units(self, wanted: Sequence[tuple[Candidate, dict[str, float]]]) -> list[np.ndarray]:
        """Return the templates of candidates with values of their parameters."""

        def simulated(key: tuple) -> np.ndarray:
            candidate, values = missing[key]
            return self._template([candidate.build(values)]).astype(np.float32)

        def named(c: Candidate, values: dict[str, float]) -> tuple:
            around = self._around([c.build(values)]).effects
            return c.effect, c.station, tuple(sorted(values.items())), tuple(map(repr, around))

        keys = [named(c, values) for c, values in wanted]
        missing = {key: w for key, w in zip(keys, wanted, strict=True) if key not in self._kept}
        found = {key: self._kept[key] for key in keys if key in self._kept}
        found |= zip(missing, self.workers.map(simulated, list(missing)), strict=True)
        self._kept |= {key: found[key] for key in missing}
        for key in list(self._kept)[: max(len(self._kept) - SEARCH.kept, 0)]:
            del self._kept[key]
        return [found[key] for key in keys]

    def _promising(
        self,
        residual: np.ndarray,
        beside: Sequence[FittedEffect],
        freedom: Freedom | None,
        only: str = '',
        least: float = 0.0,
    ) -> list[tuple[float, Candidate, dict]]:
        """Return (promised gain, candidate, values) of all starting points, best first.

        The gain counts only what the present explanation cannot follow by a change of its own parameters.

        Args:
            residual: what is left to explain.
            beside: effects of the present explanation.
            freedom: of the present explanation.
            only: effect that is tried, '' for all.
            least: gain below which no starting point is wanted; scanners may leave it out.
        """
        found = self._scanned(self.without_set_aside(residual), only, least)
        scanned = [c for c in found if self._is_other(c, c.values, beside)]
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
        scaled = [self._scaled(chosen[i], float(overlap[i]), float(power[i]), residual, freedom) for i in strong]
        return sorted(scaled, key=lambda item: -item[0])

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

    def freedom_beside(self, slopes: np.ndarray, *own: slice) -> Freedom | None:
        """Return the freedom of all effects but some, or of all; None without others.

        Args:
            slopes: of the parameters of all, see `slopes`.
            own: where those of each left out stand.
        """
        others = np.delete(slopes, np.r_[own], axis=0) if own else slopes
        return Freedom(self.whitening(others)) if len(others) else None


def _in_quadrature(candidate: Candidate) -> dict[str, float]:
    """Return the values of a candidate's parameters with its phase a quarter of a turn on."""
    turn, quarter = candidate.recipe.quadrature
    return candidate.values | {turn: candidate.values.get(turn, 0.0) + quarter}
