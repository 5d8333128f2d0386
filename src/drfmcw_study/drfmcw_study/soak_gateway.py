"""Hours of ranges through the gateway's servers, with clients that stay, come and go, and pairs that fall silent."""

import asyncio
import logging
import math
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Coroutine, Sequence
from pathlib import Path
from typing import Any

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography import x509
from pymodbus.client import ModbusTcpClient

from drfmcw_gateway.certificates import certificate_of, make_certificate
from drfmcw_gateway.opcua import NAMESPACE
from drfmcw_gateway.quantities import (
    BLOCK,
    GATEWAY_QUANTITIES,
    GATEWAY_REGISTERS,
    HEARTBEAT_INTERVAL,
    PAIR_QUANTITIES,
    PAIR_REGISTERS,
    offsets,
)
from drfmcw_gateway.reading import Quality
from drfmcw_gateway.settings import GatewaySettings
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.work.processes import Worker

from .soak_servers import PAIRS, SLOT, Passed, SimulatedGateway, Slots, pair_of, range_of

RANGES = 1000
"""Slots between two visits of clients."""
SILENCE_EVERY = 10_000
"""Slots from one silence to the next."""
_READ_EVERY = 50  # slots
_SECURED_EVERY = 10  # visits
_LIMIT = 30.0  # for whatever is waited for, on a busy machine [s]
_PUBLISHED = 50.0  # interval of the subscription [ms]
_SUBSCRIBED = ('range', 'quality')
_HEARTBEAT = 'gateway/heartbeat'
_SILENT = (PAIRS[:1], PAIRS[1:], PAIRS)  # pairs of one silence after the other
_STAGES = (
    (0.1, Quality.VALID, ua.StatusCodes.Good),
    (0.5, Quality.STALE, ua.StatusCodes.UncertainLastUsableValue),
    (1.5, Quality.STALE | Quality.LATE, ua.StatusCodes.UncertainLastUsableValue),
    (3.0, Quality.STALE | Quality.LATE, ua.StatusCodes.BadNoCommunication),
)
"""Silence [s], and what the clients find then with the gateway's default times."""
_PAIR_AT, _GATEWAY_AT = offsets(PAIR_QUANTITIES), offsets(GATEWAY_QUANTITIES)


def free_port() -> int:
    """Return a TCP port of this machine that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


class GatewaySoak:
    """Servers in a process of their own, with their default times on a simulated clock, and the clients here.

    A Modbus client and an OPC UA subscription stay; others come, read and leave, every tenth one encrypted.
    """

    def __init__(self) -> None:
        """Start servers and clients on free ports of this machine."""
        self._directory = tempfile.TemporaryDirectory(prefix='drfmcw_soak_')
        root = Path(self._directory.name)
        self._certificate, key = make_certificate(root / 'server', 'gateway')
        self._own, self._own_key = make_certificate(root / 'client', 'visitor')
        self._settings = GatewaySettings(
            pairs=list(PAIRS),
            opcua_port=free_port(),
            modbus_port=free_port(),
            certificate=str(self._certificate),
            key=str(key),
        )
        self._worker: Worker[Slots, Passed] = Worker(SimulatedGateway(self._settings))
        logging.getLogger('asyncua').setLevel(logging.ERROR)  # which intervals were agreed on
        self._slots = 0
        self._given = dict.fromkeys(PAIRS, 0)  # slot of each pair's newest range
        self._seen: dict[str, ua.DataValue] = {}  # by the subscription
        self.visits = self.secured = 0
        """Connections of OPC UA clients, and those of them that were encrypted."""
        self.silences = 0
        """Silences that both clients saw begin and end."""
        self.notified = 0
        """Changes that the subscription has got."""
        self._heartbeat = self._wraps = 0
        self._last = self._order(Slots(0))
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._modbus = self._modbus_client()
        self._client = self._opcua_client()
        self._wait(self._subscribe())

    @property
    def process(self) -> int:
        """Return the identifier of the servers' process."""
        return self._last.process

    @property
    def hours(self) -> float:
        """Return for how many hours of ranges it has run."""
        return self._slots * SLOT / 3600.0

    @property
    def account(self) -> str:
        """Return what the clients did and saw."""
        return (
            f'{self._slots} slots of {1e3 * SLOT:g} ms for {len(PAIRS)} pairs. {self.silences} silences of 3 s: stale, '
            f'late, lost and valid again, as both clients must see it. {self.visits} visits by Modbus and by OPC UA, '
            f'{self.secured} of these encrypted. {self.notified} notifications. The heartbeat began anew {self._wraps} '
            'times.'
        )

    def _order(self, order: Slots) -> Passed:
        self._worker.give(order)
        [found] = self._worker.results(_LIMIT + order.count)
        for slot in range(self._slots + 1, self._slots + 1 + order.count):
            if pair_of(slot) not in order.silent:
                self._given[pair_of(slot)] = slot
        self._slots += order.count
        return found

    # --- the clients ---

    def _wait(self, work: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(_LIMIT)

    def _modbus_client(self) -> ModbusTcpClient:
        return ModbusTcpClient('127.0.0.1', port=self._settings.modbus_port, timeout=_LIMIT)

    def _opcua_client(self) -> Client:
        """Return a client that does not give up before its processes get their turn on a busy machine."""
        return Client(self._settings.endpoint, timeout=_LIMIT, watchdog_intervall=_LIMIT)

    async def _subscribe(self) -> None:
        await self._client.connect()
        names = [f'{pair}/{name}' for pair in PAIRS for name in _SUBSCRIBED] + [_HEARTBEAT]
        index = await self._client.get_namespace_index(NAMESPACE)
        subscription = await self._client.create_subscription(_PUBLISHED, self)
        nodes = [self._client.get_node(ua.NodeId(name, index)) for name in names]
        await subscription.subscribe_data_change(nodes, queuesize=1)

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        """Keep a change; called by asyncua."""
        self.notified += 1
        self._seen[node.nodeid.Identifier] = data.monitored_item.Value

    async def _visit(self, secured: bool) -> None:
        """Connect, read and leave, as another OPC UA client."""
        client = self._opcua_client()
        if secured:
            names = certificate_of(str(self._own)).extensions.get_extension_for_class(x509.SubjectAlternativeName)
            client.application_uri = names.value.get_values_for_type(x509.UniformResourceIdentifier)[0]
            await client.set_security(
                SecurityPolicyBasic256Sha256,
                certificate=self._own,
                private_key=self._own_key,
                server_certificate=self._certificate,
            )
        async with client as visitor:
            index = await visitor.get_namespace_index(NAMESPACE)
            for pair in PAIRS:
                found = await visitor.get_node(ua.NodeId(f'{pair}/range', index)).read_value()
                self._check(f'{pair}/range by OPC UA', found, range_of(self._given[pair]))

    def _check(self, what: str, found: object, expected: object) -> None:
        if found != expected:
            raise ConfigurationError(f'{what} is {found}, not {expected}, after {self._slots} ranges')

    def _read(self, pair: str) -> Sequence[int]:
        block = BLOCK * (1 + PAIRS.index(pair))
        return self._modbus.read_input_registers(block, count=PAIR_REGISTERS).registers

    def _compare(self, pair: str, quality: Quality) -> None:
        """Compare what Modbus gives of a pair with what was given."""
        words = self._read(pair)
        self._check(f'{pair}/quality by Modbus', Quality(words[_PAIR_AT['quality']]), quality)
        at = _PAIR_AT['range']
        found = self._modbus.convert_from_registers(words[at : at + 2], self._modbus.DATATYPE.FLOAT32)
        expected = range_of(self._given[pair]) if quality == Quality.VALID else math.nan
        self._check(f'{pair}/range by Modbus', str(found), str(expected))

    def _read_heartbeat(self) -> None:
        """Compare the heartbeat with the simulated time, which stands still now: first Modbus, then OPC UA."""
        words = self._modbus.read_input_registers(0, count=GATEWAY_REGISTERS).registers
        found = words[_GATEWAY_AT['heartbeat']]
        expected = self._slots * SLOT / HEARTBEAT_INTERVAL
        if (found - math.floor(expected - 1e-6)) % 65536 > 1:
            raise ConfigurationError(f'heartbeat by Modbus is {found}, not {expected:g} modulo 65536')
        self._wraps += found < self._heartbeat
        self._heartbeat = found
        self._await(_HEARTBEAT, lambda value: value.Value.Value == found)

    def _await(self, name: str, holds: Callable[[ua.DataValue], bool]) -> None:
        """Wait until the subscription has seen something."""
        end = time.monotonic() + _LIMIT
        while name not in self._seen or not holds(self._seen[name]):
            if time.monotonic() > end:
                seen = self._seen.get(name)
                raise ConfigurationError(f'{name} by OPC UA stays {seen and seen.Value} after {self._slots} ranges')
            time.sleep(0.005)

    # --- what happens in turn ---

    def loop(self) -> list[float]:
        """Let some slots pass, with clients that come and go, and a silence when it is due.

        Returns:
            The time that each range took until OPC UA had it [s].

        Raises:
            ConfigurationError: a client reads something else than was given.
        """
        taken = []
        for _ in range(RANGES // _READ_EVERY):
            taken += self._order(Slots(_READ_EVERY)).taken
            for pair in PAIRS:
                self._compare(pair, Quality.VALID)
        if self._slots // SILENCE_EVERY > self.silences:
            self._silence(_SILENT[self.silences % len(_SILENT)])
            self.silences += 1
        self.visits += 1
        secured = not self.visits % _SECURED_EVERY
        self.secured += secured
        self._wait(self._visit(secured))
        with self._modbus_client() as visitor:
            visitor.write_register(0, self._slots % 65536)
        return taken

    def _silence(self, silent: tuple[str, ...]) -> None:
        """Let pairs fall silent while the others go on; compare what both clients find at each stage, and after it."""
        passed = 0.0
        for duration, quality, status in _STAGES:
            self._order(Slots(round((duration - passed) / SLOT), silent))
            passed = duration
            for pair in PAIRS:
                self._both(pair, *((quality, status) if pair in silent else (Quality.VALID, ua.StatusCodes.Good)))
        self._read_heartbeat()
        self._order(Slots(len(PAIRS)))
        for pair in PAIRS:
            self._both(pair, Quality.VALID, ua.StatusCodes.Good)

    def _both(self, pair: str, quality: Quality, status: int) -> None:
        """Compare a pair's quality, status and range at both clients with what they must be."""
        self._compare(pair, quality)
        last = None if ua.StatusCode(status).is_bad() else range_of(self._given[pair])

        def fits(value: ua.DataValue) -> bool:
            found = None if value.Value is None else value.Value.Value
            return value.StatusCode.value == status and found == last

        self._await(f'{pair}/quality', lambda value: value.Value.Value == quality)
        self._await(f'{pair}/range', fits)

    def settle(self) -> None:
        """Wait until the servers have closed the connections of clients that left, and have no garbage.

        Raises:
            ConfigurationError: connections stay open.
        """
        end = time.monotonic() + _LIMIT
        while True:
            self._last = self._order(Slots(0))
            if (self._last.sessions, self._last.connections) == (1, 1):
                return
            if time.monotonic() > end:
                raise ConfigurationError(
                    f'{self._last.sessions} OPC UA and {self._last.connections} Modbus connections are open, not 1 each'
                )
            time.sleep(0.02)

    def close(self) -> None:
        """Stop all."""
        try:
            self._wait(self._client.disconnect())
            self._modbus.close()
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(10.0)
        finally:
            self._worker.close()
            self._directory.cleanup()
