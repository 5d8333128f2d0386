"""Modbus TCP server: input registers computed at each request, one holding register for the controller's heartbeat."""

import dataclasses
import ipaddress
import logging
from typing import Any

from pymodbus.constants import ExcCodes
from pymodbus.pdu.device import ModbusDeviceIdentification
from pymodbus.server import ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import DataType, SimData, SimDevice

from drfmcw_physics.settings import ConfigurationError

from .board import Board
from .quantities import (
    BLOCK,
    GATEWAY_REGISTERS,
    HEARTBEAT_REGISTER,
    PAIR_REGISTERS,
    gateway_registers,
    pair_registers,
)
from .settings import GatewaySettings, networks

_READ_HOLDING, _READ_INPUT, _WRITE_ONE, _WRITE_SEVERAL = 3, 4, 6, 16
_ANY_DEVICE = 0  # every unit identifier is answered


@dataclasses.dataclass
class Counts:
    """What happened so far, for the diagnostics."""

    connections: int = 0  # now
    requests: int = 0
    refused: int = 0  # connections
    reason: str = ''  # of the last refusal


class _Handler(ServerRequestHandler):
    """One connection, closed at once where its address may not connect."""

    def callback_connected(self) -> None:
        super().callback_connected()
        self.server.connected(self)

    def callback_disconnected(self, exc: Exception | None) -> None:
        self.server.disconnected(self)
        super().callback_disconnected(exc)


class _Server(ModbusTcpServer):
    """pymodbus' server with limits of address and number."""

    def __init__(self, settings: GatewaySettings, counts: Counts, device: SimDevice) -> None:
        identity = ModbusDeviceIdentification(info_name={'VendorName': 'drfmcw', 'ProductCode': 'gateway'})
        super().__init__(device, identity=identity, address=(settings.modbus_address, settings.modbus_port))
        self._settings, self._counts = settings, counts
        self._networks = networks(settings.modbus_from)
        self._open: set[_Handler] = set()

    def callback_new_connection(self) -> _Handler:
        return _Handler(self, self.trace_packet, self.trace_pdu, self.trace_connect)

    def connected(self, handler: _Handler) -> None:
        """Keep a connection, or close it."""
        peer = handler.transport.get_extra_info('peername') if handler.transport else None
        host = peer[0] if peer else ''
        if self._networks and not _among(host, self._networks):
            self._refuse(handler, f'{host} is not in modbus_from')
        elif len(self._open) >= self._settings.modbus_connections:
            self._refuse(handler, f'{host}: {len(self._open)} connections are open already')
        else:
            self._open.add(handler)
            self._counts.connections = len(self._open)

    def _refuse(self, handler: _Handler, reason: str) -> None:
        self._counts.refused += 1
        self._counts.reason = reason
        handler.close()

    def disconnected(self, handler: _Handler) -> None:
        """Forget a connection."""
        self._open.discard(handler)
        self._counts.connections = len(self._open)


def _among(host: str, allowed: list[Any]) -> bool:
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    return any(address in network for network in allowed)


class ModbusServer:
    """Serves a board; started and stopped in an event loop."""

    def __init__(self, board: Board) -> None:
        """Serve `board` at the address of its settings."""
        self._board = board
        self._server: _Server | None = None
        self.counts = Counts()
        """For the diagnostics."""
        logging.getLogger('pymodbus.logging').setLevel(logging.CRITICAL)

    def _blocks(self) -> list[SimData]:
        """Return the addresses that exist; others are answered with exception 2."""
        starts = [0, *(BLOCK * (n + 1) for n in range(len(self._board.pairs)))]
        lengths = [GATEWAY_REGISTERS, *(PAIR_REGISTERS for _ in self._board.pairs)]
        return [
            SimData(start, count=length, datatype=DataType.REGISTERS)
            for start, length in zip(starts, lengths, strict=True)
        ]

    async def start(self) -> None:
        """Listen.

        Raises:
            ConfigurationError: the address cannot be listened at.
        """
        bits = SimData(0, values=[False] * 16, datatype=DataType.BITS)
        holding = SimData(HEARTBEAT_REGISTER, datatype=DataType.REGISTERS)
        device = SimDevice(_ANY_DEVICE, simdata=([bits], [bits], [holding], self._blocks()), action=self._access)
        settings = self._board.settings
        self._server = _Server(settings, self.counts, device)
        try:
            await self._server.serve_forever(background=True)
        except (OSError, RuntimeError):
            where = f'{settings.modbus_address}:{settings.modbus_port}'
            raise ConfigurationError(
                f'modbus_address, modbus_port: cannot listen at {where}; is the port taken, or below 1024?'
            ) from None

    async def stop(self) -> None:
        """Close all connections."""
        if self._server is not None:
            await self._server.shutdown()

    async def _access(
        self, function: int, start: int, address: int, count: int, registers: list[int], values: list[Any] | None
    ) -> ExcCodes | None:
        """Refresh the registers that a request reads, or take the heartbeat that it writes.

        pymodbus passes: the function code, the address of `registers[0]`, first address and number of the request, all
        registers of this kind, and what is written (None where it reads).
        """
        writes = function in (_WRITE_ONE, _WRITE_SEVERAL)
        if writes and values:
            self._board.write_heartbeat(int(values[0]))
        elif function == _READ_INPUT:
            self._refresh(start, address, count, registers)
        elif not writes and function != _READ_HOLDING:
            return ExcCodes.ILLEGAL_FUNCTION
        self.counts.requests += not (writes and values)  # pymodbus reads what was written, as a second access
        return None

    def _refresh(self, start: int, address: int, count: int, registers: list[int]) -> None:
        blocks = range(address // BLOCK, (address + count - 1) // BLOCK + 1)
        pairs = list(self._board.pairs)
        wanted = [pairs[block - 1] for block in blocks if block]
        readings = self._board.readings(wanted)
        for block in blocks:
            words = pair_registers(readings[pairs[block - 1]]) if block else gateway_registers(self._board.gateway())
            offset = block * BLOCK - start
            registers[offset : offset + len(words)] = words
