"""From beats to ranges: pairing, look-up of settings by stamp, corrections, flags. Live node and replay share it."""

import dataclasses
import enum
import functools
import math
from collections import OrderedDict

from drfmcw_node.estimators.estimation import Flag as BeatFlag
from drfmcw_node.processing.records import Beat
from drfmcw_physics.air import refractive_index
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.history import WHOLE, History
from drfmcw_physics.sweep import SweepSettings

from .combination import PathDelay, Station, combine, own_path
from .integrity.checks import PASSED, Decision, Verdict
from .integrity.continuity import Limits, Measured
from .integrity.monitor import INTEGRITY_RISK, Judgement, PairMonitor
from .integrity.own_line import OwnLine
from .integrity.settings import IntegritySettings
from .settings import FusionSettings
from .tracking import STANDING, Motion, doppler_range_rate
from .uncertainty import UNKNOWN as UNKNOWN_WEATHER
from .uncertainty import Weather, contributions, holds_for

_WAITING_LIMIT = 4096  # unpaired results kept per pair of stations
_FUSED_LIMIT = 4096  # results whose repetition is recognised, per pair of stations


class Flag(enum.IntFlag):
    """Doubts about a range (values of RangeEstimate's flags)."""

    VALID = 0
    WEAK_SIGNAL = 1
    MODE_MISMATCH = 2
    STALE_CALIBRATION = 4
    STALE_ENVIRONMENT = 8
    OUT_OF_LIMITS = 16
    SIGNAL_QUALITY = 32
    UNKNOWN_VELOCITY = 64
    MODEL_MISMATCH = 128  # a test of the integrity monitor failed; with SIGNAL_QUALITY: refused


UNMEASURED = Flag.MODE_MISMATCH | Flag.WEAK_SIGNAL | Flag.SIGNAL_QUALITY
"""Flags with which the range is no measured one."""

USELESS = UNMEASURED | Flag.OUT_OF_LIMITS
"""Flags with which a controller drops the range (docs/sensors_and_flags.md)."""

_DECISION_FLAGS = {
    Decision.VALID: int(Flag.VALID),
    Decision.DOUBTFUL: int(Flag.MODEL_MISMATCH),
    Decision.REFUSED: int(Flag.MODEL_MISMATCH | Flag.SIGNAL_QUALITY),
}

# plain integers, of which a sweep's flags are made: an operation on enumerations takes ten times as long
_WEAK_SIGNAL, _SIGNAL_QUALITY = int(Flag.WEAK_SIGNAL), int(Flag.SIGNAL_QUALITY)
_MODE_MISMATCH = int(Flag.MODE_MISMATCH)
_STALE_CALIBRATION, _STALE_ENVIRONMENT = int(Flag.STALE_CALIBRATION), int(Flag.STALE_ENVIRONMENT)
_USELESS, _UNMEASURED = int(USELESS), int(UNMEASURED)
_WEAK_LINE, _BENT_LINE = int(BeatFlag.WEAK_SIGNAL), int(BeatFlag.MODEL_MISMATCH)
_BENT_ACCOUNTED = int(BeatFlag.WEAK_SIGNAL | BeatFlag.MODEL_MISMATCH | BeatFlag.AMBIGUOUS | BeatFlag.BURST)


@dataclasses.dataclass(frozen=True)
class RangeResult:
    """One sweep's range; the fields of RangeEstimate, and what else was computed on the way."""

    stamp: int
    frame_id: str
    first_station: str
    second_station: str
    sweep_id: int
    mode: int
    flags: int
    range: float
    range_std: float
    velocity: float
    uncorrected_range: float
    alpha_correction: float
    atmosphere_correction: float
    delay_correction: float
    velocity_correction: float
    refractive_index: float
    path_delay: float  # clocks corrected, hardware included [s]
    carrier_phase: float  # [rad]
    protection_level: float = math.nan  # bound of the error [m]; infinite where refused
    integrity_risk: float = math.nan  # probability of an error beyond it [1]
    failed_tests: int = 0  # bits of integrity.checks.Test
    start_delay_excess: float = math.nan  # true T_off over the nominal one, of a pair [s]
    correlated_std: float = 0.0  # part of range_std that does not average over sweeps; 0: not stated [m]
    doppler_std: float = 0.0  # part of range_std by what a velocity may do to one ramp's range [m]
    start_frequency: float = math.nan  # of the first station's sweep [Hz]
    bandwidth: float = math.nan  # of the same, negative for a falling ramp [Hz]

    @property
    def white_std(self) -> float:
        """The part of range_std that averages over sweeps [m]."""
        if not self.correlated_std:
            return self.range_std
        return math.sqrt(max(self.range_std**2 - self.correlated_std**2, 0.0))


def flag_names(flags: int) -> list[str]:
    """Return the names of the bits set, in lower case."""
    return [str(flag.name).lower() for flag in Flag if flag and flags & flag]


class RangeFusion:
    """Pairs both stations' results by sweep number and turns each pair into a range.

    Everything is looked up by stamp, never by time of arrival, so the same messages give the same ranges, bit by bit,
    live and offline.
    """

    def __init__(
        self, settings: FusionSettings | None = None, integrity: IntegritySettings | None = None, kept: int = WHOLE
    ) -> None:
        """Start without any sweep settings, calibration or weather; of each so many values are `kept`."""
        self._kept = kept
        self._settings = settings or FusionSettings()
        self._integrity = integrity or IntegritySettings()
        self._sweeps: dict[tuple[str, str], History[SweepSettings]] = {}
        self._calibrations: dict[str, History[Calibration]] = {}
        self._board_temperatures: dict[str, History[float]] = {}
        self._locks: dict[str, History[bool]] = {}
        names = ('temperature', 'pressure', 'humidity')
        self._weather: dict[str, History[tuple[float, float]]] = {name: History(kept) for name in names}  # reading, std
        self._newest_weather: tuple[tuple | None, Weather] = None, Weather(math.nan, math.nan, math.nan)
        self._waiting: dict[tuple[str, str], OrderedDict[int, tuple[Beat, float]]] = {}
        self._monitors: dict[tuple[str, str], PairMonitor] = {}
        self._own_lines: dict[str, OwnLine] = {}
        self._fused: dict[tuple[str, str], OrderedDict[tuple[str, int, int], None]] = {}
        self.repeated = 0  # results that came once more
        self.unpaired = 0  # results whose partner never came
        self.without_settings = 0  # results of stations whose sweep settings are not known
        self.reason = ''  # why the last result was dropped

    @property
    def settings(self) -> FusionSettings:
        """Settings in use; new ones begin new tracks."""
        return self._settings

    @settings.setter
    def settings(self, value: FusionSettings) -> None:
        self._settings = value
        self._newest_weather = None, self._newest_weather[1]
        self._monitors.clear()
        self._own_lines.clear()

    @property
    def integrity(self) -> IntegritySettings:
        """Settings of the integrity monitor in use; new ones begin new tracks."""
        return self._integrity

    @integrity.setter
    def integrity(self, value: IntegritySettings) -> None:
        self._integrity = value
        self._monitors.clear()
        self._own_lines.clear()

    def failures(self, pair: tuple[str, str]) -> dict[str, int]:
        """Return the number of failed integrity tests of a pair by name, since start."""
        monitor = self._monitors.get(pair)
        return dict(monitor.failures) if monitor else {}

    def add_sweep_config(self, sweep: SweepSettings) -> None:
        """Take in a station's settings for one peer."""
        self._sweeps.setdefault((sweep.station, sweep.peer), History(self._kept)).add(sweep.stamp, sweep)

    def add_calibration(self, calibration: Calibration) -> None:
        """Take in a station's calibration."""
        self._calibrations.setdefault(calibration.station, History(self._kept)).add(calibration.stamp, calibration)

    def add_board_temperature(self, station: str, stamp: int, temperature: float) -> None:
        """Take in a station's board temperature [degC]."""
        self._board_temperatures.setdefault(station, History(self._kept)).add(stamp, temperature)

    def add_lock(self, station: str, stamp: int, locked: bool) -> None:
        """Take in whether a station's PLL is locked."""
        self._locks.setdefault(station, History(self._kept)).add(stamp, locked)

    def add_weather(self, quantity: str, stamp: int, value: float, std: float = 0.0) -> None:
        """Take in a reading of 'temperature' [degC], 'pressure' [Pa] or 'humidity' [0..1]; NaN is ignored.

        Args:
            quantity: which of the three.
            stamp: of the reading [ns].
            value: the reading.
            std: its standard deviation, in its unit; 0 where the sensor states none.
        """
        if math.isfinite(value):
            self._weather[quantity].add(stamp, (value, std))

    def sweep_config(self, station: str, peer: str, stamp: int) -> SweepSettings | None:
        """Return the settings that hold at `stamp` [ns], None where none are known."""
        history = self._sweeps.get((station, peer))
        found = history.at(stamp) if history else None
        return found[1] if found else None

    def add_beat(self, beat: Beat, arrival: float = 0.0) -> RangeResult | None:
        """Take in one station's result; return the range once both stations' results of a sweep are there.

        Args:
            beat: the result.
            arrival: when it arrived, on any clock that runs on [s]; a replay, where nothing is late, needs none.
        """
        if beat.peer == beat.station:
            return self._fuse_own(beat)
        key = (min(beat.station, beat.peer), max(beat.station, beat.peer))
        waiting = self._waiting.setdefault(key, OrderedDict())
        partner, _ = waiting.get(beat.sweep_id, (None, 0.0))
        if self._is_repeated(key, beat, partner):
            return None
        # the same number further apart is one of another run
        if (
            partner is None
            or partner.station == beat.station
            or abs(partner.stamp - beat.stamp) * 1e-9 > self.settings.pair_time_limit
        ):
            self.unpaired += partner is not None
            waiting.pop(beat.sweep_id, None)
            waiting[beat.sweep_id] = (beat, arrival)
            self._drop_overdue(waiting, arrival)
            return None
        del waiting[beat.sweep_id]
        fused = self._fused.setdefault(key, OrderedDict())
        for each in (partner, beat):
            fused[each.station, each.sweep_id, each.stamp] = None
        while len(fused) > _FUSED_LIMIT:
            fused.popitem(last=False)
        return self._fuse(partner, beat)

    def waiting(self) -> int:
        """Return the number of results that wait for their partner."""
        return sum(map(len, self._waiting.values()))

    def _is_repeated(self, key: tuple[str, str], beat: Beat, waiting: Beat | None) -> bool:
        """Return whether the network brings a result that is fused already, or waits for its partner."""
        known = (beat.station, beat.sweep_id, beat.stamp) in self._fused.get(key, ())
        waits = waiting is not None and (waiting.station, waiting.stamp) == (beat.station, beat.stamp)
        self.repeated += known or waits
        return known or waits

    def _drop_overdue(self, waiting: OrderedDict[int, tuple[Beat, float]], now: float) -> None:
        while waiting:
            oldest, arrival = next(iter(waiting.values()))
            if now - arrival <= self.settings.pair_time_limit and len(waiting) <= _WAITING_LIMIT:
                return
            waiting.popitem(last=False)
            self.unpaired += 1
            self.reason = f"sweep {oldest.sweep_id} of '{oldest.station}': no result of '{oldest.peer}' in time"

    def _station(self, beat: Beat) -> Station | None:
        sweep = self.sweep_config(beat.station, beat.peer, beat.stamp)
        if sweep is None:
            self.without_settings += 1
            self.reason = f"no sweep settings of '{beat.station}' for '{beat.peer}'"
            return None
        history = self._calibrations.get(beat.station)
        found = history.at(beat.stamp) if history else None
        calibration = found[1] if found else Calibration(beat.station)
        if calibration.depends_on_temperature:
            calibration = calibration.at(self._board_temperature(beat.station, beat.stamp))
        return Station(beat, sweep, calibration)

    def _board_temperature(self, station: str, stamp: int) -> float:
        """Return a station's board temperature at `stamp`, NaN where none is known [degC]."""
        history = self._board_temperatures.get(station)
        found = history.at(stamp) if history else None
        return found[1] if found else math.nan

    def _fuse_own(self, beat: Beat) -> RangeResult | None:
        station = self._station(beat)
        if station is None:
            return None
        path = own_path(station, self.settings.alpha_correction)
        return self._result(station, station, path, station.calibration.delay)

    def _fuse(self, one: Beat, other: Beat) -> RangeResult | None:
        first, second = self._station(one), self._station(other)
        if first is None or second is None:
            return None
        if first.sweep.role > second.sweep.role:
            first, second = second, first
        try:
            path = combine(first, second, self.settings.alpha_correction)
        except (ArithmeticError, ValueError) as error:
            self.without_settings += 1
            self.reason = f"settings of '{first.sweep.station}': {error}"
            return None
        return self._result(first, second, path, first.calibration.delay + second.calibration.delay)

    def _result(self, first: Station, second: Station, path: PathDelay, hardware_delay: float) -> RangeResult:
        stamp = first.beat.stamp
        weather, stale_environment = self._weather_at(stamp)
        index = self._refractive_index(weather)
        velocity_of_light = SPEED_OF_LIGHT / index
        standing_range = (path.delay - hardware_delay) * velocity_of_light
        range_std = path.std * velocity_of_light
        flags = self._flags(first, second, stamp) | (_STALE_ENVIRONMENT if stale_environment else 0)
        rate = doppler_range_rate(path.center_frequency, first.sweep.chirp_rate, path.center_time)
        correlated_std = 0.0
        if first.calibration.states_uncertainty and second.calibration.states_uncertainty:
            correlated_std = contributions(first, second, path, weather, self.settings.atmosphere).total
        monitor = self._monitor(first, second)
        verdict = monitor.judge_sweep(first, second, path, standing_range, self._unlocked(first, second, stamp))
        judged = self._motion(
            first,
            second,
            flags,
            verdict,
            Measured(
                stamp,
                path,
                standing_range,
                range_std,
                index,
                rate,
                (first.sweep.mode, first.sweep.start_delay),
                verdict.std,
                SPEED_OF_LIGHT / (2.0 * abs(first.sweep.bandwidth)),
                correlated_std,
            ),
        )
        motion, verdict = judged.motion, verdict & judged.verdict
        monitor.count(verdict)
        flags |= _DECISION_FLAGS[verdict.decision]
        if self.settings.velocity == 'tracked' and first is not second and not motion.confirmed:
            flags |= int(Flag.UNKNOWN_VELOCITY)
        velocity_correction = doppler_std = 0.0
        if math.isfinite(motion.velocity):
            velocity_correction = -rate * motion.velocity
        if math.isfinite(motion.velocity_std):
            doppler_std = abs(rate) * motion.velocity_std
            range_std = math.hypot(range_std, doppler_std)
        if verdict.std > 0.0:
            range_std = math.hypot(range_std, verdict.std)
        range_std = math.hypot(range_std, correlated_std)
        uncorrected = path.uncorrected * SPEED_OF_LIGHT
        alpha_correction = (path.delay - path.uncorrected) * SPEED_OF_LIGHT
        delay_correction = -hardware_delay * SPEED_OF_LIGHT
        atmosphere_correction = (path.delay - hardware_delay) * (velocity_of_light - SPEED_OF_LIGHT)
        corrected = uncorrected + alpha_correction + delay_correction + atmosphere_correction + velocity_correction
        if not math.isfinite(corrected):  # a sweep without a line
            flags |= _WEAK_SIGNAL
        elif not self.settings.minimum_range <= corrected <= self.settings.maximum_range:
            flags |= int(Flag.OUT_OF_LIMITS)
        return RangeResult(
            stamp=stamp,
            frame_id=first.beat.frame_id,
            first_station=first.sweep.station,
            second_station=second.sweep.station,
            sweep_id=first.beat.sweep_id,
            mode=first.sweep.mode,
            flags=flags,
            range=corrected,
            range_std=range_std,
            velocity=motion.velocity,
            uncorrected_range=uncorrected,
            alpha_correction=alpha_correction,
            atmosphere_correction=atmosphere_correction,
            delay_correction=delay_correction,
            velocity_correction=velocity_correction,
            refractive_index=index,
            path_delay=path.delay,
            carrier_phase=path.carrier_phase,
            protection_level=judged.protection_level(range_std) if not flags & _USELESS else math.inf,
            integrity_risk=INTEGRITY_RISK if not flags & _USELESS else 1.0,
            failed_tests=int(verdict.failed),
            start_delay_excess=path.start_delay_excess,
            correlated_std=correlated_std,
            doppler_std=doppler_std,
            start_frequency=first.sweep.start_frequency,
            bandwidth=first.sweep.bandwidth,
        )

    def _weather_at(self, stamp: int) -> tuple[Weather, bool]:
        """Return (weather, whether a reading is missing or too old) at `stamp`."""
        if self.settings.atmosphere == 'vacuum':
            return self._weather_of(()), False
        found = [history.at(stamp) for history in self._weather.values()]
        limit = self.settings.environment_time_limit
        stale = any(reading is None or (stamp - reading[0]) * 1e-9 > limit for reading in found)
        return self._weather_of(tuple(None if reading is None else reading[1] for reading in found)), stale

    def _weather_of(self, readings: tuple[tuple[float, float] | None, ...]) -> Weather:
        """Return the weather by its readings, in order, with defaults for what is missing; the newest one is kept."""
        if readings != self._newest_weather[0]:
            s = self.settings
            defaults = {
                'temperature': s.default_temperature, 'pressure': s.default_pressure, 'humidity': s.default_humidity
            }  # fmt: skip
            values = defaults | {f'{name}_std': std for name, std in UNKNOWN_WEATHER.items()}
            for quantity, reading in zip(self._weather, readings, strict=False):
                if reading is not None:
                    values[quantity], values[f'{quantity}_std'] = reading
            self._newest_weather = readings, Weather(**values)
        return self._newest_weather[1]

    def _refractive_index(self, weather: Weather) -> float:
        if self.settings.atmosphere == 'vacuum':
            return 1.0
        return _refractive_index(weather.temperature, weather.pressure, weather.humidity, self.settings.atmosphere)

    def _flags(self, first: Station, second: Station, stamp: int) -> int:
        flags = 0
        for station in (first, second):
            if station.beat.flags & _WEAK_LINE or not math.isfinite(station.beat.frequency):
                flags |= _WEAK_SIGNAL
            if station.beat.flags & ~_accounted(station.beat.flags):
                flags |= _SIGNAL_QUALITY
            if self._calibration_is_stale(station, stamp):
                flags |= _STALE_CALIBRATION
        if not (
            holds_for(first.calibration, second.sweep.station) and holds_for(second.calibration, first.sweep.station)
        ):
            flags |= _STALE_CALIBRATION
        if first is not second and not _match(first.sweep, second.sweep):
            flags |= _MODE_MISMATCH
        return flags

    def _calibration_is_stale(self, station: Station, stamp: int) -> bool:
        name = station.sweep.station
        calibrations = self._calibrations.get(name)
        found = calibrations.at(stamp) if calibrations else None
        if found is None:
            return True
        calibration, temperature = found[1], self._board_temperature(name, stamp)
        if math.isnan(temperature):
            return calibration.depends_on_temperature  # the curve cannot be used
        covered = calibration.covers(temperature)
        if covered is not None:
            return not covered
        return abs(temperature - calibration.temperature) > self.settings.calibration_temperature_limit

    def _unlocked(self, first: Station, second: Station, stamp: int) -> bool:
        """Return whether a station's newest status before `stamp` says that its PLL is not locked."""
        for station in (first, second):
            history = self._locks.get(station.sweep.station)
            found = history.at(stamp) if history else None
            if found is not None and not found[1]:
                return True
        return False

    def _monitor(self, first: Station, second: Station) -> PairMonitor:
        key = (first.sweep.station, second.sweep.station)
        if key not in self._monitors:
            limits = Limits(self.settings.maximum_velocity, self.settings.maximum_acceleration)
            self._monitors[key] = PairMonitor(limits, self._integrity)
        return self._monitors[key]

    def _motion(self, first: Station, second: Station, flags: int, verdict: Verdict, measured: Measured) -> Judgement:
        """Return the pair's velocity at this sweep, from its carrier phases or as set, and whether it goes on."""
        useless = flags & _UNMEASURED or verdict.decision == Decision.REFUSED
        if first is second:
            return self._own_motion(first, bool(useless), measured)
        if self.settings.velocity == 'standing':
            return Judgement(STANDING, PASSED, math.inf, 1.0)
        monitor = self._monitor(first, second)
        if useless:
            return Judgement(monitor.coast(measured.stamp), PASSED, math.inf, 1.0)
        return monitor.follow(measured)

    def _own_motion(self, station: Station, useless: bool, measured: Measured) -> Judgement:
        """Return what may be said of the velocity of a station's own echo, and whether its ranges hop."""
        standing = self.settings.velocity == 'standing'
        verdict, spread = PASSED, self.settings.maximum_velocity / math.sqrt(3.0)
        if not useless:
            verdict, spread = self._own_line(station.sweep.station).follow(measured)
        motion = STANDING if standing else Motion(math.nan, spread, confirmed=False)
        return Judgement(motion, verdict if self.integrity.monitor else PASSED, math.inf, 1.0)

    def _own_line(self, name: str) -> OwnLine:
        if name not in self._own_lines:
            self._own_lines[name] = OwnLine(Limits(self.settings.maximum_velocity, self.settings.maximum_acceleration))
        return self._own_lines[name]


def _accounted(flags: int) -> int:
    """Return a beat's flags that are no further doubt: a line's standard deviation includes what bends it."""
    return _BENT_ACCOUNTED if flags & _BENT_LINE else _WEAK_LINE


@functools.lru_cache(maxsize=16)
def _refractive_index(temperature: float, pressure: float, humidity: float, model: str) -> float:
    """Return the index as a float; readings change once a minute, sweeps a thousand times a second."""
    return float(refractive_index(temperature, pressure, humidity, model))


def _match(first: SweepSettings, second: SweepSettings) -> bool:
    """Return True where two stations sweep alike, so that their results belong together."""
    same = ('mode', 'bandwidth', 'ramp_duration', 'start_delay')
    return first.role != second.role and all(getattr(first, name) == getattr(second, name) for name in same)
