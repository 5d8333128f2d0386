"""Velocity of a pair from sweep to sweep, and what it does to the range.

A crane that moves at v shifts both lines by the Doppler frequency: the range comes out f_c T_sw / B_sw v too long
(38.67 mm per m/s with Table 1 of the paper, which leaves it out). The sum of both stations' carrier phases repeats
every half wavelength (25.84 mm) and follows the movement to hundredths of a millimetre, so two sweeps give the
velocity, up to a whole number of half wavelengths between them. That number is taken from the movement before (a
standing crane at the start), and checked against the ranges: where it is wrong, ranges and phases drift apart by whole
half wavelengths per sweep.
"""

import collections
import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

from drfmcw_physics.constants import SPEED_OF_LIGHT

from .combination import PathDelay

_TRACK_LENGTH = 24  # sweeps over which ranges and phases are compared
_FIT_LENGTH = 5  # sweeps over which the velocity is fitted to the phases
_FIT_DURATION = 0.8  # and for how long at most [s]
_RANGE_FIT_DURATION = 5.0  # for how long at most it is fitted to the ranges, where the phases cannot be followed [s]
_RANGE_FIT_MINIMUM = 6  # sweeps that takes
_RANGE_FIT_LAG = 0.4  # largest error of a parabola's slope at its end, in acceleration times duration (computed)
_LARGEST_PHASE_STEP = 0.4  # of a half wavelength: an acceleration that moves more between two sweeps cannot be followed
_LONGEST_PAUSE = 1.0  # after which the crane counts as standing again until shown otherwise [s]
_SHORTEST_COMPARISON = 3  # sweeps; fewer cannot distinguish a drift from an outlier
MEMORY = (_TRACK_LENGTH, _RANGE_FIT_DURATION)
"""Sweeps, and seconds, after which the velocity does not depend on when the track began, but for rounding."""
_DECISION = 10.0  # a drift must be known this much better than the half wavelength it is rounded to


@dataclasses.dataclass(frozen=True)
class Motion:
    """Velocity at one sweep's start; NaN where it is not known."""

    velocity: float  # range rate [m/s]
    velocity_std: float  # [m/s]
    confirmed: bool = True  # False while it rests on the crane having stood still before


STANDING = Motion(math.nan, 0.0)  # nothing to correct, nothing estimated
UNKNOWN = Motion(math.nan, math.nan, confirmed=False)


def doppler_range_rate(center_frequency: float, chirp_rate: float, center_time: float) -> float:
    """Return by how much the measured range exceeds that at the sweep's start, per velocity [m per m/s].

    The line is shifted by the Doppler frequency at the window's centre, f_c v / c, which reads as f_c v / k of range;
    and the crane has moved by v t_c until then.

    Args:
        center_frequency: of the sweep at the window's centre, f_c [Hz].
        chirp_rate: k [Hz/s].
        center_time: of the window after the sweep's start, t_c [s].
    """
    return center_frequency / chirp_rate + center_time


class _Point(NamedTuple):
    """One sweep of a track."""

    stamp: int  # [ns]
    moved: float  # displacement since the track began, by the phase [m]
    range: float  # with the Doppler shift still in it [m]
    std: float  # of the range [m]


class VelocityTracker:
    """Follows one pair's movement by its carrier phase, or by its ranges where sweeps are too far apart for that."""

    def __init__(self, maximum_velocity: float, maximum_acceleration: float) -> None:
        """Start with nothing known.

        Args:
            maximum_velocity: beyond it the distance has jumped [m/s].
            maximum_acceleration: what can change the velocity between two sweeps [m/s^2].
        """
        self._maximum_velocity = maximum_velocity
        self._maximum_acceleration = maximum_acceleration
        # sweeps that the phases could be followed through without a break
        self._track: collections.deque[_Point] = collections.deque(maxlen=_TRACK_LENGTH)
        # all sweeps of the last seconds
        self._recent: collections.deque[_Point] = collections.deque(maxlen=_TRACK_LENGTH)
        self._phase = math.nan
        self._velocity = math.nan
        self._stamp = 0
        self._confirmed = False
        self._fitted_to_ranges = False
        self.coasted = 0.0
        """How long ago the velocity was measured, as of the last sweep: since then it was taken to go on [s]."""

    def restart(self) -> None:
        """Begin a new track of phases (the settings changed); ranges and velocity go on."""
        self._track.clear()

    def copy(self) -> 'VelocityTracker':
        """Return a tracker that knows the same and goes on by itself."""
        other = object.__new__(VelocityTracker)
        other.__dict__.update(self.__dict__)  # a third of the time that copy.copy takes
        other._track, other._recent = self._track.copy(), self._recent.copy()
        return other

    def branch(self) -> 'VelocityTracker':
        """Return a tracker that begins a track of its own at this one's velocity."""
        other = self.copy()
        other._track.clear()
        other._recent.clear()
        return other

    def last_step(self) -> float:
        """Return the displacement between the last two sweeps, by the phases [m]; NaN where they were not followed.

        In half wavelengths at the window's centre, as the velocity; see `PathDelay.phase_frequency`.
        """
        return self._track[-1].moved - self._track[-2].moved if len(self._track) > 1 else math.nan

    def coast(self, stamp: int) -> Motion:
        """Return the velocity at `stamp` [ns] as the last sweeps had it, without taking in a new one."""
        pause = (stamp - self._stamp) * 1e-9
        if not math.isfinite(self._velocity) or not abs(pause) <= _LONGEST_PAUSE:
            return UNKNOWN
        return Motion(self._velocity, self._maximum_acceleration * abs(pause) / math.sqrt(3.0), self._confirmed)

    def update(
        self, stamp: int, path: PathDelay, measured_range: float, range_std: float, refractive_index: float
    ) -> Motion:
        """Take in one sweep and return the velocity at its start.

        Args:
            stamp: of station 1's sweep start [ns].
            path: the sweep's combined delay and carrier phase.
            measured_range: with the Doppler shift still in it [m].
            range_std: its standard deviation [m].
            refractive_index: of the air [1].
        """
        half_wave = SPEED_OF_LIGHT / refractive_index / path.center_frequency / 2.0
        pause = (stamp - self._stamp) * 1e-9
        if not 0.0 < pause <= _LONGEST_PAUSE:
            self._recent.clear()
            self._track.clear()
        motion = self.coast(stamp)
        if not math.isfinite(motion.velocity) and not self._recent:
            self._velocity = math.nan
            self._confirmed = False
        moved = 0.0
        if self._track:
            step = self._phase_step(path.carrier_phase, pause, half_wave)
            if math.isnan(step):
                self._track.clear()
            else:
                moved = self._track[-1].moved + step
        point = _Point(stamp, moved, measured_range, range_std)
        self._track.append(point)
        self._recent.append(point)
        self._phase = path.carrier_phase
        self._stamp = stamp
        self.coasted += pause
        if len(self._track) > 1:
            self._correct_ambiguity(half_wave)
            motion = self._fit_phases()
            self.coasted = 0.0
        elif math.isnan(motion.velocity) or self._fitted_to_ranges:
            motion = self._fit_ranges()
            self.coasted = 0.0
        self._fitted_to_ranges = len(self._track) == 1
        if abs(motion.velocity) > self._maximum_velocity:
            self._begin_anew(point)
            motion = UNKNOWN
        self._velocity = motion.velocity
        return motion

    def _begin_anew(self, point: _Point) -> None:
        """Forget everything before a sweep to which the distance has jumped."""
        for points in (self._track, self._recent):
            points.clear()
            points.append(point._replace(moved=0.0))
        self._confirmed = False

    def _phase_step(self, phase: float, step_time: float, half_wave: float) -> float:
        """Return the displacement since the last sweep [m], NaN where the phases do not determine it."""
        if self._maximum_acceleration * step_time**2 > _LARGEST_PHASE_STEP * half_wave:
            return math.nan
        turns = (phase - self._phase) / (2.0 * math.pi)
        if not math.isfinite(turns):
            return math.nan
        expected = self._expected_velocity() * step_time / half_wave
        return (turns + round(expected - turns)) * half_wave

    def _expected_velocity(self) -> float:
        """Return the velocity until the next sweep, the acceleration between the last two steps going on [m/s].

        Its error is at most what the largest acceleration changes within one step, however fast the crane is.
        """
        last = list(self._track)[-3:]
        steps = [(q.moved - p.moved) / ((q.stamp - p.stamp) * 1e-9) for p, q in itertools.pairwise(last)]
        if len(steps) == 2:
            return 2.0 * steps[1] - steps[0]
        if steps:
            return steps[0]
        return self._velocity if math.isfinite(self._velocity) else 0.0

    def _correct_ambiguity(self, half_wave: float) -> None:
        """Shift the track by whole half wavelengths per sweep where the ranges drift away from the phases."""
        n = _SHORTEST_COMPARISON
        # the slope's variance over n sweeps is 12 std^2 / (n (n^2 - 1))
        while n * (n**2 - 1) * half_wave**2 < 12.0 * (_DECISION * self._track[-1].std) ** 2:
            n += 1
        if n > len(self._track):
            return
        self._confirmed = True
        compared = list(self._track)[-n:]
        middle = (n - 1) / 2.0
        drift = sum((i - middle) * (p.range - p.moved) for i, p in enumerate(compared))
        turns = round(drift * 12.0 / (n * (n**2 - 1)) / half_wave)
        if turns:
            for i, point in enumerate(compared):
                self._track[i - n] = point._replace(moved=point.moved + turns * half_wave * i)

    def _fit_phases(self) -> Motion:
        """Return the velocity at the newest sweep from its displacements: a parabola, a line through few."""
        newest = self._track[-1]
        recent = [p for p in list(self._track)[-_FIT_LENGTH:] if (newest.stamp - p.stamp) * 1e-9 <= _FIT_DURATION]
        times = [(p.stamp - newest.stamp) * 1e-9 for p in recent]
        velocity, std = _slope_at_end(times, [p.moved for p in recent], with_curvature=len(recent) > 3)
        if len(recent) <= 3:  # a line lags behind by half its length
            std = math.hypot(std, self._maximum_acceleration * -times[0] / math.sqrt(12.0))
        return Motion(velocity, std, self._confirmed)

    def _fit_ranges(self) -> Motion:
        """Return the velocity at the newest sweep from its ranges, where there are enough of them.

        Over few ranges noise prevails, over many what the acceleration has changed meanwhile.
        """
        newest = self._recent[-1]
        recent = [p for p in self._recent if (newest.stamp - p.stamp) * 1e-9 <= _RANGE_FIT_DURATION]
        if len(recent) < _RANGE_FIT_MINIMUM:
            return UNKNOWN
        times = [(p.stamp - newest.stamp) * 1e-9 for p in recent]
        enough = (
            n
            for n in range(_RANGE_FIT_MINIMUM, len(times))
            if newest.std * math.sqrt(192.0 / n) <= self._lag(times[-n]) * -times[-n]
        )
        count = next(enough, len(times))
        recent, times = recent[-count:], times[-count:]
        velocity, std = _slope_at_end(times, [p.range - newest.range for p in recent], with_curvature=True)
        return Motion(velocity, math.hypot(std, self._lag(times[0])))

    def _lag(self, begin: float) -> float:
        """Return the standard deviation of a parabola's slope at its end by changes of the acceleration [m/s].

        Its largest error is `_RANGE_FIT_LAG` times acceleration and duration; every smaller one is as likely.
        """
        return _RANGE_FIT_LAG * self._maximum_acceleration * -begin / math.sqrt(3.0)


def _slope_at_end(times: Sequence[float], values: Sequence[float], with_curvature: bool) -> tuple[float, float]:
    """Return the slope at time 0 of a line or parabola through (times [s], values [m]), and its standard deviation.

    Least squares by orthogonal polynomials (Forsythe 1957), scalar: a handful of points costs microseconds.
    """
    n = len(times)
    mean_time, mean_value = sum(times) / n, sum(values) / n
    first = [t - mean_time for t in times]
    spread = sum(p * p for p in first)
    slope = sum(p * v for p, v in zip(first, values, strict=True)) / spread
    residual = [v - mean_value - slope * p for v, p in zip(values, first, strict=True)]
    variance_factor, freedom = 1.0 / spread, n - 2
    if with_curvature:
        shift = sum(t * p * p for t, p in zip(times, first, strict=True)) / spread
        second = [(t - shift) * p - spread / n for t, p in zip(times, first, strict=True)]
        second_spread = sum(p * p for p in second)
        curvature = sum(p * r for p, r in zip(second, residual, strict=True)) / second_spread
        slope += curvature * (-mean_time - shift)
        residual = [r - curvature * p for r, p in zip(residual, second, strict=True)]
        variance_factor += (mean_time + shift) ** 2 / second_spread
        freedom -= 1
    noise = sum(r * r for r in residual) / freedom if freedom > 0 else 0.0
    return slope, math.sqrt(noise * variance_factor)
