"""Where the search for effects begins: sizes small enough to be linear, and grids over what gives an effect its shape.

The forward models are the registry's; here stands only how to look for each. `prior` is how large a parameter may
plausibly be: it decides how much evidence a good fit must bring to pay for its freedom.
"""

import dataclasses
import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from drfmcw_physics.oscillators import Calibration
from drfmcw_sim.effects import Effect

WAVE = 0.0517
"""Wavelength of the carrier, by which an echo's phase turns [m]: of Table 1, see `Recipe.at`."""

_SAME_WAVE = 0.01  # part by which a wavelength may differ from it


@dataclasses.dataclass(frozen=True)
class Recipe:
    """How to look for one effect."""

    size: str  # parameter that scales what it does; '' where nothing does linearly
    start: Mapping[str, float]  # of parameters without a grid
    prior: Mapping[str, float]  # plausible size of every parameter that is fitted
    grid: Mapping[str, tuple[float, ...]] = dataclasses.field(default_factory=dict)
    defining: tuple[str, ...] = ()  # parameters that make it another effect where they are zero
    scanned: str = ''  # parameter whose places the data show, see `places`
    decibel: bool = False  # the size is in decibels
    quadrature: tuple[str, float] = ('', 0.0)  # parameter, and its step, that turns the effect's phase by a quarter
    turn: tuple[str, float] = ('', 0.0)  # parameter, and its period by the carrier's phase, which reflection may shift
    fringes: bool = False  # it raises and lowers the received power with the distance
    per_group: bool = False  # the size differs from group to group: parameters size[0], size[1], ...
    repeats: bool = False  # several of them may be there, each at a place of its own: see `places.cell`
    stations: str = 'each'  # 'each', 'each and both'; ignored where the effect has no station
    trust: Mapping[str, float] = dataclasses.field(default_factory=dict)  # to which the model tells it: dB, or a share
    steps: Mapping[str, float] = dataclasses.field(default_factory=dict)  # of numerical derivatives, where not 1 %

    def at(self, wavelength: float) -> 'Recipe':
        """Return the recipe for another wavelength of the carrier [m]."""
        ratio = wavelength / WAVE
        if not self.turn[0] or abs(ratio - 1.0) < _SAME_WAVE:
            return self
        scaled = {name: (getattr(self, name)[0], getattr(self, name)[1] * ratio) for name in ('quadrature', 'turn')}
        return dataclasses.replace(self, **scaled)

    def step(self, name: str, value: float) -> float:
        """Return the step of a numerical derivative at `value`."""
        name = name.partition('[')[0]
        if name in self.steps:
            return self.steps[name]
        return max(0.01 * abs(value), 0.01 * abs(self.start.get(name, 1e-3 * self.prior[name])))


def _steps(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(np.geomspace(low, high, count).tolist())


RECIPES: dict[str, tuple[Recipe, ...]] = {
    'reference_clock_offset': (Recipe('deviation', {'deviation': 0.2}, {'deviation': 20.0}),),
    'reference_clock_temperature': (Recipe('slope', {'slope': 0.02}, {'slope': 1.0}),),
    'reference_clock_drift': (
        Recipe('rate', {'rate': 1.0}, {'rate': 50.0}),
        Recipe('warmup', {'warmup': 0.2}, {'warmup': 10.0, 'time_constant': 300.0},
               {'time_constant': (10.0, 30.0, 100.0, 300.0)}),
    ),
    'sample_clock_offset': (Recipe('deviation', {'deviation': 0.2}, {'deviation': 50.0}),),
    'air_refractivity': (Recipe('offset', {'offset': 1.0}, {'offset': 100.0}),),
    'delay_offset': (Recipe('delay', {'delay': 0.01}, {'delay': 10.0}),),
    'delay_temperature': (Recipe('slope', {'slope': 0.5}, {'slope': 50.0}),),
    'ground_reflection': (
        Recipe('coefficient', {'coefficient': 0.02}, {'coefficient': 0.5, 'height_product': 100.0},
               scanned='height_product', defining=('height_product',), steps={'height_product': 0.003}, fringes=True),
    ),
    'echo': (
        Recipe('relative_power', {'relative_power': -50.0}, {'relative_power': 20.0, 'excess_range': 100.0},
               scanned='excess_range', decibel=True, quadrature=('excess_range', WAVE / 4.0),
               steps={'excess_range': 5e-4, 'relative_power': 0.05}, turn=('excess_range', WAVE),
               fringes=True, repeats=True),
    ),
    'tx_leakage': (Recipe('level', {'level': -70.0}, {'level': 20.0}, decibel=True, steps={'level': 0.05}),),
    'spur': (
        Recipe('level', {'level': -80.0}, {'level': 20.0, 'frequency': 5e5}, scanned='frequency', decibel=True,
               steps={'frequency': 20.0, 'level': 0.05}, repeats=True),
    ),
    'sweep_curvature': (Recipe('deviation', {'deviation': 50.0}, {'deviation': 1e4}),),
    'sweep_ripple': (
        Recipe('deviation', {'deviation': 20.0}, {'deviation': 2e3, 'rate': 5e4, 'phase': 3.0},
               scanned='rate', quadrature=('phase', np.pi / 2.0),
               steps={'rate': 5.0, 'phase': 0.01}, repeats=True),
    ),
    'pll_settling': (
        Recipe('step', {'step': 500.0}, {'step': 1e5, 'natural_frequency': 5e4, 'damping': 1.0},
               {'natural_frequency': _steps(2e3, 6e4, 12), 'damping': (0.15, 0.35, 0.7)}, defining=('damping',)),
    ),
    'phase_noise': (
        Recipe('', {}, {'level': 5.0, 'corner': 1e5}, {'level': (-2.0, -0.5, 0.5, 2.0), 'corner': (0.5, 1.0, 2.0)},
               stations='each and both', steps={'level': 0.1, 'corner': 2e3}, trust={'level': 0.15, 'corner': 0.03}),
    ),
    'noise_floor': (
        Recipe('', {}, {'excess': 10.0}, {'excess': (-1.0, 1.0, 6.0)}, stations='each and both',
               steps={'excess': 0.05}),
    ),
    'amplitude_loss': (
        Recipe('loss', {'loss': 0.2}, {'loss': 10.0}),
        Recipe('specific', {'specific': 0.3}, {'specific': 20.0}),
    ),
    'target_motion': (
        Recipe('velocity', {'velocity': 0.001}, {'velocity': 3.0}),
        Recipe('velocity', {'velocity': 0.001}, {'velocity': 3.0}, per_group=True),
    ),
    'sway': (
        Recipe('amplitude', {'amplitude': 1e-4}, {'amplitude': 0.05, 'frequency': 2.0, 'phase': 3.0},
               scanned='frequency', quadrature=('phase', np.pi / 2.0), steps={'frequency': 1e-5, 'phase': 0.01}),
    ),
    'slant_geometry': (Recipe('', {}, {'height_difference': 20.0}, {'height_difference': (0.5, 1.0, 2.0, 5.0, 10.0)}),),
    'clipping': (
        Recipe('', {}, {'level': 20.0}, scanned='level', steps={'level': 0.1}, trust={'level': 0.05}),
    ),
    'compression': (
        Recipe('', {}, {'third_order': 0.3}, scanned='third_order', steps={'third_order': 0.005}),
    ),
    'if_filter': (Recipe('', {}, {'pole': 2e6}, {'pole': _steps(3e5, 2e7, 8)}),),
    'interference_burst': (
        Recipe('', {'level': -50.0, 'duration': 5e-5}, {'probability': 0.5, 'level': 20.0, 'duration': 1e-4},
               scanned='probability', steps={'probability': 0.05, 'level': 0.5, 'duration': 1e-5},
               trust={'probability': 0.15, 'level': 1.0, 'duration': 0.25}),
    ),
    'reference_lag': (Recipe('lag', {'lag': 0.01}, {'lag': 2.0}),),
    'reference_offset': (Recipe('offset', {'offset': 1e-3}, {'offset': 0.5}),),
    'reference_scale': (Recipe('scale', {'scale': 2.0}, {'scale': 200.0}),),
}  # fmt: skip
"""By effect; effects without a recipe are not searched for, which a diagnosis says."""


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One place in the bank: an effect at a station, with the parameters at which its fit begins."""

    effect: str
    station: str  # '' for what has none, or for both
    recipe: Recipe
    values: dict[str, float]

    @property
    def key(self) -> tuple[str, str]:
        """What it is, apart from its size."""
        return self.effect, self.station

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that are fitted."""
        return tuple(self.values) if self.recipe.per_group else tuple(self.recipe.prior)

    def prior(self, name: str) -> float:
        """Return the plausible size of a parameter that is fitted."""
        return self.recipe.prior[name.partition('[')[0]]

    def build(self, values: Mapping[str, float] | None = None) -> Effect:
        """Return the effect with `values`, by default those at which the fit begins."""
        return Effect.registry[self.effect](**self.parameters(values or self.values), station=self.station)

    def parameters(self, values: Mapping[str, float]) -> dict[str, float | tuple[float, ...]]:
        """Return parameters as the registry takes them: those by group as one list, zero where a group has none."""
        single, several = {}, {}
        for name, value in values.items():
            base, bracket, number = name.partition('[')
            if bracket:
                several.setdefault(base, {})[int(number.rstrip(']'))] = value
            elif base == 'velocity':
                single[base] = (value,)
            else:
                single[base] = value
        return single | {b: tuple(found.get(g, 0.0) for g in range(max(found) + 1)) for b, found in several.items()}

    def moved(self, **changes: float) -> 'Candidate':
        """Return the candidate with other values to begin with."""
        return dataclasses.replace(self, values=self.values | changes)


def candidates(
    stations: tuple[str, ...],
    calibrated: Sequence[Calibration],
    groups: Sequence[int],
    without: Collection[str] = (),
) -> Iterator[Candidate]:
    """Yield the places of the bank that do not depend on the recording.

    Args:
        stations: names.
        calibrated: what the stations' oscillators are like: the grid of phase noise is relative to it.
        groups: numbers of those in which sizes may differ.
        without: effects that are left out.
    """
    for effect, recipes in RECIPES.items():
        for recipe in recipes:
            if effect in without or recipe.scanned or (recipe.per_group and len(groups) < 2):
                continue
            for station in at_stations(effect, recipe, stations):
                for values in itertools.product(*recipe.grid.values()):
                    start = dict(recipe.start) | dict(zip(recipe.grid, values, strict=True))
                    if effect == 'phase_noise':
                        own = [c for c in calibrated if station in ('', c.station)]
                        start['level'] += float(np.mean([c.phase_noise_level for c in own]))
                        start['corner'] *= float(np.mean([c.phase_noise_corner for c in own]))
                    if recipe.per_group:
                        start = {f'{recipe.size}[{g}]': start[recipe.size] for g in groups}
                    yield Candidate(effect, station, recipe, start)


def at_stations(effect: str, recipe: Recipe, stations: tuple[str, ...]) -> list[str]:
    """Return the stations at which an effect is looked for; '' for none, or for both."""
    if Effect.registry[effect].of != 'station':
        return ['']
    return [*stations, *([''] if recipe.stations == 'each and both' else [])]
