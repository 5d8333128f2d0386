"""Host node: samples the running graph for the pages, and calls the nodes' parameter services for them."""

import concurrent.futures
import dataclasses
import queue
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from drfmcw_msgs.msg import (
    BeatFrequency,
    IfSpectrum,
    RangeBatch,
    RangeEstimate,
    ReferenceRange,
    StationCalibration,
    StationStatus,
    SweepConfig,
)
from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import FluidPressure, RelativeHumidity, Temperature

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import from_message, stamp_ns
from drfmcw_ros.graph.topics import DISPLAYED
from drfmcw_ros.nodes.diagnostics import Diagnostics, Status

from .files.calibrations import Calibrations
from .state.decoding import batch_readings, range_reading
from .state.readings import Diagnostic, Health, Line, LogLine, RangeReading, SiteReading, SpectrumReading, decimated
from .state.store import Store

_TICK = 1.0 / 30.0  # between two samplings [s]
_DISCOVERY = 1.0  # between two looks for new stations and pairs [s]
_PEERS = 16  # latched settings kept per station
_BINS = 512  # of a spectrum that is shown
_TEXT = 2000  # letters kept of a text from outside
_LOGS = 300  # log lines taken at a time
_RANGES = 'drfmcw_msgs/msg/RangeEstimate'
_STATION_TYPES = {
    'drfmcw_msgs/msg/StationStatus': 'status',
    'drfmcw_msgs/msg/BeatFrequency': 'beat_frequency',
    'drfmcw_msgs/msg/SweepConfig': 'sweep_config',
}
_SITE = {
    '/site/temperature': (Temperature, 'temperature'),
    '/site/pressure': (FluidPressure, 'fluid_pressure'),
    '/site/humidity': (RelativeHumidity, 'relative_humidity'),
}


def newest(depth: int) -> QoSProfile:
    """Return the profile of a subscription that keeps the `depth` newest messages and slows no publisher."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.VOLATILE,
    )


@dataclasses.dataclass
class _Sampled:
    """A subscription that no executor serves: the middleware keeps the newest messages, and each tick takes them."""

    subscription: Subscription
    message_type: type
    take: Callable[[list[Any], list[int]], None]
    depth: int
    always: bool  # also without a message
    raw: bool  # messages stay serialised

    def poll(self) -> None:
        """Take what has arrived since the last time, at most what the middleware kept."""
        messages: list[Any] = []
        received: list[int] = []
        while len(messages) < self.depth:
            taken = self.subscription.handle.take_message(self.message_type, self.raw)
            if taken is None:
                break
            messages.append(taken[0])
            received.append(taken[1]['received_timestamp'])
        if messages or self.always:
            self.take(messages, received)


class HostNode(Node):
    """Thin shell around `Store`: subscribes to what is found in the graph and hands it over, 30 times a second."""

    def __init__(
        self,
        store: Store,
        calibrations: Calibrations,
        on_ready: Callable[['HostNode'], Callable[[], None]],
        **kwargs: Any,
    ) -> None:
        """Create the node.

        Args:
            store: takes what arrives.
            calibrations: keeps those that stations publish.
            on_ready: called with the node at the end, starts the pages; returns what ends them.
            kwargs: passed on to rclpy.
        """
        super().__init__('host', **kwargs)
        self.store = store
        self._calibrations = calibrations
        # its subscriptions are in no executor, so that a stream of 1000 messages/s does not wake Python 1000 times/s
        self._sampler = rclpy.create_node(
            'host_sampler', use_global_arguments=False, enable_rosout=False, start_parameter_services=False
        )
        self._sampled: dict[str, _Sampled] = {}
        self._shown: set[str] = set()  # stations whose signals a browser shows
        self._stations: set[str] = set()
        self._pairs: set[str] = set()
        self._heard: dict[str, str] = {}  # stream of the contract: the topic that is subscribed to, it or its companion
        self._orders: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.nodes: list[str] = []
        """Full names of the nodes in the graph."""
        for topic, (kind, field) in _SITE.items():
            self._listen_to_site(topic, kind, field)
        qos.subscription(self, DiagnosticArray, '/diagnostics', self._take_diagnostics, qos.RELIABLE)
        self._sample('/reference/range', ReferenceRange, self._take_references, newest(400))
        # nodes keep their last lines for 10 s for who comes late
        self._sample('/rosout', Log, self._take_logs, qos.latched_subscription(_LOGS))
        Diagnostics(self, 'host').add('Pages', self._diagnose)
        self.create_timer(_DISCOVERY, self._discover)
        self.create_timer(_TICK, self._tick)
        self._discover()
        self._end = on_ready(self)

    def do(self, work: Callable[[], Any]) -> concurrent.futures.Future[Any]:
        """Run `work` in the node's own thread within a tick; the future gets what it returns or raises."""
        future: concurrent.futures.Future[Any] = concurrent.futures.Future()

        def order() -> None:
            try:
                future.set_result(work())
            except Exception as error:
                future.set_exception(error)

        self._orders.put(order)
        return future

    def _sample(
        self,
        topic: str,
        kind: type,
        take: Callable[[list[Any], list[int]], None],
        profile: QoSProfile,
        always: bool = False,
        raw: bool = False,
    ) -> None:
        created = self._sampler.create_subscription(kind, topic, lambda _: None, profile)
        self._sampled[topic] = _Sampled(created, kind, take, profile.depth, always, raw)

    def _unsample(self, topic: str) -> None:
        self._sampler.destroy_subscription(self._sampled.pop(topic).subscription)

    def _listen_to_site(self, topic: str, kind: type, field: str) -> None:
        def take(message: Any) -> None:
            value, stamp = float(getattr(message, field)), stamp_ns(message.header.stamp)
            self.store.site[topic] = SiteReading(value, stamp, self.store.clock())

        qos.subscription(self, kind, topic, take, qos.WEATHER)

    def _discover(self) -> None:
        """Follow the stations and pairs that somebody publishes; names come from topics, never from messages."""
        for topic, kinds in self.get_topic_names_and_types():
            parts = topic.strip('/').split('/')
            if _RANGES in kinds and len(parts) == 3 and parts[2] == 'range':
                self._follow_pair(parts[0], parts[1])
            for kind in kinds:
                if kind in _STATION_TYPES and len(parts) == 2 and parts[1] == _STATION_TYPES[kind]:
                    self._follow_station(parts[0])
        for name in self._pairs:
            self._hear_ranges(name)
        for name in self._shown:
            self._hear_signals(name)
        self.nodes = sorted(
            f'{space.rstrip("/")}/{name}' for name, space in self.get_node_names_and_namespaces() if name
        )

    def _follow_pair(self, first: str, second: str) -> None:
        name = f'{first}/{second}'
        if name in self._pairs or self.store.pair(name) is None:
            return
        self._pairs.add(name)
        self._follow_station(first)
        self._follow_station(second)

    def _companion(self, stream: str) -> str | None:
        """Return the topic to take for a stream: its companion for displays where somebody publishes that.

        A reader of every message costs the publisher time before it comes to the next one. But a recording that is
        played may have the stream alone. None where the right one is subscribed to.
        """
        space, _, last = stream.rpartition('/')
        companion = f'{space}/{DISPLAYED[last]}'
        topic = companion if self.count_publishers(companion) else stream
        heard = self._heard.get(stream)
        if heard == topic:
            return None
        if heard is not None:
            self._unsample(heard)
        self._heard[stream] = topic
        return topic

    def _hear_ranges(self, name: str) -> None:
        topic = self._companion(f'/{name}/range')
        if topic == f'/{name}/range':
            self._sample(topic, RangeEstimate, lambda m, t: self._take_ranges(name, m, t), newest(400), True, True)
        elif topic is not None:
            self._sample(topic, RangeBatch, lambda m, t: self._take_batches(name, m, t), newest(100), True)

    def _hear_signals(self, name: str) -> None:
        for last, kind, taker, depth in (
            ('if_spectrum', IfSpectrum, self._spectrum_taker, 4),
            ('beat_frequency', BeatFrequency, self._line_taker, 8),
        ):
            topic = self._companion(f'/{name}/{last}')
            if topic is not None:
                self._sample(topic, kind, taker(name), newest(depth))

    def _follow_station(self, name: str) -> None:
        if name in self._stations or self.store.station(name) is None:
            return
        self._stations.add(name)
        qos.subscription(self, SweepConfig, f'/{name}/sweep_config', lambda m: self._take_settings(name, m), _latched())
        qos.subscription(
            self, StationCalibration, f'/{name}/calibration', lambda m: self._take_calibration(name, m), _latched()
        )
        self._sample(f'/{name}/status', StationStatus, lambda m, t: self._take_status(name, m, t), qos.RELIABLE)

    def _tick(self) -> None:
        """Take in the newest of everything, and do what the pages asked for."""
        while not self._orders.empty():
            self._orders.get()()
        self._follow_signals()
        for sampled in list(self._sampled.values()):
            sampled.poll()

    def _follow_signals(self) -> None:
        """Subscribe to spectra and beat frequencies while a browser shows them, and only then."""
        if self.store.signals_wanted:
            for name in self._stations - self._shown:
                self._shown.add(name)
                self._hear_signals(name)
        elif self._shown:
            for stream in [f'/{name}/{last}' for name in self._shown for last in ('if_spectrum', 'beat_frequency')]:
                self._unsample(self._heard.pop(stream))
            with self.store.lock:
                for name in self._shown:
                    self.store.stations[name].forget_signals()
            self._shown.clear()

    def _take_ranges(self, name: str, messages: list[bytes], received: list[int]) -> None:
        try:
            readings = [range_reading(data) for data in messages]
        except ValueError as error:
            self.get_logger().warning(f'ranges of {name}: {error}', throttle_duration_sec=10.0)
            return
        self.store.add_ranges(name, readings, received)

    def _take_batches(self, name: str, messages: list[RangeBatch], received: list[int]) -> None:
        readings: list[RangeReading] = []
        arrived: list[int] = []
        for message, at in zip(messages, received, strict=True):
            try:
                of_batch = batch_readings(message)
            except ValueError as error:
                self.get_logger().warning(f'ranges of {name}: {error}', throttle_duration_sec=10.0)
                continue
            readings += of_batch
            arrived += [at - round(age * 1e9) for age in message.age]
        self.store.add_ranges(name, readings, arrived)

    def _take_references(self, messages: list[Any], received: list[int]) -> None:
        for m in messages:
            self.store.add_reference(stamp_ns(m.header.stamp), m.range, m.header.frame_id)

    def _take_logs(self, messages: list[Any], received: list[int]) -> None:
        self.store.add_logs([LogLine(m.stamp.sec, m.level, m.name[:_TEXT], m.msg[:_TEXT]) for m in messages])

    def _peer(self, station: str, message: Any) -> str | None:
        """Return the peer that a message names where it is a station of this graph, which no hostile text is."""
        return message.peer if message.peer in self._stations and message.station == station else None

    def _line_taker(self, name: str) -> Callable[[list[Any], list[int]], None]:
        def take(messages: list[Any], received: list[int]) -> None:
            now = self.store.clock()
            with self.store.lock:
                station = self.store.stations[name]
                for peer, m in {self._peer(name, m): m for m in messages}.items():  # the newest of each peer
                    if peer is not None:
                        line = Line(m.sweep_id, m.flags, m.frequency, m.frequency_std, m.power, m.snr)
                        station.add_line(peer, line, now)

        return take

    def _spectrum_taker(self, name: str) -> Callable[[list[Any], list[int]], None]:
        def take(messages: list[Any], received: list[int]) -> None:
            now = self.store.clock()
            with self.store.lock:
                station = self.store.stations[name]
                for peer, m in {self._peer(name, m): m for m in messages}.items():  # the newest of each peer
                    if peer is None or not len(m.magnitude):
                        continue
                    shown, group = decimated(np.asarray(m.magnitude, dtype=float), _BINS)
                    start = m.start_frequency + (group - 1) / 2 * m.frequency_step
                    spectrum = SpectrumReading(m.sweep_id, start, group * m.frequency_step, shown)
                    station.add_spectrum(peer, spectrum, now)

        return take

    def _take_settings(self, name: str, message: Any) -> None:
        kept = self.store.stations[name].settings
        if message.station != name or (message.peer not in kept and len(kept) >= _PEERS):
            return
        try:
            settings = from_message(message, SweepSettings)
        except ConfigurationError as error:
            self.get_logger().warning(f'settings of {name}: {error}', throttle_duration_sec=10.0)
            return
        with self.store.lock:
            kept[settings.peer] = settings

    def _take_calibration(self, name: str, message: Any) -> None:
        try:
            calibration = from_message(message, Calibration)
            if calibration.station != name:
                raise ConfigurationError(f'is of station {calibration.station[:100]!r}')
            self._calibrations.see(calibration)
        except ConfigurationError as error:
            self.get_logger().warning(f'calibration of {name}: {error}', throttle_duration_sec=10.0)
            return
        with self.store.lock:
            self.store.stations[name].calibration = calibration
            self.store.stations[name].calibration_stamp = calibration.stamp

    def _take_status(self, name: str, messages: list[Any], received: list[int]) -> None:
        for m, arrived in zip(messages, received, strict=True):
            health = Health(m.temperature, m.pll_locked, m.sweeps, m.dropped, m.link_quality)
            self.store.add_health(name, health, stamp_ns(m.header.stamp), arrived)

    def _take_diagnostics(self, array: Any) -> None:
        now = self.store.clock()
        for s in array.status:
            values = tuple((v.key[:_TEXT], v.value[:_TEXT]) for v in list(s.values)[:100])
            level = int.from_bytes(s.level, 'little') if isinstance(s.level, bytes) else int(s.level)
            name, message, hardware = (text[:_TEXT] for text in (s.name, s.message, s.hardware_id))
            self.store.add_diagnostic(Diagnostic(level, name, message, hardware, values, now))

    def _diagnose(self, status: Status) -> None:
        status.value('pairs', len(self._pairs))
        status.value('stations', len(self._stations))
        status.value('stations whose signals are shown', len(self._shown))

    def destroy_node(self) -> None:
        """End the pages first."""
        if hasattr(self, '_end'):
            self._end()
        self._sampler.destroy_node()
        super().destroy_node()


def _latched() -> QoSProfile:
    return qos.latched_subscription(_PEERS)
