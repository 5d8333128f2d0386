"""How the antenna distance of a pair changes: standing, driving between way-points, or as a recording has it."""

import dataclasses
import itertools
import math
from typing import overload

import numpy as np

from drfmcw_physics.settings import ConfigurationError, parameter
from drfmcw_physics.sweep import Mode


@dataclasses.dataclass(frozen=True)
class Standing:
    """Stands at each distance for a number of sweeps; the time between two distances is not simulated."""

    distances: list[float] = parameter(unit='m', bounds=(0.0, 1e6), description='antenna distances, one after another')
    sweeps: int = parameter(500, bounds=(1, 10**9), description='sweeps of this pair at each distance')
    move_time: float = parameter(10.0, unit='s', bounds=(0.0, 1e6), description='time from one distance to the next')

    def __post_init__(self) -> None:
        """Refuse an empty list."""
        if not self.distances:
            raise ConfigurationError('distances is empty')

    @property
    def sweep_count(self) -> int:
        """Sweeps of this pair until the last distance is done."""
        return self.sweeps * len(self.distances)

    def moves(self, index: np.ndarray) -> np.ndarray:
        """Return the time spent moving before the pair's sweep number `index` [s]."""
        return self.setting(index) * self.move_time

    def setting(self, index: np.ndarray) -> np.ndarray:
        """Return the number of the distance at which it stands at the pair's sweep number `index`."""
        return np.minimum(index // self.sweeps, len(self.distances) - 1)

    def state(self, index: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (distance [m], velocity [m/s], acceleration [m/s^2]) at the pair's sweeps `index`."""
        distance = np.asarray(self.distances)[self.setting(index)]
        return distance, np.zeros(len(distance)), np.zeros(len(distance))

    def step(self, index: int) -> float:
        """Return zero: it does not move at its distances."""
        return 0.0


@dataclasses.dataclass(frozen=True)
class Drive:
    """Drives from way-point to way-point with trapezoidal velocity."""

    waypoints: list[float] = parameter(unit='m', bounds=(0.0, 1e6), description='antenna distances at which it stops')
    speed: float = parameter(2.0, unit='m/s', bounds=(1e-3, 1e3), description='largest speed')
    acceleration: float = parameter(0.3, unit='m/s^2', bounds=(1e-3, 1e3), description='largest acceleration')
    dwell: float = parameter(5.0, unit='s', bounds=(0.0, 1e6), description='time standing at each way-point')

    def __post_init__(self) -> None:
        """Refuse a drive that goes nowhere."""
        if len(self.waypoints) < 2:
            raise ConfigurationError('waypoints needs at least two distances')

    def _phases(self) -> np.ndarray:
        """Return rows (start time, distance, velocity, acceleration) of the pieces of constant acceleration."""
        rows, time, at = [], 0.0, self.waypoints[0]
        rows.append((time, at, 0.0, 0.0))
        time += self.dwell
        for target in self.waypoints[1:]:
            way, sign = abs(target - at), math.copysign(1.0, target - at)
            peak = min(self.speed, math.sqrt(way * self.acceleration))
            ramp = peak / self.acceleration
            cruise = (way - peak * ramp) / peak if way else 0.0
            climb = 0.5 * peak * ramp
            rows.append((time, at, 0.0, sign * self.acceleration))
            rows.append((time + ramp, at + sign * climb, sign * peak, 0.0))
            rows.append((time + ramp + cruise, target - sign * climb, sign * peak, -sign * self.acceleration))
            time += 2.0 * ramp + cruise
            at = target
            rows.append((time, at, 0.0, 0.0))
            time += self.dwell
        return np.array(rows)

    @property
    def duration(self) -> float:
        """Time until the last way-point's dwell is over [s]."""
        return float(self._phases()[-1, 0] + self.dwell)

    def setting(self, index: np.ndarray) -> np.ndarray:
        """Return 0 for every sweep: a drive is one setting."""
        return np.zeros_like(index)

    def state(self, index: np.ndarray | None, time: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (distance [m], velocity [m/s], acceleration [m/s^2]) at `time` since the scenario's start [s].

        Before the start it stands at the first way-point.
        """
        phases = self._phases()
        time = np.maximum(time, 0.0)
        start, distance, velocity, acceleration = phases[np.searchsorted(phases[:, 0], time, side='right') - 1].T
        t = time - start
        return distance + velocity * t + 0.5 * acceleration * t * t, velocity + acceleration * t, acceleration.copy()


@dataclasses.dataclass(frozen=True)
class Recorded:
    """Stops of a recording: each sweep finds the crane standing, a little further than the one before where it moved.

    Its speed, which each sweep also sees, is an effect (`target_motion`).
    """

    distances: list[float] = parameter(
        unit='m', bounds=(0.0, 1e6), description='antenna distance at the first sweep of each stop'
    )
    steps: list[float] = parameter(
        unit='m', bounds=(-1e3, 1e3), description='growth of the distance from one sweep to the next, of each stop'
    )
    sweeps: list[int] = parameter(bounds=(1, 10**9), description='sweeps of this pair at each stop')
    pauses: list[float] = parameter(
        unit='s', bounds=(0.0, 1e9), description='time before each stop beyond the interval of the sweeps'
    )
    modes: list[int] = parameter(bounds=(0, 1), description='of each stop: 0 short distance, 1 long distance')
    start_delays: list[float] = parameter(unit='s', bounds=(0.0, 1.0), description='T_off of each stop')

    def __post_init__(self) -> None:
        """Refuse lists that do not belong together."""
        counts = {field.name: len(getattr(self, field.name)) for field in dataclasses.fields(self)}
        if len(set(counts.values())) > 1 or not self.distances:
            raise ConfigurationError(f'needs lists of one length, not {counts}')

    @property
    def sweep_count(self) -> int:
        """Sweeps of this pair until the last stop is done."""
        return sum(self.sweeps)

    def moves(self, index: np.ndarray) -> np.ndarray:
        """Return the time spent between stops before the pair's sweep number `index` [s]."""
        return np.cumsum(self.pauses)[self.setting(index)]

    def setting(self, index: np.ndarray) -> np.ndarray:
        """Return the number of the stop to which the pair's sweep number `index` belongs."""
        return np.minimum(np.searchsorted(np.cumsum(self.sweeps), index, side='right'), len(self.sweeps) - 1)

    def state(self, index: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (distance [m], velocity [m/s], acceleration [m/s^2]) at the pair's sweeps `index`."""
        stop = self.setting(index)
        first = np.cumsum(self.sweeps) - self.sweeps
        distance = np.asarray(self.distances)[stop] + np.asarray(self.steps)[stop] * (index - first[stop])
        return distance, np.zeros(len(distance)), np.zeros(len(distance))

    def step(self, index: int) -> float:
        """Return the growth of the distance per sweep at the pair's sweep number `index` [m]."""
        return self.steps[int(self.setting(np.array([index]))[0])]

    def mode(self, index: int) -> tuple[Mode, float]:
        """Return (mode, T_off [s]) of the pair's sweep number `index`."""
        stop = int(self.setting(np.array([index]))[0])
        return Mode(self.modes[stop]), self.start_delays[stop]


@dataclasses.dataclass(frozen=True)
class Profile:
    """A quantity over scenario time: constant, or interpolated linearly between given times."""

    values: list[float] = parameter(description='values at the times')
    times: list[float] = parameter([0.0], unit='s', bounds=(0.0, 1e9), description='times of the values, rising')

    def __post_init__(self) -> None:
        """Refuse lists that do not belong together."""
        if len(self.values) != len(self.times) or not self.values:
            raise ConfigurationError(f'{len(self.values)} values for {len(self.times)} times')
        if any(b <= a for a, b in itertools.pairwise(self.times)):
            raise ConfigurationError('times do not rise')

    def __str__(self) -> str:
        """Return a constant as its number."""
        return f'{self.values[0]:g}' if len(self.values) == 1 else f'{self.values} at {self.times} s'

    @overload
    def at(self, time: float) -> float: ...

    @overload
    def at(self, time: np.ndarray) -> np.ndarray: ...

    def at(self, time: np.ndarray | float) -> np.ndarray | float:
        """Return the quantity at `time` [s]; before the first and after the last time it is constant."""
        return np.interp(time, self.times, self.values)
