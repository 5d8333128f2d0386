"""Foxglove bridge: topics in, unread, to Foxglove and Lichtblick over a WebSocket; nothing comes back."""

import collections
import dataclasses
import functools
import queue
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.node import Node

from drfmcw_physics.settings import ConfigurationError, parameter
from drfmcw_ros.bag.definitions import reason, typestore
from drfmcw_ros.commands.cli import Parser, guarded, split_ros_arguments
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import message_class
from drfmcw_ros.graph.topics import is_latched
from drfmcw_ros.nodes.diagnostics import WARN, Diagnostics, Status
from drfmcw_ros.nodes.parameters import SettingsParameters
from drfmcw_ros.nodes.runner import run

from .settings import is_loopback, refuse_half_a_pair

_LOOK_PERIOD = 1.0  # how often new topics are looked for [s]
_ANSWER_PERIOD = 0.05  # how often clients' wishes are carried out [s]


@dataclasses.dataclass(frozen=True)
class FoxgloveSettings:
    """Where the bridge listens."""

    address: str = parameter(
        '127.0.0.1', description='local address; any but a loopback one needs certificate and key', structural=True
    )
    port: int = parameter(8765, bounds=(1, 65535), description='TCP port', structural=True)
    certificate: str = parameter('', description='file of the certificate for TLS (PEM)', structural=True)
    key: str = parameter('', description="file of the certificate's private key (PEM, PKCS #8)", structural=True)

    def __post_init__(self) -> None:
        """Refuse half a key pair, and unencrypted ranges on a network."""
        refuse_half_a_pair(self.certificate, self.key)
        if not is_loopback('address', self.address) and not self.certificate:
            raise ConfigurationError(
                f'address = {self.address} is no loopback address: certificate and key must be given'
            )


class _Wishes:
    """What clients ask for, as the library's threads report it; the node's own thread carries it out."""

    def __init__(self) -> None:
        self.arrived: queue.SimpleQueue[tuple[bool, int, str]] = queue.SimpleQueue()

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self.arrived.put((True, client.id, channel.topic))

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        self.arrived.put((False, client.id, channel.topic))


class FoxgloveBridge(Node):
    """Offers every topic whose type is known; subscribes to those that a client shows, and to nothing else."""

    def __init__(self, given: FoxgloveSettings | None = None, **kwargs: Any) -> None:
        """Listen; `given` replaces the parameters' defaults, `kwargs` go to rclpy's Node.

        Raises:
            ConfigurationError: the library lacks, the address cannot be used, or certificate or key cannot be read.
        """
        super().__init__('foxglove_bridge', **kwargs)
        self._settings = SettingsParameters(self, FoxgloveSettings, given, on_change=lambda settings: None)
        try:
            import foxglove
        except ModuleNotFoundError:
            raise ConfigurationError(
                'foxglove is not installed: pip install foxglove-sdk, or use ros-jazzy-foxglove-bridge'
            ) from None
        self._library: Any = foxglove
        self._sink = foxglove.Context()
        self._offered: dict[str, Any] = {}
        self._kinds: dict[str, str] = {}
        self._shown: dict[str, set[int]] = {}  # clients of each topic that is subscribed to
        self._followed: dict[str, Any] = {}
        self._held: dict[str, collections.deque[bytes]] = {}  # messages of latched topics, for clients that come later
        self._wishes = _Wishes()
        self._server = self._started(self._settings.value)
        self.create_timer(_LOOK_PERIOD, self._look)
        self.create_timer(_ANSWER_PERIOD, self._answer)
        diagnostics = Diagnostics(self, 'foxglove_bridge')
        diagnostics.add('Foxglove', self._diagnose)
        self._look()
        scheme = 'wss' if self._settings.value.certificate else 'ws'
        self.get_logger().info(f'{scheme}://{self._settings.value.address}:{self._server.port}')

    def _started(self, settings: FoxgloveSettings) -> Any:
        tls: dict[str, Any] = {}
        for name, path in (('tls_cert', settings.certificate), ('tls_key', settings.key)):
            if path:
                try:
                    tls[name] = Path(path).read_bytes()
                except OSError as error:
                    raise ConfigurationError(f'{path}: {reason(error)}') from None
        try:
            return self._library.start_server(
                name='drfmcw',
                host=settings.address,
                port=settings.port,
                server_listener=self._wishes,
                context=self._sink,
                **tls,
            )
        except (OSError, RuntimeError, ValueError) as error:
            raise ConfigurationError(f'cannot listen at {settings.address}:{settings.port}: {reason(error)}') from None

    def _look(self) -> None:
        """Offer topics that have appeared."""
        for topic, kinds in self.get_topic_names_and_types():
            if topic in self._offered or kinds[0] not in typestore().fielddefs:
                continue
            definition, _ = typestore().generate_msgdef(kinds[0], ros_version=2)
            schema = self._library.Schema(name=kinds[0], encoding='ros2msg', data=definition.encode())
            self._kinds[topic] = kinds[0]
            self._offered[topic] = self._library.Channel(
                topic, schema=schema, message_encoding='cdr', context=self._sink
            )

    def _answer(self) -> None:
        """Carry out what clients have asked for."""
        while True:
            try:
                begins, client, topic = self._wishes.arrived.get_nowait()
            except queue.Empty:
                return
            clients = self._shown.setdefault(topic, set())
            if begins:
                clients.add(client)
                self._subscribe(topic)
            else:
                clients.discard(client)
            if not clients:
                del self._shown[topic]
                self._held.pop(topic, None)
                if topic in self._followed:
                    self.destroy_subscription(self._followed.pop(topic))

    def _subscribe(self, topic: str) -> None:
        if topic in self._followed:
            for message in self._held.get(topic, ()):
                self._offered[topic].log(message)
            return
        publishers = self.get_publishers_info_by_topic(topic)
        profile = qos.suiting(publishers, is_latched(topic))
        if profile.durability == qos.LATCHED.durability:
            self._held[topic] = collections.deque(maxlen=qos.WEATHER.depth)
        pass_on = functools.partial(self._pass_on, topic)
        self._followed[topic] = self.create_subscription(
            message_class(self._kinds[topic]), topic, pass_on, profile, raw=True
        )

    def _pass_on(self, topic: str, message: bytes) -> None:
        self._offered[topic].log(message)
        if topic in self._held:
            self._held[topic].append(message)

    def _diagnose(self, status: Status) -> None:
        if not self._offered:
            status.report(WARN, 'no topic to offer')
        status.value('port', self._server.port)
        status.value('topics offered', len(self._offered))
        status.value('topics shown', len(self._shown))
        status.value('clients that show one', len({c for clients in self._shown.values() for c in clients}))

    def destroy_node(self) -> None:
        """Close all connections."""
        self._server.stop()
        super().destroy_node()


def _parser() -> Parser:
    parser = Parser(
        prog='drfmcw foxglove',
        description=f'{__doc__} All parameters: docs/host.md.',
        epilog='Anything after --ros-args goes to ROS, for instance: --ros-args -p address:=10.0.7.2',
    )
    parser.add_argument('--port', type=int, default=FoxgloveSettings().port, metavar='N', help='TCP port (8765)')
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; return the exit status."""
    own, ros = split_ros_arguments(argv)
    arguments = _parser().parse_args(own)
    return guarded('drfmcw foxglove', lambda: run(FoxgloveBridge, ros, given=FoxgloveSettings(port=arguments.port)))


if __name__ == '__main__':
    sys.exit(main())
