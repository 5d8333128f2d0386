"""What stands for the hardware where no other process does: runs a source, publishes settings, calibration, status."""

import dataclasses
import math
import os
from collections.abc import Callable, Sequence
from typing import Any

from drfmcw_msgs.msg import BeatFrequency, StationCalibration, StationStatus, SweepConfig, SweepSchedule
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.schedule import LARGEST_PRIORITY, LARGEST_RATE, NO_TURNS, Share, Turns
from drfmcw_physics.settings import ConfigurationError, declared_parameters
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.calibration.document import Document
from drfmcw_ros.calibration.service import CalibrationService
from drfmcw_ros.calibration.store import CalibrationStore, state_directory
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import to_message
from drfmcw_ros.nodes.parameters import SettingsParameters

from .processing.records import Sweep
from .sources.feed import Frame, Request, TurnsRequest
from .sources.source import Source
from .station_settings import Housekeeping, StationNames, StationSettings
from .sweep_node import SweepNode


class SweepOwner:
    """Owns the sweep of a station whose source brings its settings along (a recording)."""

    def __init__(
        self,
        node: SweepNode,
        names: StationNames,
        settings: SettingsParameters[StationSettings],
        process: Callable[[list[Sweep]], None],
        source: type[Source],
        source_settings: Any,
    ) -> None:
        """Prepare, without topics and source.

        Args:
            node: to which topics, timers, lock and processor belong.
            names: of the station and its topics.
            settings: of the station node.
            process: evaluates a batch of sweeps; called with the node's lock held, in the source's thread.
            source: class of the source.
            source_settings: of the source.
        """
        self._node, self._names, self._settings, self._process = node, names, settings, process
        self._announced: dict[str, SweepSettings] = {}  # by peer
        self._granted: dict[str, Turns] = {}  # by peer
        self._config_publishers: dict[str, Publisher] = {}  # by peer
        self._schedule_publishers: dict[str, Publisher] = {}  # by peer
        self._calibrated = False
        self._frame: Frame | None = None
        self._heard = 0  # results of peers, which show that the peers hear this station
        self._last_status = (0, 0)
        self._make_source = lambda: source(
            names.station, source_settings, deliver=self._take, failed=self._source_failed
        )
        self._running: Source | None = None
        self._ends: list[Callable[[], Any]] = []  # what destroys the topics and the timer

    @property
    def source(self) -> Source:
        """Where the sweeps come from, between `start` and `stop`.

        Raises:
            RuntimeError: it does not run.
        """
        if self._running is None:
            raise RuntimeError('the source does not run')
        return self._running

    def start(self) -> None:
        """Create the topics, announce what is known and start the source.

        Raises:
            ConfigurationError: the source cannot be opened.
        """
        self._running = self._make_source()
        self._open()
        self._running.start()

    def stop(self) -> None:
        """End the source's thread, wait for it and withdraw the topics."""
        if self._running is not None:
            self._running.stop()
        self._running = None
        while self._ends:
            self._ends.pop()()
        self._config_publishers.clear()
        self._schedule_publishers.clear()
        self._granted.clear()

    def forget(self) -> None:
        """Forget what was announced."""
        self._announced.clear()
        self._calibrated = False

    def _open(self) -> None:
        node, names = self._node, self._names
        self._calibrations = self._published(StationCalibration, names.own('calibration'), qos.LATCHED)
        self._status = self._published(StationStatus, names.own('status'), qos.RELIABLE)
        timer = node.create_timer(1.0, self._publish_status)
        self._ends.append(lambda: node.destroy_timer(timer))

    def _published(self, kind: type, topic: str, profile: Any, instance: str | None = None) -> Publisher:
        made = qos.publisher(self._node, kind, topic, profile, instance)
        self._ends.append(lambda: self._node.destroy_publisher(made))
        return made

    def _subscribed(self, kind: type, topic: str, take: Callable[[Any], None], profile: Any) -> None:
        made = qos.subscription(self._node, kind, topic, take, profile)
        self._ends.append(lambda: self._node.destroy_subscription(made))

    # --- settings and calibrations ---

    def _announce(self, settings: SweepSettings) -> None:
        """Publish settings and use them from their stamp on; stamp 0 means from now on."""
        peer = settings.peer
        first = peer not in self._announced
        if peer not in self._config_publishers:
            topic = self._names.own('sweep_config')
            self._config_publishers[peer] = self._published(SweepConfig, topic, qos.LATCHED, _identifier(peer))
        if settings.stamp == 0 and not first:
            settings = dataclasses.replace(settings, stamp=self._node.now())
        settings = dataclasses.replace(settings, frame_id=self._frame_id(settings.frame_id))
        self._announced[peer] = settings
        self._node.processor.add_sweep_config(settings)
        self._config_publishers[peer].publish(to_message(settings, SweepConfig))

    def _announce_schedule(self, schedule: Share) -> None:
        """Publish what the time division grants from a stamp on."""
        peer = schedule.peer
        if peer not in self._schedule_publishers:
            topic = self._names.own('sweep_schedule')
            self._schedule_publishers[peer] = self._published(SweepSchedule, topic, qos.LATCHED, _identifier(peer))
        self._granted[peer] = schedule.turns
        schedule = dataclasses.replace(schedule, frame_id=self._frame_id(schedule.frame_id))
        self._schedule_publishers[peer].publish(to_message(schedule, SweepSchedule))

    def _announce_calibration(self, calibration: Calibration) -> None:
        """Use a calibration from its stamp on, 0 for from now on, and publish it if it is this station's."""
        if calibration.station == self._names.station:
            # the first one holds for all sweeps, whatever clock the digitiser stamps them with
            if self._calibrated and calibration.stamp == 0:
                calibration = dataclasses.replace(calibration, stamp=self._node.now())
            self._calibrated = True
            calibration = dataclasses.replace(calibration, frame_id=self._frame_id(calibration.frame_id))
            self._calibrations.publish(to_message(calibration, StationCalibration))
        with self._node.lock:
            self._node.processor.add_calibration(calibration)

    # --- sweeps ---

    def _take(self, items: Sequence[Any]) -> None:
        """Take what the source delivers, in the source's thread; settings hold for the sweeps that follow them."""
        with self._node.lock:
            sweeps: list[Sweep] = []
            for item in items:
                if isinstance(item, Frame):
                    sweeps.append(self._sweep_of(item))
                elif isinstance(item, Sweep):
                    sweeps.append(item)
                else:
                    self._process(sweeps)
                    sweeps = []
                    if isinstance(item, SweepSettings):
                        self._announce(item)
                    elif isinstance(item, Share):
                        self._announce_schedule(item)
                    else:
                        self._announce_calibration(item)
            self._process(sweeps)

    def _sweep_of(self, frame: Frame) -> Sweep:
        """Return a frame as a sweep; a source that brings its settings along delivers none."""
        raise TypeError(f'source {self.source.name} delivers frames, so it must not set brings_settings')

    def _source_failed(self, error: Exception) -> None:
        self._node.get_logger().error(f'source: {" ".join(str(error).split()) or type(error).__name__}')

    # --- once a second ---

    def _publish_status(self) -> None:
        with self._node.lock:
            processor, frame = self._node.processor, self._frame
            expected, arrived = processor.sweeps - self._last_status[0], self._heard - self._last_status[1]
            self._last_status = (processor.sweeps, self._heard)
            status = Housekeeping(
                station=self._names.station,
                sweeps=processor.sweeps,
                dropped=processor.dropped.total() + processor.weak,
                link_quality=min(arrived / expected, 1.0) if expected else 0.0,
                temperature=frame.temperature if frame is not None else math.nan,
                pll_locked=frame is None or frame.pll_locked,
                stamp=self._node.now(),
                frame_id=self._frame_id(''),
            )
            processor.add_board_temperature(status.station, status.stamp, status.temperature)
        self._status.publish(to_message(status, StationStatus))

    def _frame_id(self, given: str) -> str:
        return self._settings.value.antenna_frame(self._names.station, given)


class FeedOwner(SweepOwner):
    """Owns the sweep of a digitiser that feeds the node: settings are parameters, and requests reach the digitiser."""

    def __init__(
        self,
        node: SweepNode,
        names: StationNames,
        settings: SettingsParameters[StationSettings],
        process: Callable[[list[Sweep]], None],
        source: type[Source],
        source_settings: Any,
    ) -> None:
        """Declare the parameters of sweep and calibration; arguments as for `SweepOwner`.

        The stored calibration, if any, gives the defaults of its parameters.
        """
        store = CalibrationStore(state_directory(os.environ, settings.value.state_directory))
        stored = store.newest(names.station)
        super().__init__(node, names, settings, process, source, source_settings)
        self._passed: dict[str, Turns] = {}  # rate and priority asked of the digitiser, by peer
        self._sweep = SettingsParameters(
            node, SweepSettings, SweepSettings(names.station, ''), 'sweep', self._change_sweep
        )
        known = Calibration(names.station) if stored is None else stored.calibration()
        self._calibration = SettingsParameters(node, Calibration, known, 'calibration', self._change_calibration)
        CalibrationService(node, names.own('store_calibration'), names.station, store, self._use_document)

    def _open(self) -> None:
        super()._open()
        self._passed.clear()  # the source is a new one
        self._change_calibration(self._calibration.value)
        self._change_sweep(self._sweep.value)
        peers = self._settings.value.peers
        for peer in peers:
            if peer != self._names.station:
                topic = self._names.of_peer(peer, 'beat_frequency')
                self._subscribed(BeatFrequency, topic, self._hear, qos.RELIABLE)
        requests = qos.latched_subscription(len(peers))
        self._subscribed(SweepConfig, self._names.own('sweep_request'), self._take_request, requests)
        turns = self._names.own('schedule_request')
        self._subscribed(SweepSchedule, turns, self._take_schedule_request, requests)
        if self.source.address():
            self._node.get_logger().info(f'listening for sweeps at {self.source.address()}')

    def _change_sweep(self, settings: SweepSettings) -> None:
        """Announce settings that were set by parameter; while the source does not run, `start` will."""
        if self._running is None:
            return
        with self._node.lock:
            for peer in self._settings.value.peers:
                self._announce(dataclasses.replace(settings, peer=peer, stamp=0))

    def _change_calibration(self, calibration: Calibration) -> None:
        """Announce a calibration that was set by parameter; while the source does not run, `start` will."""
        if self._running is None:
            return
        self._announce_calibration(dataclasses.replace(calibration, stamp=0))

    def _use_document(self, document: Document) -> None:
        """Make a stored document's values those of the parameters, which announces them."""
        values = {name: getattr(document.calibration(), name) for name in declared_parameters(Calibration)}
        parameters = [Parameter(f'calibration.{name}', value=value) for name, value in values.items()]
        result = self._node.set_parameters_atomically(parameters)
        if not result.successful:
            raise ConfigurationError(f'version {document.version} is stored but not in use: {result.reason}')

    def _take_request(self, message: SweepConfig) -> None:
        """Pass the wish for another mode to the hardware; the frames show what the hardware then does."""
        if self._node.converted(message, SweepSettings, 'sweep_request') is None:
            return
        current = self._announced.get(message.peer)
        if current is None or (current.mode, current.start_delay) == (message.mode, message.start_delay):
            return
        if not self.source.request(Request(message.mode, message.start_delay, message.peer)):
            self._node.warn('sweep_request: the source cannot pass it to the digitiser')

    def _take_schedule_request(self, message: SweepSchedule) -> None:
        """Pass the wish for another rate to the hardware; the frames show what the hardware then grants."""
        asked = self._node.converted(message, Share, 'schedule_request')
        if asked is None or asked.peer not in self._announced:
            return
        if asked.turns == self._passed.get(asked.peer, NO_TURNS):
            return
        if not self.source.request(TurnsRequest(*asked.turns, asked.peer)):
            self._node.warn('schedule_request: the source cannot pass it to the digitiser')
            return
        self._passed[asked.peer] = asked.turns

    def _hear(self, message: BeatFrequency) -> None:
        if message.peer == self._names.station:
            self._heard += 1

    def _sweep_of(self, frame: Frame) -> Sweep:
        """Return a digitiser's frame as a sweep; settings that the digitiser changed are announced first."""
        self._frame = frame
        peer = frame.peer or self._settings.value.peers[0]
        stamp = frame.stamp or self._node.now()
        current = self._announced.get(peer)
        if current is not None:
            delay = current.start_delay if math.isnan(frame.start_delay) else frame.start_delay
            if (current.mode, current.start_delay) != (frame.mode, delay):
                try:
                    self._announce(dataclasses.replace(current, mode=frame.mode, start_delay=delay, stamp=stamp))
                except ConfigurationError as error:
                    self._node.warn(f'frame of sweep {frame.sweep_id}: {error}')
            turns = _granted(frame)
            if turns != self._granted.get(peer, NO_TURNS):
                self._announce_schedule(Share(self._names.station, peer, *turns, stamp))
        if frame.version < 2 and self._passed.get(peer, NO_TURNS) != NO_TURNS:
            self._node.warn(f'schedule_request: a digitiser of version {frame.version} of the feed knows no rates')
        return frame.sweep(self._names.station, peer, stamp, '')


def _granted(frame: Frame) -> Turns:
    """Return rate [Hz] and priority that a frame states, `NO_TURNS` where it states none that can be."""
    stated = 0.0 < frame.rate <= LARGEST_RATE and abs(frame.priority) <= LARGEST_PRIORITY
    return (frame.rate, frame.priority) if stated else NO_TURNS


def _identifier(name: str) -> str:
    """Return `name` as part of a parameter's name."""
    return ''.join(c if c.isalnum() or c == '_' else '_' for c in name)
