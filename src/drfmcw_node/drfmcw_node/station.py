"""The station node: sweeps of one sensor-node in, beat frequencies, spectra and compressed sweeps out."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from drfmcw_msgs.msg import CompressedIfSamples

from drfmcw_physics.rules.history import LIVE
from drfmcw_physics.rules.plausible import printable
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.commands.cli import Parser, guarded, split_ros_arguments
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import NANOSECONDS, to_message
from drfmcw_ros.nodes.diagnostics import ERROR, WARN, Status
from drfmcw_ros.nodes.parameters import SettingsParameters

from .compression import compress
from .processing.processor import StationProcessor
from .processing.records import Sweep
from .sources.source import Source
from .station_settings import StationNames, StationSettings, check_complete, is_station_name
from .sweep_node import SweepNode, run_named
from .sweep_owner import FeedOwner, SweepOwner

_MOST_PEERS = 64  # each makes a subscription
_LONGEST_REASON = 200  # in a diagnostics value
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
        """Declare the parameters, then begin; `kwargs` go to rclpy's Node."""
        super().__init__('station', StationProcessor(kept=LIVE), **kwargs)
        namespace = self.get_namespace().strip('/')
        self._settings = SettingsParameters(self, StationSettings, StationSettings(namespace.rpartition('/')[2]))
        settings = self._settings.value
        classes = dict.fromkeys(source.settings for source in Source.registry.values())
        source_settings: dict[type, Any] = {cls: SettingsParameters(self, cls).value for cls in classes}
        check_complete(settings)
        self._names = StationNames.of(settings.station, namespace)
        self._peers: set[str] = set()
        self._owner: SweepOwner | None = None
        if settings.owns_sweep:
            source = Source.registry[settings.source]
            owner = SweepOwner if source.brings_settings else FeedOwner
            values = source_settings[source.settings]
            self._owner = owner(self, self._names, self._settings, self._process, source, values)
        self._start_diagnostics(hardware_id=self._names.station)
        self.begin()

    def configure(self) -> None:
        """Create the topics."""
        super().configure()
        settings = self._settings.value
        self._peers.clear()
        self._publish_results_of(self._names.station, self._names.prefix)
        packed = self._names.own('if_samples_compressed')
        self._packed = qos.publisher(self, CompressedIfSamples, packed, qos.RELIABLE)
        if settings.owns_sweep:
            for peer in settings.peers if settings.has_feed else ():
                self._follow_peer(peer)
        else:
            self._listen_to_settings(self._names.prefix)
            gather = _GATHER if settings.source == 'topic' else 0.0
            self._listen_to_sweeps(self._names.prefix, settings.source, gather)

    def activate(self) -> None:
        """Start the source, and announce what it stands for."""
        if self._owner is not None:
            self._owner.start()

    def deactivate(self) -> None:
        """End the source's thread and withdraw what it stands for."""
        if self._owner is not None:
            self._owner.stop()

    def cleanup(self) -> None:
        """Forget what came in, and what was announced."""
        super().cleanup()
        if self._owner is not None:
            self._owner.forget()

    def destroy_node(self) -> None:
        """End the source's thread, then the node."""
        if self._owner is not None:
            self._owner.stop()
        super().destroy_node()

    # --- settings and peers ---

    def _concerns(self, station: str, peer: str) -> bool:
        if station != self._names.station or peer == station or peer in self._peers:
            return station == self._names.station
        if is_station_name(peer) and len(self._peers) < _MOST_PEERS:
            return True
        self.warn(f'sweep_config: peer {printable(peer)} is no name of a topic, or one too many')
        return False

    def _add_sweep_config(self, settings: SweepSettings) -> None:
        super()._add_sweep_config(settings)
        self._follow_peer(settings.peer)

    def _follow_peer(self, peer: str) -> None:
        """Listen to the calibration of a peer that is new."""
        if peer != self._names.station and peer not in self._peers:
            self._peers.add(peer)
            self._listen_to_calibration(self._names.of_peer(peer, ''))

    # --- results ---

    def _process(self, sweeps: list[Sweep]) -> None:
        """Evaluate a batch and publish what is wanted of it."""
        if not sweeps:
            return
        settings = self._settings.value
        if settings.time_offset or settings.frame_id or not sweeps[0].frame_id:
            shift = round(settings.time_offset * NANOSECONDS)
            sweeps = [
                dataclasses.replace(
                    s, stamp=s.stamp + shift, frame_id=settings.antenna_frame(self._names.station, s.frame_id)
                )
                for s in sweeps
            ]
        if settings.output != 'compressed':
            self._evaluate(sweeps)
        else:
            self.processor.sweeps += len(sweeps)
        if settings.output != 'results':
            self._publish_compressed(sweeps, settings.codec)

    def _publish_compressed(self, sweeps: Sequence[Sweep], codec: str) -> None:
        for sweep in sweeps:
            try:
                data = compress(np.asarray(sweep.samples), codec, sweep.iq)
            except ConfigurationError as error:
                self.warn(str(error))
                return
            fields = (sweep.station, sweep.peer, sweep.sweep_id, sweep.full_scale, sweep.iq)
            packed = _Packed(*fields, len(sweep.samples), codec, data, sweep.stamp, sweep.frame_id)
            self._packed.publish(to_message(packed, CompressedIfSamples))

    # --- once a second ---

    def _diagnose_sweeps(self, status: Status) -> None:
        super()._diagnose_sweeps(status)
        if self._settings.value.output != 'results':
            takers = self._packed.get_subscription_count()
            status.value(f'subscribers of {self._packed.topic_name}', takers)
            if not takers:
                status.report(WARN, 'nobody takes the compressed sweeps')

    def _diagnose_source(self, status: Status) -> None:
        status.value('source', self._settings.value.source)
        super()._diagnose_source(status)
        if self._owner is None:
            return
        source = self._owner.source
        status.value('connected', source.connected)
        for name, count in source.counts().items():
            status.value(name, count)
        if source.trouble():
            status.value('last refusal', source.trouble()[:_LONGEST_REASON])
        if source.caution():
            status.report(WARN, source.caution())
        if not source.connected:
            status.report(WARN if source.brings_settings else ERROR, 'not connected')


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
