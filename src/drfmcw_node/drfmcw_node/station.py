"""The station node: sweeps of one sensor-node in, beat frequencies, spectra and compressed sweeps out."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from drfmcw_msgs.msg import BeatFrequency, CompressedIfSamples, StationCalibration, StationStatus, SweepConfig

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros import qos
from drfmcw_ros.cli import Parser, guarded, split_ros_arguments
from drfmcw_ros.diagnostics import ERROR, WARN, Status
from drfmcw_ros.messages import NANOSECONDS, to_message
from drfmcw_ros.parameters import SettingsParameters

from .compression import compress
from .feed import Frame, Request
from .processing import StationProcessor, Sweep
from .sources import RecordingSource, Source, TcpSource, UdpSource
from .station_settings import Housekeeping, StationSettings, check_complete
from .sweep_node import SweepNode, antenna_frame, run_named

_GATHER = 0.8e-3  # of sweeps that are evaluated together [s]


@dataclasses.dataclass(frozen=True, slots=True)
class _Packed:
    """A compressed sweep; the fields of CompressedIfSamples."""

    station: str
    peer: str
    sweep_id: int
    full_scale: float
    iq: bool
    sample_count: int
    format: str
    data: bytes
    stamp: int
    frame_id: str


class StationNode(SweepNode):
    """One sensor-node's signal processing. Topics and parameters: README.md of this package."""

    def __init__(self, **kwargs: Any) -> None:
        """Declare the parameters, create the topics and start the source; `kwargs` go to rclpy's Node."""
        super().__init__('station', StationProcessor(), **kwargs)
        namespace = self.get_namespace().strip('/')
        named = StationSettings(station=namespace.rpartition('/')[2])
        self._set = SettingsParameters(self, StationSettings, named)
        settings = self._set.value
        check_complete(settings)
        self.station = settings.station
        within = namespace.rpartition('/')[2] == self.station
        self._prefix = '' if within else f'{self.station}/'
        parent = namespace.rpartition('/')[0] if within else namespace
        self._siblings = f'/{parent}/' if parent else '/'
        self._peers: set[str] = set()
        self._latched: dict[tuple[type, str], Any] = {}
        self._frame: Frame | None = None
        self._heard = 0
        self._link_quality = math.nan
        self._last_status = (0, 0)
        self._publish_results_of(self.station, self._prefix)
        self._packed = qos.publisher(self, CompressedIfSamples, self._topic('if_samples_compressed'), qos.RELIABLE)
        self._source: Source | None = None
        if settings.owns_sweep:
            self._own_sweep(settings)
        else:
            self._listen_to_settings(self._prefix)
            self._listen_to_sweeps(self._prefix, settings.source, _GATHER if settings.source == 'topic' else 0.0)
        self._start_diagnostics(hardware_id=self.station)
        if self._source is not None:
            self._source.start()

    def destroy_node(self) -> None:
        """End the source's thread, then the node."""
        if self._source is not None:
            self._source.stop()
        super().destroy_node()

    def _topic(self, name: str) -> str:
        return self._prefix + name

    # --- settings of whom it measures with ---

    def _concerns(self, station: str, peer: str) -> bool:
        return station == self.station

    def _add_sweep_config(self, settings: SweepSettings) -> None:
        super()._add_sweep_config(settings)
        self._follow_peer(settings.peer)

    def _follow_peer(self, peer: str) -> None:
        """Listen to the calibration of a peer that is new."""
        if peer != self.station and peer not in self._peers:
            self._peers.add(peer)
            self._listen_to_calibration(f'{self._siblings}{peer}/')

    # --- a sweep of its own: feed or recording ---

    def _own_sweep(self, settings: StationSettings) -> None:
        """Stand for the hardware: publish settings, calibration and status, follow requests."""
        self._status = qos.publisher(self, StationStatus, self._topic('status'), qos.RELIABLE)
        self._calibration_publisher = qos.publisher(self, StationCalibration, self._topic('calibration'), qos.LATCHED)
        self._config_publishers: dict[str, Any] = {}
        self.create_timer(1.0, self._publish_status)
        hooks = {'deliver': self._take_delivery, 'failed': self._source_failed}
        if settings.source == 'recording':
            self._source = RecordingSource(settings.recording, self.station, settings.recording_rate, **hooks)
            return
        self._sweep_parameters = SettingsParameters(
            self, SweepSettings, SweepSettings(self.station, ''), 'sweep', self._change_sweep
        )
        self._calibration_parameters = SettingsParameters(
            self, Calibration, Calibration(self.station), 'calibration', self._change_calibration
        )
        self._change_calibration(self._calibration_parameters.value)
        self._current: dict[str, SweepSettings] = {}
        self._change_sweep(self._sweep_parameters.value)
        for peer in settings.peers:
            self._follow_peer(peer)
            if peer != self.station:
                topic = f'{self._siblings}{peer}/beat_frequency'
                qos.subscription(self, BeatFrequency, topic, self._hear_peer, qos.RELIABLE)
        request = qos.latched_subscription(len(settings.peers))
        qos.subscription(self, SweepConfig, self._topic('sweep_request'), self._take_request, request)
        feed = TcpSource if settings.source == 'tcp' else UdpSource
        self._source = feed(settings.ip_address, settings.ip_port, **hooks)
        self.get_logger().info(f'listening for sweeps at {settings.source}://{settings.ip_address}:{self._source.port}')

    def _change_sweep(self, settings: SweepSettings) -> None:
        """Announce settings that were set by parameter."""
        with self._lock:
            for peer in self._set.value.peers:
                self._announce(dataclasses.replace(settings, peer=peer, stamp=0))

    def _change_calibration(self, calibration: Calibration) -> None:
        """Announce a calibration that was set by parameter."""
        self._announce_calibration(dataclasses.replace(calibration, stamp=0))

    def _announce(self, settings: SweepSettings) -> None:
        """Publish settings and use them from their stamp on; stamp 0: from now on."""
        first = settings.peer not in self._config_publishers
        if first:
            self._config_publishers[settings.peer] = qos.publisher(
                self, SweepConfig, self._topic('sweep_config'), qos.LATCHED, instance=_identifier(settings.peer)
            )
        if settings.stamp == 0 and not first:
            settings = dataclasses.replace(settings, stamp=self._now())
        settings = dataclasses.replace(settings, frame_id=self._frame_id(settings.frame_id))
        if self._set.value.has_feed:
            self._current[settings.peer] = settings
        self._processor.add_sweep_config(settings)
        self._config_publishers[settings.peer].publish(to_message(settings, SweepConfig))

    def _announce_calibration(self, calibration: Calibration) -> None:
        if calibration.station == self.station:
            # the first holds for all sweeps, whatever clock the digitiser stamps with
            if (Calibration, self.station) in self._latched and calibration.stamp == 0:
                calibration = dataclasses.replace(calibration, stamp=self._now())
            self._latched[Calibration, self.station] = calibration
            calibration = dataclasses.replace(calibration, frame_id=self._frame_id(calibration.frame_id))
            self._calibration_publisher.publish(to_message(calibration, StationCalibration))
        with self._lock:
            self._processor.add_calibration(calibration)

    def _take_request(self, message: SweepConfig) -> None:
        """Pass the wish for another mode to the hardware; what it then does shows in the frames."""
        if self._converted(message, SweepSettings, 'sweep_request') is None:
            return
        current = self._current.get(message.peer)
        if current is None or (current.mode, current.start_delay) == (message.mode, message.start_delay):
            return
        if not self._source.request(Request(message.mode, message.start_delay, message.peer)):
            self._warn('sweep_request: the digitiser cannot be told')

    def _take_delivery(self, items: Sequence[Any]) -> None:
        """Take what a source delivers, in its thread."""
        with self._lock:
            sweeps = []
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
                    else:
                        self._announce_calibration(item)
            self._process(sweeps)

    def _sweep_of(self, frame: Frame) -> Sweep:
        """Return a digitiser's frame as sweep; settings that it changed are announced first."""
        self._frame = frame
        peer = frame.peer or self._set.value.peers[0]
        stamp = frame.stamp or self._now()
        current = self._current.get(peer)
        if current is not None:
            delay = current.start_delay if math.isnan(frame.start_delay) else frame.start_delay
            if (current.mode, current.start_delay) != (frame.mode, delay):
                try:
                    changed = dataclasses.replace(current, mode=frame.mode, start_delay=delay, stamp=stamp)
                    self._announce(changed)
                except ConfigurationError as error:
                    self._warn(f'frame of sweep {frame.sweep_id}: {error}')
        return frame.sweep(self.station, peer, stamp, '')

    def _source_failed(self, error: Exception) -> None:
        self.get_logger().error(f'source: {" ".join(str(error).split()) or type(error).__name__}')

    def _hear_peer(self, message: BeatFrequency) -> None:
        if message.peer == self.station:
            self._heard += 1

    # --- results ---

    def _process(self, sweeps: list[Sweep]) -> None:
        """Evaluate a batch and publish what is wanted of it."""
        if not sweeps:
            return
        settings = self._set.value
        frame_id = settings.frame_id
        if settings.time_offset or frame_id or not sweeps[0].frame_id:
            shift = round(settings.time_offset * NANOSECONDS)
            sweeps = [
                dataclasses.replace(s, stamp=s.stamp + shift, frame_id=self._frame_id(s.frame_id)) for s in sweeps
            ]
        if settings.output != 'compressed':
            self._evaluate(sweeps)
        else:
            self._processor.sweeps += len(sweeps)
        if settings.output != 'results':
            self._publish_compressed(sweeps, settings.codec)

    def _publish_compressed(self, sweeps: Sequence[Sweep], codec: str) -> None:
        for sweep in sweeps:
            try:
                data = compress(np.asarray(sweep.samples), codec, sweep.iq)
            except ConfigurationError as error:
                self._warn(str(error))
                return
            fields = (sweep.station, sweep.peer, sweep.sweep_id, sweep.full_scale, sweep.iq)
            packed = _Packed(*fields, len(sweep.samples), codec, data, sweep.stamp, sweep.frame_id)
            self._packed.publish(to_message(packed, CompressedIfSamples))

    def _frame_id(self, given: str) -> str:
        return self._set.value.frame_id or given or antenna_frame(self.station)

    def _now(self) -> int:
        return self.get_clock().now().nanoseconds

    # --- once a second ---

    def _publish_status(self) -> None:
        with self._lock:
            sweeps, heard = self._processor.sweeps, self._heard
            expected = sweeps - self._last_status[0]
            arrived = heard - self._last_status[1]
            self._last_status = (sweeps, heard)
            self._link_quality = min(arrived / expected, 1.0) if expected else 0.0
            frame = self._frame
            status = Housekeeping(
                station=self.station,
                sweeps=sweeps,
                dropped=self._processor.dropped.total() + self._processor.weak,
                link_quality=self._link_quality,
                temperature=frame.temperature if frame is not None else math.nan,
                pll_locked=frame is None or frame.pll_locked,
                stamp=self._now(),
                frame_id=self._frame_id(''),
            )
        self._status.publish(to_message(status, StationStatus))

    def _diagnose_sweeps(self, status: Status) -> None:
        super()._diagnose_sweeps(status)
        if self._set.value.output != 'results':
            takers = self._packed.get_subscription_count()
            status.value(f'subscribers of {self._packed.topic_name}', takers)
            if not takers:
                status.report(WARN, 'nobody takes the compressed sweeps')

    def _diagnose_source(self, status: Status) -> None:
        source = self._source
        kind = self._set.value.source
        status.value('source', kind)
        super()._diagnose_source(status)
        if source is None:
            return
        status.value('connected', source.connected)
        for name, count in source.counts().items():
            status.value(name, count)
        if not source.connected:
            status.report(WARN if kind == 'recording' else ERROR, 'not connected')


def _identifier(name: str) -> str:
    """Return `name` as part of a parameter's name."""
    return ''.join(c if c.isalnum() or c == '_' else '_' for c in name)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a station node; return the exit status."""
    own, ros = split_ros_arguments(argv)
    parser = Parser(
        prog='drfmcw station',
        description='Signal processing of one sensor-node: sweeps in, beat frequencies and spectra out. '
        'All parameters: src/drfmcw_node/README.md.',
        epilog='Anything after --ros-args goes to ROS, for instance: --ros-args -p source:=tcp -p ip_port:=9000',
    )
    parser.add_argument('--station', metavar='NAME', help='name of the station (parameter station)')
    parser.add_argument('--config', metavar='FILE', help='ROS parameter file (YAML)')
    arguments = parser.parse_args(own)
    stations = {'station': arguments.station}
    return guarded(parser.prog, lambda: run_named(StationNode, stations, arguments.config, ros))


if __name__ == '__main__':
    raise SystemExit(main())
