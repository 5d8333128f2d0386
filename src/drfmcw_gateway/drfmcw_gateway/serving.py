"""The servers' thread: an event loop beside the node's executor, woken by ranges and by a clock."""

import asyncio
import threading
from collections.abc import Sequence

from drfmcw_physics.settings import ConfigurationError

from .board import Board
from .modbus import ModbusServer
from .opcua import OpcUaServer

_START_LIMIT = 60.0  # for making the address space, on a busy machine [s]
_STOP_LIMIT = 10.0  # for closing connections [s]


class Servers:
    """OPC UA and Modbus TCP on one board, in a thread of their own."""

    def __init__(self, board: Board) -> None:
        """Listen.

        Raises:
            ConfigurationError: an address cannot be listened at, or a certificate is wrong.
        """
        self._board = board
        self.opcua = OpcUaServer(board) if board.settings.opcua else None
        self.modbus = ModbusServer(board) if board.settings.modbus else None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name='servers', daemon=True)
        self._ticking: asyncio.Task[None] | None = None
        self._new: set[str] = set()  # pairs that got a range since the last update
        self._lock = threading.Lock()
        self.failure = ''
        """Why the last update failed, '' while none has."""
        self._thread.start()
        started = asyncio.run_coroutine_threadsafe(self._start(), self._loop)
        try:
            started.result(_START_LIMIT)
        except TimeoutError:
            self.stop()
            raise ConfigurationError(f'the servers did not start within {_START_LIMIT:g} s') from None
        except BaseException:
            self.stop()
            raise

    async def _start(self) -> None:
        for server in (self.modbus, self.opcua):
            if server is not None:
                await server.start()
        self._ticking = asyncio.create_task(self._tick())

    async def _tick(self) -> None:
        """Look for silence and let the heartbeat advance."""
        while True:
            if self.opcua is not None:
                try:
                    await self.opcua.tick()
                except Exception as error:  # the heartbeat goes on; the diagnostics report it
                    self.failure = f'{type(error).__name__}: {error}'
            await asyncio.sleep(self._board.settings.period)

    def renew(self, pairs: Sequence[str]) -> None:
        """Publish the newest ranges of some pairs; returns at once. Modbus computes at each request by itself."""
        if self.opcua is None:
            return
        with self._lock:
            waiting = bool(self._new)
            self._new.update(pairs)
        if not waiting:  # what comes before the update runs goes with it
            asyncio.run_coroutine_threadsafe(self._renew(), self._loop)

    def renew_and_wait(self, pairs: Sequence[str], limit: float) -> None:
        """Publish the newest ranges of some pairs, and wait until OPC UA has them: `limit` seconds at most.

        Raises:
            TimeoutError: it has not.
        """
        if self.opcua is not None:
            asyncio.run_coroutine_threadsafe(self.opcua.update(pairs), self._loop).result(limit)

    async def _renew(self) -> None:
        with self._lock:
            pairs, self._new = sorted(self._new), set()
        if self.opcua is not None:
            try:
                await self.opcua.update(pairs)
            except Exception as error:
                self.failure = f'{type(error).__name__}: {error}'

    def stop(self) -> None:
        """Close all connections and end the thread."""
        if self._loop.is_closed():
            return
        stopped = asyncio.run_coroutine_threadsafe(self._stop(), self._loop)
        try:
            stopped.result(_STOP_LIMIT)
        except Exception as error:
            self.failure = f'{type(error).__name__}: {error}'
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_STOP_LIMIT)
        if not self._thread.is_alive():
            self._loop.close()

    async def _stop(self) -> None:
        if self._ticking is not None:
            self._ticking.cancel()
        for server in (self.opcua, self.modbus):
            if server is not None:
                await server.stop()
        others = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)
