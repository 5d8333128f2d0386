"""ROS node that stands in for the hardware of all stations, the weather sensors and the reference instrument."""

import dataclasses
import functools
import queue
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

from drfmcw_msgs.msg import BeatFrequency, RangeEstimate, SweepConfig, SweepSchedule
from rclpy.duration import Duration
from rclpy.node import Node

from drfmcw_physics.rules.schedule import Share
from drfmcw_physics.settings import ConfigurationError, parameter
from drfmcw_ros.calibration.document import Document
from drfmcw_ros.calibration.service import CalibrationService
from drfmcw_ros.calibration.store import CalibrationStore
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import from_message, message_class, publish
from drfmcw_ros.graph.topics import is_latched, is_per_peer
from drfmcw_ros.nodes.diagnostics import OK, WARN, Diagnostics, Status
from drfmcw_ros.nodes.parameters import SettingsParameters
from drfmcw_ros.nodes.runner import Finished, run

from .flow_control import Acknowledgements
from .recording import message_type
from .requests import Requests
from .scenario import Scenario, read_scenario
from .timeline import NANOSECONDS, Event, IfSweep, Timeline

_BLOCK = 8  # measurements synthesised at once: a few milliseconds of delay at most
_SETTLING = 0.5  # from the match with the stations to the first sweep, so that latched settings arrive first [s]
_LAG_LIMIT = 1.0  # lag behind the pace beyond which the node stops catching up and goes on from the present [s]
_DELIVERY_LIMIT = 5.0  # wait at the end for subscribers to have received everything [s]


@dataclasses.dataclass(frozen=True)
class SimulatorSettings:
    """Parameters of the simulator node."""

    scenario: str = parameter('', description='path of the scenario file (YAML)', structural=True)
    overrides: list[str] = parameter(
        [], description="changes of the scenario, each 'section.key=value'", structural=True
    )
    seed: int = parameter(
        -1, bounds=(-1, 2**63 - 1), description="of all random numbers; -1: the scenario's", structural=True
    )
    pace: str = parameter(
        'scenario', choices=('scenario', 'subscribers'), structural=True,
        description="'scenario': scenario time times `rate`; 'subscribers': as fast as stations and fusion go",
    )  # fmt: skip
    rate: float = parameter(
        1.0, bounds=(1e-3, 1e4), description="scenario seconds per second of the pace 'scenario'; 1 is real time"
    )
    window: int = parameter(
        20, bounds=(1, 350),
        description="pace 'subscribers': sweeps that a station may have unanswered; twice as many may lack their range",
    )  # fmt: skip
    acknowledge_timeout: float = parameter(
        2.0, unit='s', bounds=(0.05, 600.0),
        description="pace 'subscribers': wait for a silent station or pair; then go on without until it is back",
    )  # fmt: skip
    listeners: int = parameter(
        1, bounds=(1, 100), description="subscribers of each station's samples to wait for (2 with a recorder)"
    )
    wait_for_subscribers: float = parameter(
        15.0, unit='s', bounds=(0.0, 3600.0), description='longest wait for the stations (and fusion) before the start'
    )
    mode_control: str = parameter(
        'request', choices=('request', 'range'), structural=True,
        description="'request': mode as asked for on sweep_request; 'range': by the scenario's own distance limit",
    )  # fmt: skip
    state_directory: str = parameter(
        '', structural=True,
        description='directory of calibrations that stations publish and store_calibration adds to; empty: none',
    )  # fmt: skip
    settings_pause: float = parameter(
        0.05,
        unit='s',
        bounds=(0.0, 60.0),
        description='wall-clock pause after new sweep settings, so that they arrive first',
    )
    start: str = parameter(
        'now', choices=('now', 'scenario'), structural=True, description='stamp of the first sweep: now, or start_time'
    )
    at_end: str = parameter(
        'exit', choices=('exit', 'loop', 'stay'), description='what follows the end of the scenario'
    )


class Simulator(Node):
    """Publishes a scenario as the hardware would."""

    def __init__(self, **kwargs: Any) -> None:
        """Read the scenario, create the publishers and start the hardware thread.

        Raises:
            ConfigurationError: wrong parameter or scenario.
        """
        super().__init__('simulator', **kwargs)
        self._settings = SettingsParameters(self, SimulatorSettings)
        settings = self.settings
        if not settings.scenario:
            raise ConfigurationError("simulator: parameter 'scenario' is missing: the path of a scenario file")
        self.scenario: Scenario = read_scenario(
            settings.scenario, tuple(o for o in settings.overrides if o), None if settings.seed < 0 else settings.seed
        )
        self._stored: queue.SimpleQueue[Document] = queue.SimpleQueue()
        if settings.state_directory:
            self._keep_calibrations(CalibrationStore(settings.state_directory))
        start = self._now() if settings.start == 'now' else None  # the settings' stamps precede it
        self._timeline = Timeline(self.scenario, start, mode_by_range=settings.mode_control == 'range')
        self._publishers_of: dict[tuple[str, str], Any] = {}
        self._lock = threading.Condition()
        self._requests = Requests(self.scenario, modes=settings.mode_control == 'request')
        self._demands = self._requests.demands()  # of the timeline
        self._stop = threading.Event()
        self._finished = threading.Event()
        self._failure: BaseException | None = None
        self._state = 'waiting for subscribers'
        self._anchor = (0.0, 0)  # a moment of the machine's clock [s] and the stamp that was due then [ns]
        self._lag = 0.0
        self._answers = Acknowledgements(list(self.scenario.stations))
        self._ranges = Acknowledgements([f'{pair.first}/{pair.second}' for pair in self.scenario.pairs])
        if settings.pace == 'subscribers':
            self._listen()
        latched = qos.latched_subscription(max(2, 2 * len(self.scenario.pairs)))
        for station in self.scenario.stations:
            qos.subscription(self, SweepConfig, f'/{station}/sweep_request', self._on_request, latched)
            qos.subscription(self, SweepSchedule, f'/{station}/schedule_request', self._on_schedule_request, latched)
        for event in self._timeline.opening():
            self._publisher(event)
        self._create_stream_publishers()
        self._diagnostics = Diagnostics(self, 'simulator')
        self._diagnostics.add('Scenario', self._diagnose)
        self.create_timer(0.1, self._check_end)
        self._thread = threading.Thread(target=self._run, name='hardware', daemon=True)
        self._thread.start()

    @property
    def settings(self) -> SimulatorSettings:
        """The parameters' present values."""
        return self._settings.value

    def destroy_node(self) -> None:
        """Stop the hardware thread, then the node."""
        self._stop.set()
        with self._lock:
            self._lock.notify_all()
        if hasattr(self, '_thread'):
            self._thread.join(timeout=5.0)
        super().destroy_node()

    def _now(self) -> int:
        return self.get_clock().now().nanoseconds

    # --- what comes in ---

    def _keep_calibrations(self, store: CalibrationStore) -> None:
        """Let the stations publish their stored calibrations, and store what they are given."""
        for station in self.scenario.stations:
            document = store.newest(station)
            if document is not None:
                self._publish_as_stored(document)
            CalibrationService(self, f'/{station}/store_calibration', station, store, self._stored.put)

    def _publish_as_stored(self, document: Document) -> None:
        self.scenario.stored[document.station] = document.calibration()

    def _listen(self) -> None:
        """Take in what stations and fusion have made of the sweeps."""

        def take(answers: Acknowledgements, name: str, back: str, messages: list[Any]) -> None:
            with self._lock:
                returned = answers.answered(name, max(m.sweep_id for m in messages))
                self._lock.notify_all()
            if returned:
                self.get_logger().info(back)

        for station in self.scenario.stations:
            on_beats = functools.partial(take, self._answers, station, f"station '{station}' answers again")
            qos.subscription(self, BeatFrequency, f'/{station}/beat_frequency', on_beats, qos.RELIABLE, batch=True)
        for pair in self._ranges.names:
            on_ranges = functools.partial(take, self._ranges, pair, f'{pair} has ranges again')
            qos.subscription(self, RangeEstimate, f'/{pair}/range', on_ranges, qos.RELIABLE, batch=True)

    def _on_request(self, message: SweepConfig) -> None:
        try:
            self._requests.take_mode(message.station, message.peer, message.mode, message.start_delay)
        except ConfigurationError as error:
            self.get_logger().warning(f'sweep request refused: {error}')

    def _on_schedule_request(self, message: SweepSchedule) -> None:
        try:
            self._requests.take_turns(from_message(message, Share))
        except ConfigurationError as error:
            self.get_logger().warning(f'schedule request refused: {error}')

    # --- what goes out ---

    def _publisher(self, event: Event) -> Any:
        """Return the publisher of an event."""
        peer = event.content.peer if is_per_peer(event.topic) else ''
        key = (event.topic, peer)
        if key not in self._publishers_of:
            profile = qos.LATCHED if is_latched(event.topic) else qos.RELIABLE
            self._publishers_of[key] = qos.publisher(
                self, message_class(message_type(event.topic)), event.topic, profile, instance=peer or None
            )
        return self._publishers_of[key]

    def _create_stream_publishers(self) -> None:
        topics = ['/site/temperature', '/site/pressure', '/site/humidity']
        topics += ['/reference/range'] if self.scenario.reference.enabled else []
        for station in self.scenario.stations:
            topics += [f'/{station}/if_samples', f'/{station}/status']
        for topic in topics:
            profile = qos.WEATHER if topic.startswith('/site/') else qos.RELIABLE
            self._publishers_of[topic, ''] = qos.publisher(self, message_class(message_type(topic)), topic, profile)

    def _publish(self, event: Event) -> None:
        publish(self._publisher(event), event.content)

    # --- the hardware thread ---

    def _run(self) -> None:
        try:
            self._wait_for_subscribers()
            while not self._stop.is_set():
                self._run_scenario()
                if self._stop.is_set() or self.settings.at_end != 'loop':
                    break
                last = self._timeline
                start = last.stamp(last.duration) + NANOSECONDS
                if self.settings.start == 'now':
                    start = max(start, self._now())  # above real time the stamps are ahead of the clock
                self._timeline = Timeline(
                    self.scenario, start, self.settings.mode_control == 'range', first_sweep_id=last.next_sweep_id
                )
                self._demands = list(self.scenario.schedule.demands)
                self._change_schedule()
                for event in self._timeline.opening():
                    self._publish(event)
                self._stop.wait(self.settings.settings_pause)
            self._state = 'ended'
            self._deliver()
        except Exception as error:
            self._failure = error
        self._finished.set()

    def _wait_for_subscribers(self) -> None:
        """Publish the settings, then wait until everyone who takes part is there, or the limit is over."""
        for event in self._timeline.opening():
            self._publish(event)
        deadline = time.monotonic() + self.settings.wait_for_subscribers
        while (missing := self._missing()) and time.monotonic() < deadline and not self._stop.wait(0.02):
            pass
        if missing and self.settings.wait_for_subscribers > 0 and not self._stop.is_set():
            self.get_logger().warning(f'starting without {", ".join(missing)}')
        self._stop.wait(max(_SETTLING, self.settings.settings_pause))
        for pair in self._ranges.names:
            if self.count_publishers(f'/{pair}/range') == 0:
                self._ranges.expect_nothing(pair)
        if self.settings.start == 'now':
            self._timeline.start = self._now()

    def _missing(self) -> list[str]:
        """Return what takes part in the graph and is not there yet."""
        missing = []
        for station in self.scenario.stations:
            found = self._publishers_of[f'/{station}/if_samples', ''].get_subscription_count()
            if found < self.settings.listeners:
                missing.append(f'{self.settings.listeners - found} subscriber(s) of /{station}/if_samples')
            elif self.settings.pace == 'subscribers' and self.count_publishers(f'/{station}/beat_frequency') == 0:
                missing.append(f'a publisher of /{station}/beat_frequency')
        if self.settings.mode_control == 'request':
            for pair in self.scenario.pairs:
                if not pair.hears_itself and self.count_publishers(f'/{pair.first}/sweep_request') == 0:
                    missing.append(f'a publisher of /{pair.first}/sweep_request')
        return missing

    def _use_stored(self) -> None:
        """Publish calibrations stored since, before the sweeps that follow."""
        changed = False
        while not self._stored.empty():
            self._publish_as_stored(self._stored.get())
            changed = True
        if changed:
            for event in self._timeline.calibrations(self._timeline.stamp(self._timeline.duration) - 1):
                self._publish(event)
            self._stop.wait(self.settings.settings_pause)

    def _run_scenario(self) -> None:
        timeline = self._timeline
        self._state = 'running'
        self._anchor = (time.monotonic(), timeline.start)
        self.get_logger().info(f'{timeline.sweep_count} sweeps of {len(self.scenario.pairs)} pair(s)')
        while not self._stop.is_set() and not timeline.finished:
            self._use_stored()
            for event in self._change_schedule():
                self._publish(event)
            self._change_modes()
            slots = timeline.slots(_BLOCK)
            if len(slots) == 0:
                self._publish_settings(timeline.due_mode_changes())
                continue
            timeline.advance(self._publish_block(timeline.render(slots)))

    def _publish_block(self, events: list[Event]) -> int:
        """Publish events at their time; return how many measurements went out before the end or a mode request."""
        measured: set[int] = set()
        for event in events:
            if event.sweep_id not in measured:
                if self._stop.is_set() or self._requests.modes(self._timeline):
                    break
                self._wait_until(event)
            self._publish(event)
            if event.sweep_id >= 0:
                measured.add(event.sweep_id)
                if self.settings.pace == 'subscribers' and isinstance(event.content, IfSweep):
                    with self._lock:
                        self._answers.sent(event.content.station, event.sweep_id)
                        self._ranges.sent(self._pair_of(event), event.sweep_id)
        return len(measured)

    def _wait_until(self, event: Event) -> None:
        """Wait until an event is due at the chosen pace."""
        if self.settings.pace == 'subscribers' and not self._all_silent():
            if event.sweep_id >= 0:
                window = self.settings.window
                self._wait_for_room(window, 2 * window)
            self._anchor = (time.monotonic(), event.stamp)
            return
        begun, stamp = self._anchor
        rate = self.settings.rate
        due = begun + (event.stamp - stamp) / NANOSECONDS / rate
        delay = due - time.monotonic()
        self._lag = max(0.0, -delay)
        if self._lag > _LAG_LIMIT:
            self.get_logger().warning(f'{self._lag:.1f} s behind the pace: going on from here')
            self._anchor = (time.monotonic(), event.stamp)
        elif delay > 0:
            self._stop.wait(delay)
            if rate != self.settings.rate:
                self._anchor = (time.monotonic(), event.stamp)

    def _all_silent(self) -> bool:
        with self._lock:
            return len(self._answers.silent) == len(self.scenario.stations)

    def _pair_of(self, event: Event) -> str:
        """Return 'first/second' of a sweep's pair."""
        one, other = event.content.station, event.content.peer
        name = f'{one}/{other}'
        return name if name in self._ranges.names else f'{other}/{one}'

    def _wait_for_room(self, window: int, of_ranges: int) -> None:
        """Wait until each station has fewer than `window` sweeps to do and each pair lacks fewer than `of_ranges`.

        Whoever is silent for `acknowledge_timeout` is waited for no longer.
        """
        parties = (
            (self._answers, window, "station '{}' does not answer: going on without it"),
            (self._ranges, of_ranges, 'no range of {}: going on without it'),
        )
        with self._lock:
            while not self._stop.is_set():
                full = [(answers, name, said) for answers, limit, said in parties for name in answers.full(limit)]
                if not full:
                    return
                self._lock.wait(0.05)
                for answers, name, said in full:
                    if answers.give_up(name, self.settings.acknowledge_timeout):
                        self.get_logger().warning(said.format(name))

    def _change_schedule(self) -> list[Event]:
        """Let the time division follow what is asked for; return what is granted now, if it changes."""
        demands = self._requests.demands()
        if demands != self._demands:
            self._demands = demands
            self._timeline.change_schedule(demands)
        return self._timeline.due_schedule_change()

    def _change_modes(self) -> None:
        for pair, (mode, delay) in self._requests.modes(self._timeline).items():
            settings = self.scenario.pairs[pair]
            self.get_logger().info(f'{settings.first}/{settings.second}: {mode.short_name} mode')
            self._publish_settings(self._timeline.change_mode(pair, mode, delay))

    def _publish_settings(self, events: list[Event]) -> None:
        for event in events:
            self._publish(event)
        self._stop.wait(self.settings.settings_pause)

    def _deliver(self) -> None:
        """Wait until subscribers have received everything, and evaluated it where they set the pace."""
        for publisher in self._publishers_of.values():
            if not self._stop.is_set():
                publisher.wait_for_all_acked(Duration(seconds=_DELIVERY_LIMIT))
        if self.settings.pace == 'subscribers':
            self._wait_for_room(1, 1)

    # --- diagnostics and end ---

    def _check_end(self) -> None:
        if not self._finished.is_set():
            return
        if self._failure is not None:
            raise self._failure
        if self.settings.at_end != 'stay':
            self.get_logger().info(f'scenario ended after {self._timeline.next_sweep_id} sweeps')
            raise Finished

    def _diagnose_schedule(self, status: Status) -> None:
        """Show what the time division gives to each pair, and warn of a pair that gets less than it asks for."""
        plan = self._timeline.schedule
        for number, pair in enumerate(self.scenario.pairs):
            name, rate, asked = f'{pair.first}/{pair.second}', plan.rate(number), plan.demands[number].rate
            waits = f'{rate:.4g} Hz, {plan.longest_wait(number):.4g} s at most between two sweeps'
            status.value(f'schedule of {name}', waits)
            if plan.falls_short(number):
                status.report(WARN, f'{name} gets {rate:.4g} Hz of {asked:g} Hz: too many pairs')

    def _diagnose(self, status: Status) -> None:
        with self._lock:
            silent, without = sorted(self._answers.silent), sorted(self._ranges.silent)
            outstanding, on_their_way = self._answers.outstanding(), self._ranges.outstanding()
        status.report(WARN if silent else OK, f'no answer from {", ".join(silent)}' if silent else self._state)
        if without:
            status.report(WARN, f'no range of {", ".join(without)}')
        if self._lag > 0.1:
            status.report(WARN, f'{self._lag:.2f} s behind the pace')
        self._diagnose_schedule(status)
        status.value('sweeps', self._timeline.next_sweep_id)
        status.value('sweeps of the scenario', self._timeline.sweep_count)
        status.value('outstanding', outstanding)
        status.value('without a range yet', on_their_way)
        status.value('lag [s]', self._lag)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the simulator node."""
    return run(Simulator, argv)


if __name__ == '__main__':
    sys.exit(main())
