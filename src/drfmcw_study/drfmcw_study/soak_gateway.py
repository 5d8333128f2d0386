"""Hours of ranges through the gateway's servers at full speed, with clients that read, subscribe, come and go."""

import asyncio
import socket
import threading
import time
from collections.abc import Coroutine
from typing import Any

from asyncua import Client, ua
from pymodbus.client import ModbusTcpClient

from drfmcw_gateway.board import Board
from drfmcw_gateway.opcua import NAMESPACE
from drfmcw_gateway.quantities import BLOCK, PAIR_REGISTERS
from drfmcw_gateway.reading import Estimate
from drfmcw_gateway.serving import Servers
from drfmcw_gateway.settings import GatewaySettings
from drfmcw_physics.settings import ConfigurationError

RANGES = 400
"""Given between two visits of a client."""
_RATE = 50.0  # ranges per second that the hours are counted in
_READ_EVERY = 20  # ranges
_UPDATE_LIMIT = 30.0  # for one range to be written, on a busy machine [s]
_PAIR = 'master/slave'


def free_port() -> int:
    """Return a TCP port of this machine that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


class GatewaySoak:
    """A gateway that never stops, a Modbus client and an OPC UA subscription that stay, and clients that do not."""

    def __init__(self) -> None:
        """Start servers and clients on free ports of this machine."""
        # a busy machine is no silent pair
        self._settings = GatewaySettings(
            pairs=[_PAIR],
            opcua_port=free_port(),
            modbus_port=free_port(),
            timeout=_UPDATE_LIMIT,
            age_limit=_UPDATE_LIMIT,
            lost_time=_UPDATE_LIMIT,
        )
        self._board = Board(self._settings)
        self._servers = Servers(self._board)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._modbus = ModbusTcpClient('127.0.0.1', port=self._settings.modbus_port)
        self._client = Client(self._settings.endpoint)
        self.notified = 0
        """Changes that the subscription has got."""
        self._wait(self._subscribe())
        self._count = 0

    @property
    def hours(self) -> float:
        """Return for how many hours of ranges it has run."""
        return self._count / _RATE / 3600.0

    def _wait(self, work: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(_UPDATE_LIMIT)

    async def _subscribe(self) -> None:
        await self._client.connect()
        index = await self._client.get_namespace_index(NAMESPACE)
        subscription = await self._client.create_subscription(10, self)
        nodes = [self._client.get_node(ua.NodeId(f'{_PAIR}/{name}', index)) for name in ('range', 'quality')]
        await subscription.subscribe_data_change(nodes)

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        """Count a change; called by asyncua."""
        self.notified += 1

    async def _visit(self) -> None:
        """Connect, read and leave, as another OPC UA client."""
        async with Client(self._settings.endpoint) as visitor:
            index = await visitor.get_namespace_index(NAMESPACE)
            await visitor.get_node(ua.NodeId(f'{_PAIR}/range', index)).read_data_value(raise_on_bad_status=False)

    def loop(self) -> list[float]:
        """Give some ranges, each until OPC UA has it; return the time that each took [s].

        Raises:
            ConfigurationError: a client reads something else than was given.
        """
        taken = []
        for _ in range(RANGES):
            self._count += 1
            value = float(self._count % 1000)
            begin = time.perf_counter()
            estimate = Estimate(self._count, 0, value, 1e-3, 0.0, 5e-3, 0, time.time_ns())
            self._board.pairs[_PAIR].take(estimate, time.monotonic())
            self._servers.renew_and_wait([_PAIR], _UPDATE_LIMIT)
            taken.append(time.perf_counter() - begin)
            if self._count % _READ_EVERY == 0:
                self._read(value)
        self._wait(self._visit())
        with ModbusTcpClient('127.0.0.1', port=self._settings.modbus_port) as visitor:
            visitor.write_register(0, self._count % 65536)
        return taken

    def _read(self, value: float) -> None:
        words = self._modbus.read_input_registers(BLOCK, count=PAIR_REGISTERS).registers
        found = self._modbus.convert_from_registers(words[4:6], self._modbus.DATATYPE.FLOAT32)
        if found != value:
            raise ConfigurationError(f'the gateway gives {found} m, not {value} m, after {self._count} ranges')

    def close(self) -> None:
        """Stop all."""
        self._wait(self._client.disconnect())
        self._modbus.close()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10.0)
        self._servers.stop()
