"""Where the search for effects begins: the grids of their recipes, at sizes small enough to be linear.

An effect declares its own recipes, see `drfmcw_sim.effects.recipe`; one without recipes is not searched for.
"""

import dataclasses
import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from drfmcw_physics.oscillators import Calibration
from drfmcw_sim.effects import Effect, Of, Recipe


def recipes(without: Collection[str] = ()) -> list[tuple[str, Recipe]]:
    """Return (effect, recipe) of all that is searched for, by name, `without` some effects."""
    return [(name, r) for name, cls in sorted(Effect.registry.items()) if name not in without for r in cls.recipes]


@dataclasses.dataclass(frozen=True)
class Candidate:
    """An effect at a station, with the parameters at which its fit begins."""

    effect: str
    station: str  # '' for what has none, or for both
    recipe: Recipe
    values: dict[str, float]
    held: bool = False  # its parameters stay as they are

    @property
    def key(self) -> tuple[str, str]:
        """What it is, apart from its size."""
        return self.effect, self.station

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that are fitted."""
        if self.held:
            return ()
        return tuple(self.values if self.recipe.per_group or self.recipe.coefficients else self.recipe.prior)

    @property
    def kind(self) -> type[Effect]:
        """The effect's class, which declares its traits."""
        return Effect.registry[self.effect]

    @property
    def acts(self) -> bool:
        """True where it distorts the IF or comes and goes: it acts on what the other effects make."""
        return self.kind.distorts or self.kind.bursts

    def prior(self, name: str) -> float:
        """Return the plausible size of a parameter that is fitted."""
        return self.recipe.prior[name.partition('[')[0]]

    def build(self, values: Mapping[str, float] | None = None) -> Effect:
        """Return the effect with `values`, by default those at which the fit begins."""
        return self.kind(**self.parameters(values or self.values), station=self.station)

    def parameters(self, values: Mapping[str, float]) -> dict[str, float | tuple[float, ...]]:
        """Return parameters as the registry takes them: those by group as one list, zero where a group has none."""
        single: dict[str, float | tuple[float, ...]] = {}
        several: dict[str, dict[int, float]] = {}
        for name, value in values.items():
            base, bracket, number = name.partition('[')
            if bracket:
                several.setdefault(base, {})[int(number.rstrip(']'))] = value
            else:
                single[base] = (value,) if base in self.kind.list_parameters() else value
        phase = self.recipe.carrier[0]
        if phase in values:
            single[phase] = self.reflected(values)
        return single | {b: tuple(found.get(g, 0.0) for g in range(max(found) + 1)) for b, found in several.items()}

    def reflected(self, values: Mapping[str, float]) -> float:
        """Return the phase of a reflector, from -pi to pi [rad]: what is fitted is its sum with the carrier's."""
        phase, length = self.recipe.carrier
        total = values[phase] - 2.0 * math.pi * values[length] / self.recipe.wavelength
        return math.remainder(total, 2.0 * math.pi)

    def moved(self, **changes: float) -> 'Candidate':
        """Return the candidate with other values to begin with."""
        return dataclasses.replace(self, values=self.values | changes)


def candidates(
    stations: tuple[str, ...],
    calibrated: Sequence[Calibration],
    groups: Sequence[int],
    without: Collection[str] = (),
) -> Iterator[Candidate]:
    """Yield the starting points that do not depend on the recording.

    Args:
        stations: names.
        calibrated: their oscillators, to which the starts of some recipes are relative.
        groups: numbers of those in which sizes may differ.
        without: effects that are left out.
    """
    for effect, recipe in recipes(without):
        if recipe.scan or recipe.coefficients or (recipe.per_group and len(groups) < 2):
            continue
        for station in at_stations(effect, recipe, stations):
            own = [c for c in calibrated if station in ('', c.station)]
            for values in itertools.product(*recipe.grid.values()):
                start = dict(recipe.start) | dict(zip(recipe.grid, values, strict=True))
                for name, field in recipe.added_to.items():
                    start[name] += float(np.mean([getattr(c, field) for c in own]))
                for name, field in recipe.times.items():
                    start[name] *= float(np.mean([getattr(c, field) for c in own]))
                if recipe.per_group:
                    start = {f'{recipe.size}[{g}]': start[recipe.size] for g in groups}
                yield Candidate(effect, station, recipe, start)


def of_coefficients(stations: tuple[str, ...], without: Collection[str] = ()) -> Iterator[Candidate]:
    """Yield effects that may take the place of several others, without effect where their fit begins.

    Args:
        stations: names.
        without: effects that are left out.
    """
    for effect, recipe in recipes(without):
        for station, count in itertools.product(at_stations(effect, recipe, stations), recipe.coefficients):
            values = {f'{name}[{i}]': value for name, value in recipe.start.items() for i in range(count)}
            yield Candidate(effect, station, recipe, values)


def at_stations(effect: str, recipe: Recipe, stations: tuple[str, ...]) -> list[str]:
    """Return the stations at which an effect is searched for; '' for none, or for both."""
    if Effect.registry[effect].of is not Of.STATION:
        return ['']
    return [*stations, *([''] if recipe.together else [])]
