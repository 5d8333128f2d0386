"""Velocity of a pair from sweep to sweep, and what it does to the range.

A crane that moves at v shifts both lines by the Doppler frequency: the range comes out f_c T_sw / B_sw v too long
(38.67 mm per m/s with Table 1 of the paper, which leaves it out). The sum of both stations' carrier phases repeats
every half wavelength (25.84 mm) and follows the movement to hundredths of a millimetre, so two sweeps give the velocity,
up to a whole number of half wavelengths between them. That number is taken from the movement before (a standing crane at
the start), and checked against the ranges: where it is wrong, ranges and phases drift apart by whole half wavelengths
per sweep.
"""

import collections
import dataclasses
import math

import numpy as np
from drfmcw_physics.constants import SPEED_OF_LIGHT

from .combination import PathDelay

_TRACK_LENGTH = 24  # sweeps over which ranges and phases are compared
_FIT_LENGTH = 6  # sweeps over which the velocity is fitted to the phases
_FIT_DURATION = 0.6  # and for how long at most [s]
_RANGE_FIT_DURATION = 5.0  # for how long at most it is fitted to the ranges, where the phases cannot be followed [s]
_RANGE_FIT_MINIMUM = 6  # sweeps that takes
_LARGEST_PHASE_STEP = 0.4  # of a half wavelength: an acceleration that moves more between two sweeps cannot be followed
_LONGEST_PAUSE = 1.0  # after which the crane counts as standing again until shown otherwise [s]
_DECISION = 6.0  # a drift must be known this much better than the half wavelength it is rounded to


@dataclasses.dataclass(frozen=True)
class Motion:
    """Velocity at one sweep's start; NaN where it is not known."""

    velocity: float  # range rate [m/s]
    velocity_std: float  # [m/s]


STANDING = Motion(0.0, 0.0)
UNKNOWN = Motion(math.nan, math.nan)


def doppler_range_rate(path: PathDelay, chirp_rate: float) -> float:
    """Return by how much the measured range exceeds that at the sweep's start, per velocity [m per m/s].

    The line is shifted by the Doppler frequency at the window's centre, f_c v / c, which reads as f_c v / k of range;
    and the crane has moved by v t_c until then.
    """
    return path.center_frequency / chirp_rate + path.center_time


@dataclasses.dataclass
class _Point:
    """One sweep of a track."""

    stamp: int  # [ns]
    moved: float  # displacement since the track began, by the phase [m]; NaN where the phases could not be followed
    range: float  # with the Doppler shift still in it [m]
    std: float  # of the range [m]


class VelocityTracker:
    """Follows one pair's movement by its carrier phase, or by its ranges where sweeps are too far apart for that."""

    def __init__(self, maximum_acceleration: float) -> None:
        """Start with nothing known; `maximum_acceleration` in m/s^2."""
        self._maximum_acceleration = maximum_acceleration
        self._track: collections.deque[_Point] = collections.deque(maxlen=_TRACK_LENGTH)
        self._phase = math.nan
        self._velocity = math.nan
        self._stamp = 0

    def restart(self) -> None:
        """Begin a new track (the settings changed); the velocity is carried over a short pause."""
        self._track.clear()

    def coast(self, stamp: int) -> Motion:
        """Return the velocity at `stamp` [ns] as the last sweeps had it, without taking in a new one."""
        pause = (stamp - self._stamp) * 1e-9
        if not math.isfinite(self._velocity) or not 0.0 <= pause <= _LONGEST_PAUSE:
            return UNKNOWN
        return Motion(self._velocity, self._maximum_acceleration * pause / math.sqrt(3.0))

    def update(self, stamp: int, path: PathDelay, measured_range: float, range_std: float, refractive_index: float) -> Motion:
        """Take in one sweep and return the velocity at its start.

        Args:
            stamp: of station 1's sweep start [ns].
            path: the sweep's combined delay and carrier phase.
            measured_range: with the Doppler shift still in it [m].
            range_std: its standard deviation [m].
            refractive_index: of the air [1].
        """
        half_wave = SPEED_OF_LIGHT / refractive_index / path.center_frequency / 2.0
        step_time = (stamp - self._track[-1].stamp) * 1e-9 if self._track else math.inf
        pause = (stamp - self._stamp) * 1e-9
        if step_time <= 0.0 or pause > _RANGE_FIT_DURATION:
            self._track.clear()
        if not 0.0 <= pause <= _LONGEST_PAUSE and not self._track:
            self._velocity = math.nan
        motion = self.coast(stamp)
        moved = 0.0
        if self._track:
            moved = self._track[-1].moved + self._phase_step(path.carrier_phase, step_time, half_wave)
        self._track.append(_Point(stamp, moved, measured_range, range_std))
        self._phase = path.carrier_phase
        self._stamp = stamp
        if len(self._track) > 1:
            if math.isfinite(moved):
                self._correct_ambiguity(half_wave)
                motion = self._fit_phases()
            else:
                motion = self._fit_ranges()
        self._velocity = motion.velocity
        return motion

    def _phase_step(self, phase: float, step_time: float, half_wave: float) -> float:
        """Return the displacement since the last sweep [m], NaN where it cannot be told from the phases."""
        if self._maximum_acceleration * step_time**2 > _LARGEST_PHASE_STEP * half_wave:
            return math.nan
        turns = (phase - self._phase) / (2.0 * math.pi)
        if not math.isfinite(turns):
            return math.nan
        velocity = self._velocity if math.isfinite(self._velocity) else 0.0
        return (turns + round(velocity * step_time / half_wave - turns)) * half_wave

    def _correct_ambiguity(self, half_wave: float) -> None:
        """Shift the track by whole half wavelengths per sweep where the ranges drift away from the phases."""
        n = len(self._track)
        index = np.arange(n) - (n - 1) / 2.0
        spread = float(index @ index)
        variance = sum(p.std**2 for p in self._track) / n
        if math.sqrt(variance / spread) * _DECISION > half_wave:
            return
        drift = np.array([p.range - p.moved for p in self._track])
        turns = round(float(index @ drift) / spread / half_wave)
        if turns:
            for i, point in enumerate(self._track):
                point.moved += turns * half_wave * i

    def _fit_phases(self) -> Motion:
        """Return the velocity at the newest sweep from its displacements: a parabola, a line through few."""
        newest = self._track[-1]
        recent = [p for p in list(self._track)[-_FIT_LENGTH:] if (newest.stamp - p.stamp) * 1e-9 <= _FIT_DURATION]
        times = np.array([(p.stamp - newest.stamp) * 1e-9 for p in recent])
        return _slope_at_end(times, np.array([p.moved - newest.moved for p in recent]), 2 if len(recent) > 4 else 1)

    def _fit_ranges(self) -> Motion:
        """Return the velocity at the newest sweep from its ranges; unknown where it would add noise to the range."""
        newest = self._track[-1]
        recent = [p for p in self._track if (newest.stamp - p.stamp) * 1e-9 <= _RANGE_FIT_DURATION]
        if len(recent) < _RANGE_FIT_MINIMUM:
            return UNKNOWN
        times = np.array([(p.stamp - newest.stamp) * 1e-9 for p in recent])
        return _slope_at_end(times, np.array([p.range - newest.range for p in recent]), 2)


def _slope_at_end(times: np.ndarray, values: np.ndarray, degree: int) -> Motion:
    """Return the slope at time 0 of a polynomial through (times [s], values [m]) and its standard deviation."""
    if len(times) < 2:
        return UNKNOWN
    basis = np.vander(times, degree + 1, increasing=True)
    inverse = np.linalg.pinv(basis)
    coefficients = inverse @ values
    residual = values - basis @ coefficients
    freedom = len(times) - degree - 1
    noise = math.sqrt(float(residual @ residual) / freedom) if freedom > 0 else 0.0
    return Motion(float(coefficients[1]), noise * math.sqrt(float(inverse[1] @ inverse[1])))
