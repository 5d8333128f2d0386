"""Gateway node: range topics in, OPC UA and Modbus TCP for crane controllers out."""

import dataclasses
import functools
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drfmcw_msgs.msg import RangeEstimate
from rclpy.node import Node

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import Parser, guarded, split_ros_arguments
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import from_message
from drfmcw_ros.graph.publishers import Publishers
from drfmcw_ros.nodes.diagnostics import ERROR, WARN, Diagnostics, Status
from drfmcw_ros.nodes.parameters import SettingsParameters
from drfmcw_ros.nodes.runner import run

from .board import Board
from .certificates import make_certificate
from .quantities import gateway_table, pair_table, quality_table
from .reading import USABLE, Estimate, Quality
from .settings import GatewaySettings

if TYPE_CHECKING:
    from .serving import Servers


def _serving(board: Board) -> 'Servers':
    """Return the servers, started.

    Raises:
        ConfigurationError: see `Servers`; or a library lacks, which a system installation of ROS 2 does not bring.
    """
    try:
        from .serving import Servers
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f'{error.name} is not installed: pip install asyncua pymodbus (docs/dependencies.md)'
        ) from None
    return Servers(board)


class GatewayNode(Node):
    """Thin shell around Board and Servers. Parameters and registers: docs/controller.md."""

    def __init__(self, given: GatewaySettings | None = None, **kwargs: Any) -> None:
        """Listen; `given` replaces the parameters' defaults, `kwargs` go to rclpy's Node."""
        super().__init__('gateway', **kwargs)
        self._settings = SettingsParameters(self, GatewaySettings, given, on_change=self._change)
        settings = self._settings.value
        self._board = Board(settings, clock=lambda: self.get_clock().now().nanoseconds)
        self._sources = {pair: Publishers(f'/{pair}/range') for pair in settings.pairs}
        self._seen = dict.fromkeys(settings.pairs, 0)  # counters at the last diagnostics
        self._servers: Servers | None = _serving(self._board)
        for pair, sources in self._sources.items():
            take = functools.partial(self._take, pair)
            qos.subscription(self, RangeEstimate, sources.topic, take, qos.RELIABLE, batch=True, numbers=sources.add)
        diagnostics = Diagnostics(self, 'gateway')
        for pair in settings.pairs:
            diagnostics.add(f'Range {pair}', functools.partial(self._diagnose_pair, pair))
        diagnostics.add('Controller', self._diagnose_controller)
        if settings.opcua:
            diagnostics.add('OPC UA', self._diagnose_opcua)
        if settings.modbus:
            diagnostics.add('Modbus', self._diagnose_modbus)
        where = [f'OPC UA at {settings.endpoint}'] if settings.opcua else []
        where += [f'Modbus TCP at {settings.modbus_address}:{settings.modbus_port}'] if settings.modbus else []
        self.get_logger().info(f'{", ".join(settings.pairs)}: {", ".join(where)}')

    def _change(self, settings: GatewaySettings) -> None:
        self._board.change(settings)

    def _take(self, pair: str, messages: list[RangeEstimate]) -> None:
        arrival, mixed = time.monotonic(), bool(self._sources[pair].doubt)
        for message in messages:
            self._board.pairs[pair].take(from_message(message, Estimate), arrival, mixed)
        if self._servers is not None:
            self._servers.renew([pair])

    # --- once a second ---

    def _diagnose_pair(self, pair: str, status: Status) -> None:
        reading = self._board.readings([pair])[pair]
        new, self._seen[pair] = reading.counter - self._seen[pair], reading.counter
        if reading.state == Quality.NO_RANGE:
            status.report(ERROR, f'no range on /{pair}/range yet')
        elif reading.state == Quality.STALE:
            late = reading.quality & Quality.LATE
            why = 'its stamp is off the clock' if late else f'none for {reading.silence:.1f} s'
            status.report(ERROR, f'the range is stale: {why}')
        elif not reading.state & USABLE:
            status.report(WARN, self._sources[pair].doubt or 'the range is refused')
        elif reading.state == Quality.DOUBTFUL:
            status.report(WARN, 'the range is doubtful')
        status.value('quality', f'{int(reading.quality):#06x}')
        status.value('ranges per second', new)
        status.value('age [s]', reading.age)
        status.value('ranges that came late', self._board.pairs[pair].late)

    def _diagnose_controller(self, status: Status) -> None:
        controller, now = self._board.controller, self._board.now()
        if controller.silent(now):
            silence = f'for {controller.silence(now):.1f} s' if controller.heard else 'yet'
            status.report(WARN, f'the controller has not changed its heartbeat {silence}')
        status.value('expected', not math.isnan(controller.timeout))
        status.value('heartbeat', controller.value if controller.heard else 'none')

    def _diagnose_opcua(self, status: Status) -> None:
        settings = self._settings.value
        status.value('endpoint', settings.endpoint)
        security = 'Basic256Sha256, signed and encrypted' if settings.certificate else 'none: this machine'
        status.value('security', security)
        if self._servers is not None and self._servers.opcua is not None:
            status.value('clients', self._servers.opcua.sessions)
            if self._servers.failure:
                status.report(ERROR, f'cannot be updated: {self._servers.failure}')

    def _diagnose_modbus(self, status: Status) -> None:
        if self._servers is None or self._servers.modbus is None:
            return
        counts = self._servers.modbus.counts
        status.value('clients', counts.connections)
        status.value('requests', counts.requests)
        status.value('refused connections', counts.refused)
        if counts.reason:
            status.value('last refusal', counts.reason)

    def destroy_node(self) -> None:
        """Close all connections."""
        servers, self._servers = self._servers, None
        if servers is not None:
            servers.stop()
        super().destroy_node()


def _parser() -> Parser:
    parser = Parser(
        prog='drfmcw gateway',
        description=f'{__doc__} All parameters: docs/controller.md.',
        epilog='Anything after --ros-args goes to ROS, for instance: --ros-args -p timeout:=0.1 -p modbus_port:=502',
    )
    parser.add_argument('--pair', action='append', metavar='FIRST/SECOND', help='pair of stations (repeatable)')
    parser.add_argument(
        '--certificate', default='', metavar='FILE', help='certificate of the OPC UA server (DER or PEM)'
    )
    parser.add_argument('--key', default='', metavar='FILE', help="the certificate's private key (PEM)")
    parser.add_argument('--clients', default='', metavar='DIR', help='certificates of OPC UA clients that may connect')
    parser.add_argument(
        '--make-certificate', type=Path, metavar='DIR', help='write a self-signed certificate and its key, then exit'
    )
    parser.add_argument('--name', default='gateway', help="application's name in the certificate (gateway)")
    parser.add_argument('--registers', action='store_true', help='print the register map, then exit')
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; return the exit status."""
    own, ros = split_ros_arguments(argv)
    arguments = _parser().parse_args(own)

    def work() -> int:
        if arguments.make_certificate is not None:
            certificate, key = make_certificate(arguments.make_certificate, arguments.name)
            print(f'certificate: {certificate}\nkey:         {key}')
            return 0
        if arguments.registers:
            print('\n\n'.join((gateway_table(), pair_table(), quality_table())))
            return 0
        pairs = arguments.pair or GatewaySettings().pairs
        files = {name: getattr(arguments, name) for name in ('certificate', 'key', 'clients')}
        return run(GatewayNode, ros, given=dataclasses.replace(GatewaySettings(), pairs=pairs, **files))

    return guarded('drfmcw gateway', work)


if __name__ == '__main__':
    sys.exit(main())
