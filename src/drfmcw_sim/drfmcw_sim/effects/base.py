"""What an effect is: declared parameters, and hooks that act on delay, amplitude, clocks, phase and samples."""

import dataclasses
import functools
import sys
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from drfmcw_physics.settings import ConfigurationError, from_mapping, nearest
from drfmcw_physics.sweep import SweepSettings

from ..measurements import Measurements, Station
from .recipe import Recipe
from .traits import ActsOn, Motion, Of, Stage, Stated


@dataclasses.dataclass(frozen=True)
class Effect:
    """Base of all effects; a subclass gives its registered name: ``class Echo(Effect, name='echo')``.

    The docstring says what the effect is, `formula` what it does; the catalogue is made from both. An effect without
    recipes is simulated but not searched for.
    """

    registry: ClassVar[dict[str, type['Effect']]] = {}
    name: ClassVar[str] = ''
    of: ClassVar[Of] = Of.PATH
    title: ClassVar[str] = ''  # in a finding; '' for the name with spaces
    headline: ClassVar[str] = ''  # in a finding, one sentence; '' for the first line of the module's docstring
    acts_on: ClassVar[ActsOn] = ActsOn(0)
    stage: ClassVar[Stage] = Stage.STATE
    motion: ClassVar[Motion] = Motion.NONE
    shapes_chirp: ClassVar[bool] = False  # chirp_phase is not zero
    distorts: ClassVar[bool] = False  # not linear in the IF, so that harmonics arise
    bursts: ClassVar[bool] = False  # comes and goes, so that only many sweeps show it
    fluctuates: ClassVar[bool] = False  # has a phase of its own in each sweep: see `in_one_sweep`
    movable: ClassVar[bool] = False  # of the path, but a station's hardware may cause it as well
    evidence: ClassVar[str] = ''  # in the samples of a station that hears itself: see drfmcw_diagnosis.scene
    of_hardware: ClassVar[bool] = False  # of the path, but of its stations' hardware alone, whatever the site
    error_of: ClassVar[Stated | None] = None  # what it is the error of, by its one parameter
    formula: ClassVar[str] = ''  # one line
    example: ClassVar[dict[str, float | list[float]]] = {}  # parameters of a typical size
    recipes: ClassVar[tuple[Recipe, ...]] = ()  # how to search for it, one for each set of its parameters

    station: str = dataclasses.field(default='', kw_only=True)

    def __init_subclass__(cls, name: str = '', of: Of = Of.PATH, registered: bool = True, **kwargs: Any) -> None:
        """Register the effect under its name, unless it is none of physics."""
        super().__init_subclass__(**kwargs)
        cls.name, cls.of = name, of
        cls.title = cls.title or name.replace('_', ' ')
        cls.headline = cls.headline or str(sys.modules[cls.__module__].__doc__).strip().partition('\n')[0]
        if registered:
            Effect.registry[name] = cls

    @classmethod
    @functools.cache
    def list_parameters(cls) -> frozenset[str]:
        """Return the names of the parameters that hold a list, for example one value for each distance."""
        return frozenset(name for name, kind in typing.get_type_hints(cls).items() if kind == list[float])

    @property
    def memory(self) -> float:
        """Time constant [s] with which its answer to the begin of a signal fades; 0 for none.

        A real one may have settled before the first sample, which the simulated one has not.
        """
        return 0.0

    def applies_to(self, station: str) -> bool:
        """Return True where the effect acts at `station`; without a station it acts at every one."""
        return not self.station or self.station == station

    def own_stations(self, m: Measurements) -> list[Station]:
        """Return the stations of the pair at which the effect acts."""
        return [s for s in m.stations if self.applies_to(s.name)]

    def in_one_sweep(self, turn: float) -> 'Effect':
        """Return an effect that does in every sweep what this one does in a sweep of random phase `turn` [0..1].

        Without a random phase it is the effect itself.
        """
        return self

    def in_each_sweep(self) -> tuple['Effect', float]:
        """Return an effect that does in every sweep what this one does in some, and the share of these [0..1]."""
        return self, 1.0

    def prepare(self, m: Measurements) -> None:
        """Change clocks, delays, paths, powers or noise of the measurements, in place."""

    def draw(self, station: Station, streams: Callable[[], list[np.random.Generator]]) -> None:
        """Change the state of one station by random numbers, which differ from sweep to sweep, in place.

        Args:
            station: at which the effect acts.
            streams: as for `receive`; an effect that draws here draws nothing there.
        """

    def chirp_phase(self, station: Station, u: np.ndarray) -> np.ndarray | float:
        """Return what the effect adds to the transmit phase of `station` [rad].

        Args:
            station: whose chirp it is.
            u: true time since its sweep start, [n, samples] [s]; may lie outside the ramp.
        """
        return 0.0

    @classmethod
    def imitating(cls, phase: np.ndarray, sweep: SweepSettings, count: int) -> list[float]:
        """Return `count` coefficients with which the effect shapes a chirp as a phase does, apart from a straight line.

        Only effects whose recipe has `coefficients` can.

        Args:
            phase: added to the transmit phase at equal steps from the ramp's start to its end (n,) [rad].
            sweep: that is shaped.
            count: of coefficients.
        """
        raise NotImplementedError(f'{cls.name} has no coefficients')

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Change the analogue IF of `station` before it is quantised, in place.

        Args:
            signal: float32 [n, samples], or [n, samples, 2] (I, Q) [LSB].
            station: receiver.
            m: the measurements.
            streams: returns one random generator per sweep, independent of all others.
        """

    def random_power(self, station: Station, m: Measurements, frequency: np.ndarray) -> np.ndarray | float:
        """Return the mean density of power of random phase that the effect adds to the IF [n, B] [LSB^2/Hz].

        Sweeps that are simulated free of noise do not hold it.

        Args:
            station: that receives.
            m: n measurements, prepared.
            frequency: in the IF (B,) [Hz].
        """
        return 0.0

    def reference_error(
        self,
        time: np.ndarray | float,
        distance: np.ndarray | float,
        distance_at: Callable[[np.ndarray | float], np.ndarray | float],
    ) -> np.ndarray | float:
        """Return the error that the effect causes in the reading of the reference instrument [m].

        Args:
            time: of the reading, since the scenario's start [s].
            distance: the true one at that time [m].
            distance_at: returns the distance [m] at other times [s].
        """
        return 0.0


def effect_from_mapping(mapping: Mapping[str, Any], where: str, stations: list[str]) -> Effect:
    """Build an effect from one entry of a scenario's `effects`.

    Args:
        mapping: `effect` names it; the other keys are its parameters.
        where: file and section, for messages.
        stations: names of the scenario's stations.

    Raises:
        ConfigurationError: unknown effect, parameter or station, wrong value.
    """
    if not isinstance(mapping, Mapping) or 'effect' not in mapping:
        raise ConfigurationError(f"{where}: expected a mapping with key 'effect', not {mapping!r}")
    name = mapping['effect']
    if name not in Effect.registry:
        raise ConfigurationError(f"{where}: unknown effect '{name}'{nearest(name, sorted(Effect.registry))}")
    lists = Effect.registry[name].list_parameters()
    values = {k: v for k, v in mapping.items() if k != 'effect'}
    for key, value in values.items():  # a single number stands for a list of one
        if key in lists and (isinstance(value, str) or not isinstance(value, Sequence)):
            values[key] = [value]
    effect = from_mapping(Effect.registry[name], values, f'{where}: {name}')
    if effect.station and effect.station not in stations:
        raise ConfigurationError(
            f"{where}: {name}: unknown station '{effect.station}'{nearest(effect.station, stations)}"
        )
    if effect.station and effect.of is not Of.STATION:
        raise ConfigurationError(f'{where}: {name} belongs to the {effect.of}, it has no station')
    return effect
