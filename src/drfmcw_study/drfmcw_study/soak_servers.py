"""The gateway's servers in a process of their own: ranges on a simulated clock, as fast as the servers take them."""

import dataclasses
import gc
import os
import time
from collections.abc import Iterator

from drfmcw_gateway.board import Board
from drfmcw_gateway.reading import NANOSECONDS, Estimate
from drfmcw_gateway.serving import Servers
from drfmcw_gateway.settings import GatewaySettings

PAIRS = ('master/slave', 'master/second')
"""Measured in turn."""
SLOT = 0.02
"""Simulated time from one range to the next [s]."""
_BEGIN = 1_800_000_000 * NANOSECONDS  # stamp of the first slot [ns]
_UPDATE_LIMIT = 30.0  # for one range to be written, on a busy machine [s]
_LATENCY = 5 * NANOSECONDS // 1000  # from a range's stamp to its arrival [ns]


def pair_of(slot: int) -> str:
    """Return the pair that is measured in a slot."""
    return PAIRS[slot % len(PAIRS)]


def range_of(slot: int) -> float:
    """Return the range that is given in a slot [m]."""
    return float(slot % 1000)


@dataclasses.dataclass(frozen=True)
class Slots:
    """An order: let simulated time pass, with a range in each slot but in those of silent pairs."""

    count: int  # 0 to collect garbage
    silent: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Passed:
    """What came of an order."""

    process: int  # identifier
    taken: list[float]  # by each range, until OPC UA had it [s]
    sessions: int  # of OPC UA clients, open now
    connections: int  # of Modbus clients, open now


class SimulatedGateway:
    """Board and servers whose clocks stand still between two orders; the work of a `Worker`."""

    def __init__(self, settings: GatewaySettings) -> None:
        """Keep the settings; the process that gets the first order serves."""
        self._settings = settings
        self._slots = 0
        self._board: Board | None = None
        self._servers: Servers | None = None

    def _now(self) -> float:
        return self._slots * SLOT

    def _clock(self) -> int:
        return _BEGIN + round(self._slots * SLOT * NANOSECONDS)

    def __call__(self, order: Slots) -> Iterator[Passed]:
        """Carry out an order; yield what came of it.

        Raises:
            TimeoutError: OPC UA did not take a range.
        """
        if self._board is None or self._servers is None:
            self._board = Board(self._settings, self._clock, self._now)
            self._servers = Servers(self._board)
        taken = []
        for _ in range(order.count):
            self._slots += 1
            pair = pair_of(self._slots)
            if pair in order.silent:
                continue
            begin = time.perf_counter()
            value = range_of(self._slots)
            estimate = Estimate(self._slots, 0, value, 1e-3, 0.0, 5e-3, 0, self._clock() - _LATENCY)
            self._board.pairs[pair].take(estimate, self._now())
            self._servers.renew_and_wait([pair], _UPDATE_LIMIT)
            taken.append(time.perf_counter() - begin)
        if not order.count:
            gc.collect()
        opcua, modbus = self._servers.opcua, self._servers.modbus
        assert opcua is not None and modbus is not None
        yield Passed(os.getpid(), taken, opcua.sessions, modbus.counts.connections)
