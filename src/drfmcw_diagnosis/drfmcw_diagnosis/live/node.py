"""Watch node: raw sweeps of both stations in, diagnostics out when the model stops explaining them."""

import dataclasses
import functools
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drfmcw_msgs.msg import (
    CompressedIfSamples,
    IfSamples,
    ReferenceRange,
    StationCalibration,
    StationStatus,
    SweepConfig,
)
from rclpy.node import Node
from sensor_msgs.msg import FluidPressure, RelativeHumidity, Temperature

from drfmcw_node.compression import CompressionError, decompress_message
from drfmcw_node.processing.records import Sweep
from drfmcw_node.station_settings import SWEEP_TOPICS
from drfmcw_physics.settings import ConfigurationError, parameter
from drfmcw_ros.commands.cli import Parser, guarded, split_ros_arguments
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import from_message
from drfmcw_ros.nodes.diagnostics import OK, STALE, WARN, Diagnostics, Status
from drfmcw_ros.nodes.parameters import SettingsParameters
from drfmcw_ros.nodes.runner import run
from drfmcw_ros.work.processes import Background, WorkFailed

from . import watch
from .limits import NODE
from .watch import Judgement, Watch, WatchSettings
from .window import Window, WindowSettings

_LEVELS = {watch.OK: OK, watch.WARN: WARN, watch.STALE: STALE}
_SITE_TYPES = {
    '/site/temperature': Temperature,
    '/site/pressure': FluidPressure,
    '/site/humidity': RelativeHumidity,
    '/reference/range': ReferenceRange,
}


@dataclasses.dataclass(frozen=True)
class WatchedSettings:
    """Which pair is watched, and where findings go."""

    pair: str = parameter(
        'master/slave',
        description="stations whose sweeps are watched: 'first/second'; 'name/name' hears itself",
        structural=True,
    )
    first_source: str = parameter(
        'topic', choices=SWEEP_TOPICS, structural=True, description='how the sweeps of the first station come'
    )
    second_source: str = parameter(
        'topic', choices=SWEEP_TOPICS, structural=True, description='how the sweeps of the second station come'
    )
    findings: str = parameter(
        '', description='directory in which each finding is kept; empty: they are only published', structural=True
    )

    def __post_init__(self) -> None:
        """Refuse names that are no pair."""
        names = self.pair.split('/')
        if len(names) != 2 or not all(names):
            raise ConfigurationError(f"pair: '{self.pair}' is not 'first/second'")


class WatchNode(Node):
    """Thin shell around `Watch`. Topics and parameters: README.md of this package."""

    def __init__(self, pair: str | None = None, findings: str | None = None, **kwargs: Any) -> None:
        """Create the node; arguments replace the defaults of the parameters of those names.

        Raises:
            ConfigurationError: a value given at start is wrong, or the directory cannot be made.
        """
        super().__init__('watch', **kwargs)
        given = {name: value for name, value in (('pair', pair), ('findings', findings)) if value}
        watched = SettingsParameters(self, WatchedSettings, WatchedSettings(**given)).value
        window = SettingsParameters(self, WindowSettings, prefix='window', on_change=self._change_window)
        settings = SettingsParameters(self, WatchSettings, on_change=self._change)
        self._watch = Watch(Window(watched.pair, window.value), settings.value, _directory(watched.findings))
        self._finding: Judgement | None = None  # that was logged
        self._background = Background(watch.judge)
        sources = (watched.first_source, watched.second_source)
        for station, source in dict(zip(watched.pair.split('/'), sources, strict=True)).items():
            self._listen(SweepConfig, f'/{station}/sweep_config', qos.latched_subscription(NODE.peers))
            self._listen(StationCalibration, f'/{station}/calibration', qos.latched_subscription(NODE.peers))
            self._listen(StationStatus, f'/{station}/status', qos.RELIABLE)
            if source == 'topic':
                kind, topic, take = IfSamples, f'/{station}/if_samples', self._take_sweeps
            else:
                kind, topic, take = CompressedIfSamples, f'/{station}/if_samples_compressed', self._take_compressed
            qos.stream(self, kind, topic, take, qos.DEEP, NODE.gather)
        for topic, kind in _SITE_TYPES.items():
            qos.readings(self, kind, topic, functools.partial(self._take, topic), batch=True)
        Diagnostics(self, watched.pair).add(f'Model {watched.pair}', self._diagnose)
        self.create_timer(NODE.tick, self._tick)

    def _listen(self, kind: type, topic: str, profile: Any) -> None:
        qos.subscription(self, kind, topic, functools.partial(self._take, topic), profile, batch=True)

    def _change_window(self, settings: WindowSettings) -> None:
        self._watch.window.settings = settings

    def _change(self, settings: WatchSettings) -> None:
        self._watch.settings = settings

    def _take(self, topic: str, messages: Sequence[Any]) -> None:
        for message in messages:
            try:
                self._watch.window.take(topic, message)
            except ConfigurationError as error:
                self.get_logger().error(f"refused {type(message).__name__} of '{message.station}': {error}")

    def _take_sweeps(self, messages: Sequence[IfSamples]) -> None:
        self._watch.window.add([from_message(message, Sweep) for message in messages])

    def _take_compressed(self, messages: Sequence[CompressedIfSamples]) -> None:
        for message in messages:
            try:
                self._watch.window.add([decompress_message(message)])
            except (CompressionError, ConfigurationError) as error:
                text = f'compressed sweep {message.sweep_id} of {message.station}: {error}'
                self.get_logger().warning(text, throttle_duration_sec=10.0)

    def _tick(self) -> None:
        """Take in what a look said, or begin one that is due; both leave the executor within milliseconds."""
        now = time.monotonic()
        try:
            for judgement in self._background.results():
                self._watch.take(judgement, now)
        except WorkFailed as error:
            self._watch.take(Judgement(f'the process that judges failed: {error}'), now)
        self._log()
        if not self._background.busy and (order := self._watch.order(now)) is not None:
            self._background.start(order)

    def _log(self) -> None:
        finding = self._watch.finding
        if finding is self._finding:
            return
        if finding is not None:
            self.get_logger().warning(self._watch.described(finding))
        else:
            self.get_logger().info('the model explains the sweeps again')
        self._finding = finding

    def _diagnose(self, status: Status) -> None:
        statement = self._watch.statement(time.monotonic())
        status.report(_LEVELS[statement.level], statement.message)
        for key, value in statement.values.items():
            status.value(key, value)

    def destroy_node(self) -> None:
        """End a look that is under way."""
        if hasattr(self, '_background'):
            self._background.close()
        super().destroy_node()


def _directory(path: str) -> Path | None:
    """Return the directory for findings, made where it was not there; None for none.

    Raises:
        ConfigurationError: it cannot be made.
    """
    if not path:
        return None
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f'findings: {path}: {error.strerror}') from None
    return Path(path).resolve()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; return the exit status."""
    own, ros = split_ros_arguments(argv)
    parser = Parser(
        prog='drfmcw watch',
        description='Watch the raw sweeps of a pair of stations in the running graph and publish diagnostics when the '
        'model of their settings, calibrations, weather and reference stops explaining them. All parameters: '
        'src/drfmcw_diagnosis/README.md.',
        epilog='Anything after --ros-args goes to ROS, for instance: --ros-args -p false_alarm_rate:=1e-5',
    )
    parser.add_argument('--pair', metavar='FIRST/SECOND', help='pair of stations (parameter pair)')
    parser.add_argument('--findings', metavar='DIR', help='keep each finding there (parameter findings)')
    arguments = parser.parse_args(own)
    return guarded(parser.prog, lambda: run(WatchNode, ros, pair=arguments.pair, findings=arguments.findings))


if __name__ == '__main__':
    sys.exit(main())
