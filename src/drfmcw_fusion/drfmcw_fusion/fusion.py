"""Fusion node: pairs of stations' beat frequencies in, ranges out; requests modes and rates from the stations."""

import dataclasses
import functools
import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, cast

from drfmcw_msgs.msg import (
    BeatFrequency,
    RangeBatch,
    RangeEstimate,
    StationCalibration,
    StationStatus,
    SweepConfig,
    SweepSchedule,
)
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import FluidPressure, Range, RelativeHumidity, Temperature

from drfmcw_node.processing.records import Beat
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.history import LIVE
from drfmcw_physics.rules.mode import ModeSettings
from drfmcw_physics.rules.plausible import printable
from drfmcw_physics.rules.schedule import LARGEST_PRIORITY, LARGEST_RATE, NO_TURNS, Share, Turns, falls_short
from drfmcw_physics.settings import ConfigurationError, parameter
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.commands.cli import Parser, guarded, split_ros_arguments
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import check, from_message, publish, stamp_ns, to_message
from drfmcw_ros.graph.publishers import Publishers
from drfmcw_ros.graph.topics import DISPLAYED
from drfmcw_ros.nodes.diagnostics import ERROR, WARN, Diagnostics, Status
from drfmcw_ros.nodes.managed import ManagedNode
from drfmcw_ros.nodes.parameters import SettingsParameters
from drfmcw_ros.nodes.runner import run

from .batch import Gathering
from .integrity.settings import IntegritySettings
from .offline import read_weather, weather_std
from .pipeline import UNMEASURED, USELESS, Flag, RangeFusion, RangeResult, flag_names
from .requesting import ModeRequests, TurnRequests
from .settings import FusionSettings

_UNSURE = Flag.UNKNOWN_VELOCITY | Flag.STALE_CALIBRATION | Flag.STALE_ENVIRONMENT  # sensor_msgs: variance 0
_WEATHER_TYPES = {
    '/site/temperature': Temperature,
    '/site/pressure': FluidPressure,
    '/site/humidity': RelativeHumidity,
}
_LARGEST_FLOAT = 3.4e38  # of a float32 field
_LOG_INTERVAL = 10.0  # between two lines about refused messages [s]
_LONGEST_SILENCE = 3600.0  # that is not reported, however low the rate [s]
_GATHER = 0.5e-3  # of the stations' results [s]
_REST = 0.1  # after which ranges are sent to displays although none follows [s]
_LEASE = 25.0  # after which DDS has forgotten a publisher that died: 20 s by default [s]
_LARGEST_PAIR_COUNT = 64  # latched settings kept per station topic


@dataclasses.dataclass(frozen=True)
class PairSettings:
    """Which stations are fused, and how the result is described."""

    pairs: list[str] = parameter(
        ['master/slave'], description="pairs of stations as 'first/second'; 'name/name' hears itself", structural=True
    )
    field_of_view: float = parameter(
        0.3, unit='rad', bounds=(0.0, 2.0 * math.pi), description='of range_sensor: beam width of the antennas'
    )
    switch_mode: bool = parameter(True, description='request from the stations the mode that the distance needs')
    rates: list[float] = parameter(
        [0.0], unit='Hz', bounds=(0.0, LARGEST_RATE),
        description='sweeps per second that each of `pairs`, in their order, asks for in time division; '
        "0 or left out: the hardware's own",
    )  # fmt: skip
    priorities: list[int] = parameter(
        [0], bounds=(-LARGEST_PRIORITY, LARGEST_PRIORITY),
        description='of each of `rates`: the higher one gets its rate first',
    )  # fmt: skip

    def __post_init__(self) -> None:
        """Refuse names that are no pair, and rates of more pairs than there are."""
        for pair in self.pairs:
            if pair.count('/') != 1 or not all(pair.split('/')):
                raise ConfigurationError(f"pairs: '{pair}' is not 'first/second'")
        if len(set(self.pairs)) != len(self.pairs):
            raise ConfigurationError(f'pairs: a pair is given twice in {self.pairs}')
        for name in ('rates', 'priorities'):
            given = len(getattr(self, name))
            if given > len(self.pairs):
                raise ConfigurationError(f'{name}: {given} values for {len(self.pairs)} pair(s)')

    @functools.cached_property
    def turns(self) -> dict[tuple[str, str], Turns]:
        """What each pair asks of the time division."""
        found = {}
        for number, pair in enumerate(self.pairs):
            first, second = pair.split('/')
            rate = self.rates[number] if number < len(self.rates) else 0.0
            priority = self.priorities[number] if number < len(self.priorities) else 0
            found[first, second] = (rate, priority) if rate else NO_TURNS
        return found


@dataclasses.dataclass
class _PairState:
    """What the node keeps about one pair."""

    range_publisher: Any
    sensor_publisher: Any
    batch_publisher: Any
    gathering: Gathering = dataclasses.field(default_factory=Gathering)
    newest: RangeResult | None = None
    ranges: int = 0  # since the last diagnostics
    flagged: int = 0
    silent: int = 0  # diagnostics in a row without a range
    alone: float = dataclasses.field(default_factory=time.monotonic)  # when nobody else published last [s]


class FusionNode(ManagedNode):
    """Thin shell around RangeFusion."""

    def __init__(self, pairs: Sequence[str] | None = None, **kwargs: Any) -> None:
        """Create the node; `pairs` replaces the default of the parameter of that name."""
        super().__init__('fusion', **kwargs)
        described = PairSettings(pairs=list(pairs)) if pairs else PairSettings()
        self._logger: Any = cast(Any, self).get_logger()  # rclpy gives it no type
        self._pair_settings = SettingsParameters(self, PairSettings, described, on_change=self._change_pairs)
        self._settings = SettingsParameters(self, FusionSettings, on_change=self._change)
        self._integrity = SettingsParameters(
            self, IntegritySettings, prefix='integrity', on_change=self._change_integrity
        )
        self._mode = SettingsParameters(self, ModeSettings, prefix='mode')
        names: list[Any] = [tuple(pair.split('/')) for pair in self._pair_settings.value.pairs]
        self._stations = {name for pair in names for name in pair}
        self._refused = self._refused_before = 0  # messages
        self._refusal = ''  # why the last one was
        self._logged = -_LOG_INTERVAL
        diagnostics = Diagnostics(self, 'fusion', self.state)
        for pair in names:
            diagnostics.add(f'Range {"/".join(pair)}', functools.partial(self._diagnose, pair))
        diagnostics.add('Pairing', self._diagnose_pairing)
        diagnostics.add('Inputs', self._diagnose_inputs)
        self.begin()

    def configure(self) -> None:
        """Create the topics, and begin without anything known."""
        self._fusion = RangeFusion(self._settings.value, self._integrity.value, kept=LIVE)
        self._first = qos.FirstTopics(self)  # settings, calibrations, weather: before the beats that need them
        self._pairs: dict[tuple[str, str], _PairState] = {}
        for pair in self._pair_settings.value.pairs:
            first, second = pair.split('/')
            self._pairs[first, second] = _PairState(
                qos.publisher(self, RangeEstimate, f'/{pair}/range', qos.RANGE),
                qos.publisher(self, Range, f'/{pair}/range_sensor', qos.RANGE),
                qos.publisher(self, RangeBatch, f'/{pair}/{DISPLAYED["range"]}', qos.RELIABLE),
            )
        self._mode_publishers: dict[tuple[str, str], Any] = {}
        self._turn_publishers: dict[tuple[str, str], Any] = {}
        self._beat_subscriptions: list[Any] = []
        self._mode_requests = ModeRequests(self._fusion.sweep_config, self._request_mode)
        self._turn_requests = TurnRequests(self._request_turns)
        self._granted: dict[tuple[str, str], Share] = {}  # by station and peer
        self._lost = (0, 0)
        for station in sorted(self._stations):
            self._listen_to(station)
        for topic, kind in _WEATHER_TYPES.items():
            self._first.readings(kind, topic, functools.partial(self._weather, topic))
        rest = functools.partial(self._publish_batches, whole=True)
        self.create_timer(_REST, rest, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def activate(self) -> None:
        """Ask for the rates of the pairs, and give signs of life.

        These come from the executor that makes the ranges, so that they end when it hangs.
        """
        self._change_pairs(self._pair_settings.value)
        publishers = [p for state in self._pairs.values() for p in (state.range_publisher, state.sensor_publisher)]
        self._life = qos.live(self, publishers)

    def deactivate(self) -> None:
        """End the signs of life: nobody may wait for ranges of a node that makes none."""
        self.destroy_timer(self._life)

    def _listen_to(self, station: str) -> None:
        latched = qos.latched_subscription(_LARGEST_PAIR_COUNT)
        self._first.subscription(SweepConfig, f'/{station}/sweep_config', self._sweep_config, latched)
        self._first.subscription(SweepSchedule, f'/{station}/sweep_schedule', self._sweep_schedule, latched)
        self._first.subscription(StationCalibration, f'/{station}/calibration', self._calibration, latched)
        self._first.subscription(StationStatus, f'/{station}/status', self._status, qos.RELIABLE)
        sources = Publishers(f'/{station}/beat_frequency')
        take = functools.partial(self._beats, station, sources)
        beats = qos.subscription(
            self, BeatFrequency, sources.topic, take, qos.DEEP, batch=True, gather=_GATHER, numbers=sources.add
        )
        self._beat_subscriptions.append(beats)
        for pair in self._pairs:
            if station not in pair:
                continue
            peer = pair[1] if station == pair[0] else pair[0]
            self._turn_publishers[station, peer] = qos.publisher(
                self, SweepSchedule, f'/{station}/schedule_request', qos.LATCHED, instance=peer
            )
            if station != peer:
                self._mode_publishers[station, peer] = qos.publisher(
                    self, SweepConfig, f'/{station}/sweep_request', qos.LATCHED, instance=peer
                )

    def _change_pairs(self, settings: PairSettings) -> None:
        if self.active:
            self._turn_requests.ask(settings.turns, self.get_clock().now().nanoseconds)

    def _request_mode(self, request: SweepSettings) -> None:
        self._mode_publishers[request.station, request.peer].publish(to_message(request, SweepConfig))

    def _request_turns(self, request: Share) -> None:
        self._turn_publishers[request.station, request.peer].publish(to_message(request, SweepSchedule))

    def _change(self, settings: FusionSettings) -> None:
        if self.state() != 'unconfigured':  # else `configure` takes them
            self._fusion.settings = settings

    def _change_integrity(self, settings: IntegritySettings) -> None:
        if self.state() != 'unconfigured':
            self._fusion.integrity = settings

    def _sweep_config(self, message: SweepConfig) -> None:
        self._take(message, lambda: self._fusion.add_sweep_config(from_message(message, SweepSettings)))

    def _sweep_schedule(self, message: SweepSchedule) -> None:
        def take() -> None:
            self._granted[message.station, message.peer] = from_message(message, Share)

        self._take(message, take)

    def _calibration(self, message: StationCalibration) -> None:
        self._take(message, lambda: self._fusion.add_calibration(from_message(message, Calibration)))

    def _take(self, message: Any, take: Callable[[], RangeResult | None]) -> RangeResult | None:
        """Return what `take` makes of a message; an implausible one is refused with the reason, and counted."""
        station = getattr(message, 'station', '')
        try:
            for field in ('station', 'peer'):  # what is kept by these names stays as large as the pairs make it
                name = getattr(message, field, '')
                if name and name not in self._stations:
                    raise ConfigurationError(f'{field} = {printable(name)} is in none of the pairs')
            return take()
        except ConfigurationError as error:
            self._refused += 1
            self._refusal = f'{type(message).__name__}{" of " + printable(station) if station else ""}: {error}'
            now = time.monotonic()
            if now - self._logged >= _LOG_INTERVAL:
                self._logged = now
                self._logger.error(f'refused {self._refusal}')
            return None

    def _status(self, message: StationStatus) -> None:
        def take() -> None:
            check(message)
            stamp = stamp_ns(message.header.stamp)
            if math.isfinite(message.temperature):
                self._fusion.add_board_temperature(message.station, stamp, message.temperature)
            self._fusion.add_lock(message.station, stamp, message.pll_locked)

        self._take(message, take)

    def _weather(self, topic: str, message: Any) -> None:
        def take() -> None:
            quantity, value = read_weather(topic, message)
            self._fusion.add_weather(quantity, stamp_ns(message.header.stamp), value, weather_std(message))

        self._take(message, take)

    def _beats(self, station: str, sources: Publishers, messages: list[BeatFrequency]) -> None:
        if not self.active:
            return
        self._first.poll()
        arrival, doubt = time.monotonic(), sources.doubt

        def add(message: BeatFrequency) -> RangeResult | None:
            if message.station != station:
                raise ConfigurationError(f'it came on {sources.topic}')
            if doubt:
                raise ConfigurationError(doubt)
            return self._add_beat(message, arrival)

        for message in messages:
            result = self._take(message, functools.partial(add, message))
            if result is not None:
                self._publish(result)
        self._publish_batches()

    def _add_beat(self, message: BeatFrequency, arrival: float) -> RangeResult | None:
        return self._fusion.add_beat(from_message(message, Beat), arrival)

    def _publish(self, result: RangeResult) -> None:
        pair = (result.first_station, result.second_station)
        state = self._pairs.get(pair)
        if state is None:
            return  # a pair that this node does not fuse
        state.range_publisher.publish(to_message(result, RangeEstimate))
        if state.sensor_publisher.get_subscription_count():
            state.sensor_publisher.publish(self._sensor_message(result))
        if state.batch_publisher.get_subscription_count():
            state.gathering.add(result, time.monotonic())
        state.newest = result
        state.ranges += 1
        state.flagged += result.flags != Flag.VALID
        if self._pair_settings.value.switch_mode and not result.flags & USELESS:
            asked = self._mode_requests.ask(result, self._mode.value, time.monotonic())
            if asked is not None:
                self._logger.info(f'{"/".join(pair)}: {asked.short_name} mode asked for at {result.range:.1f} m')

    def _publish_batches(self, whole: bool = False) -> None:
        """Publish for displays what is due, after the ranges themselves; all that waits, once no range follows."""
        now = time.monotonic()
        for state in self._pairs.values():
            batch = state.gathering.take(now) if whole or state.gathering.due(now) else None
            if batch is not None:
                publish(state.batch_publisher, batch)

    def _sensor_message(self, result: RangeResult) -> Range:
        """Return the range for tools that know only the standard type (REP 117)."""
        settings = self._settings.value
        message = Range()
        message.header = to_message(result, RangeEstimate).header
        message.radiation_type = Range.INFRARED  # the type knows no radar; the electromagnetic one is nearest
        message.field_of_view = self._pair_settings.value.field_of_view
        message.min_range = settings.minimum_range
        message.max_range = settings.maximum_range
        message.variance = 0.0 if result.flags & _UNSURE else min(result.range_std**2, _LARGEST_FLOAT)
        if result.flags & UNMEASURED:
            message.range = math.nan
        elif result.flags & Flag.OUT_OF_LIMITS:
            message.range = -math.inf if result.range < settings.minimum_range else math.inf
        else:
            message.range = result.range
        return message

    def _diagnose(self, pair: tuple[str, str], status: Status) -> None:
        state = self._pairs[pair]
        self._diagnose_rivals(f'/{"/".join(pair)}/range', state, status)
        self._diagnose_rate(pair, state, status)
        if state.flagged:
            doubts = ', '.join(flag_names(state.newest.flags if state.newest else 0)) or 'none'
            status.report(WARN, f'{state.flagged} of {state.ranges} ranges in doubt, last: {doubts}')
        if state.newest is not None:
            status.value('range [m]', state.newest.range)
            status.value('range_std [m]', state.newest.range_std)
            status.value('velocity [m/s]', state.newest.velocity)
            status.value('protection level [m]', state.newest.protection_level)
            status.value('mode', 'LD' if state.newest.mode else 'SD')
            status.value('refractive_index', f'{state.newest.refractive_index:.7f}')
        for test, count in self._fusion.failures(pair).items():
            status.value(f'failed test {test}', count)
        status.value(
            f'subscribers of {state.range_publisher.topic_name}', state.range_publisher.get_subscription_count()
        )
        state.ranges = state.flagged = 0

    def _diagnose_rate(self, pair: tuple[str, str], state: _PairState, status: Status) -> None:
        """Report how many ranges a second are asked for, are granted by the time division, and arrived."""
        asked, _ = self._pair_settings.value.turns[pair]
        schedule = self._granted.get(pair)
        granted = schedule.rate if schedule is not None else 0.0
        state.silent = 0 if state.ranges else state.silent + 1
        # two sweeps are less than twice their mean interval apart
        longest = math.ceil(min(2.0 / granted, _LONGEST_SILENCE)) if granted else 1
        if state.silent >= longest:
            span = 'second' if longest == 1 else f'{longest} s'
            status.report(ERROR if state.newest is None else WARN, f'no range in the last {span}')
        if granted and falls_short(granted, asked):
            status.report(WARN, f'{granted:.4g} of {asked:g} ranges per second granted')
        status.value('ranges per second asked for', asked or 'none')
        status.value('ranges per second granted', granted or 'not stated')
        status.value('ranges per second', state.ranges)

    def _diagnose_rivals(self, topic: str, state: _PairState, status: Status) -> None:
        """Report another node that publishes this pair's ranges, which consumers cannot keep apart from ours."""
        now = time.monotonic()
        others = self.count_publishers(topic) - 1
        if others <= 0:
            state.alone = now
        elif now - state.alone < _LEASE:
            status.report(WARN, f'another node publishes on {topic}, or one that died did')
        else:
            status.report(ERROR, f'{others} other nodes publish on {topic}: a second graph in this ROS domain?')
            self._logger.error(f'{others} other nodes publish on {topic}', throttle_duration_sec=_LOG_INTERVAL)

    def _diagnose_pairing(self, status: Status) -> None:
        lost = (self._fusion.unpaired, self._fusion.without_settings)
        if lost != self._lost:
            status.report(WARN, self._fusion.reason)
        status.value('results without a partner', lost[0])
        status.value('results without settings', lost[1])
        status.value('results that came twice', self._fusion.repeated)
        self._lost = lost

    def _diagnose_inputs(self, status: Status) -> None:
        new, self._refused_before = self._refused - self._refused_before, self._refused
        if new:
            status.report(ERROR, f'{new} messages refused, last: {self._refusal}')
        status.value('refused messages', self._refused)
        for beats in self._beat_subscriptions:
            status.value(f'publishers of {beats.topic_name}', beats.get_publisher_count())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; return the exit status."""
    own, ros = split_ros_arguments(argv)
    parser = Parser(prog='drfmcw fusion', description=__doc__)
    parser.add_argument('--pair', action='append', metavar='FIRST/SECOND', help='pair of stations (repeatable)')
    arguments = parser.parse_args(own)
    return guarded('drfmcw fusion', lambda: run(FusionNode, ros, pairs=arguments.pair))


if __name__ == '__main__':
    sys.exit(main())
