"""Age of a value when a controller first sees it, by OPC UA subscription and by Modbus polling, from a live graph."""

import asyncio
import struct
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from asyncua import Client, ua
from figures import Figure
from graph import await_first, scenario_overrides, start_fusion_and_stations
from pymodbus.client import ModbusTcpClient
from rich.console import Console
from rich.progress import track

from drfmcw_bringup.graph import GATEWAY, SIMULATOR, Graph, parameters, private_environment
from drfmcw_bringup.monitor import RangeMonitor, monitored
from drfmcw_gateway.opcua import NAMESPACE
from drfmcw_gateway.quantities import BLOCK, PAIR_QUANTITIES, PAIR_REGISTERS, offsets
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.config_files import find_config
from drfmcw_study.soak_gateway import free_port

_PAIR = 'master/slave'
_RATE = 50.0  # ranges per second
_GOAL = 20.0  # age of a value [ms]
_POLL = 1e-3  # between two Modbus requests [s]
_PUBLISH = 5.0  # interval that the OPC UA client asks for [ms]
_WARM_UP = 3.0  # not measured [s]
_START_LIMIT = 60.0  # until the gateway answers [s]


class _Opcua:
    """A subscription in a thread of its own; keeps (stamp, age) of each value [s]."""

    def __init__(self, port: int) -> None:
        self.ages: list[tuple[float, float]] = []
        self._port = port
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        self._client: Client | None = None
        asyncio.run_coroutine_threadsafe(self._connect(), self._loop).result(_START_LIMIT)

    async def _connect(self) -> None:
        end = time.monotonic() + _START_LIMIT
        while self._client is None:
            client = Client(f'opc.tcp://127.0.0.1:{self._port}/drfmcw/')
            try:
                await client.connect()
                self._client = client
            except OSError:
                if time.monotonic() > end:
                    raise ConfigurationError(f'gateway: no OPC UA within {_START_LIMIT:g} s') from None
                await asyncio.sleep(0.2)
        index = await self._client.get_namespace_index(NAMESPACE)
        subscription = await self._client.create_subscription(_PUBLISH, self)
        await subscription.subscribe_data_change(self._client.get_node(ua.NodeId(f'{_PAIR}/range', index)))

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        """Take a value; called by asyncua."""
        stamp = data.monitored_item.Value.SourceTimestamp.timestamp()
        self.ages.append((stamp, time.time() - stamp))

    def close(self) -> None:
        """Disconnect."""
        if self._client is not None:
            asyncio.run_coroutine_threadsafe(self._client.disconnect(), self._loop).result(10.0)
        self._loop.call_soon_threadsafe(self._loop.stop)


class _Modbus:
    """Polls a pair's block in a thread of its own; keeps (stamp, age) of each new value [s]."""

    def __init__(self, port: int) -> None:
        self.ages: list[tuple[float, float]] = []
        self._client = ModbusTcpClient('127.0.0.1', port=port)
        end = time.monotonic() + _START_LIMIT
        while not self._client.connect():
            if time.monotonic() > end:
                raise ConfigurationError(f'gateway: no Modbus within {_START_LIMIT:g} s')
            time.sleep(0.2)
        self._running = True
        self._thread = threading.Thread(target=self._poll, daemon=True)
        self._thread.start()

    def _poll(self) -> None:
        at = offsets(PAIR_QUANTITIES)
        newest = 0
        while self._running:
            words = self._client.read_input_registers(BLOCK, count=PAIR_REGISTERS).registers
            data = struct.pack(f'>{len(words)}H', *words)
            counter, seconds, fraction = (
                struct.unpack_from('>I', data, 2 * at[name])[0] for name in ('counter', 'stamp', 'stamp_nanoseconds')
            )
            if counter != newest:
                stamp = seconds + 1e-9 * fraction
                newest = counter
                self.ages.append((stamp, time.time() - stamp))
            time.sleep(_POLL)

    def close(self) -> None:
        """Disconnect."""
        self._running = False
        self._thread.join(5.0)
        self._client.close()


def _measure(
    graph: Graph, monitor: RangeMonitor, ports: tuple[int, int], seconds: float, console: Console
) -> dict[str, np.ndarray]:
    """Return the ages that each client saw, and those at a ROS 2 subscriber [s]."""
    await_first(graph, monitor)
    clients = {'OPC UA subscription': _Opcua(ports[0]), 'Modbus polling': _Modbus(ports[1])}
    try:
        time.sleep(_WARM_UP)
        begin = time.time()
        for _ in track(range(round(seconds * 10)), description='gateway', console=console, transient=True):
            time.sleep(0.1)
        end = time.time()
    finally:
        for client in clients.values():
            client.close()
    for member in graph.tend():
        raise ConfigurationError(f'gateway: {member.name} ended: {graph.last_words(member)}')
    ages = {name: np.array([age for stamp, age in c.ages if begin <= stamp < end]) for name, c in clients.items()}
    arrivals = [a for a in monitor.arrivals if begin <= a.stamp * 1e-9 < end]
    ages['ROS 2 subscriber'] = np.array([(a.received - a.stamp) * 1e-9 for a in arrivals])
    return ages


def bench_gateway(seconds: float, console: Console) -> list[Figure]:
    """Measure the age of a value when OPC UA and Modbus clients first see it, at 50 ranges per second."""
    environment = private_environment()
    ports = (free_port(), free_port())
    with (
        tempfile.TemporaryDirectory(prefix='drfmcw-bench-') as directory,
        Graph(environment, Path(directory)) as graph,
        monitored([_PAIR], int(environment['ROS_DOMAIN_ID']), keep=True) as monitor,
    ):
        start_fusion_and_stations(graph)
        graph.start('gateway', GATEWAY, *parameters({'opcua_port': ports[0], 'modbus_port': ports[1]}))
        overrides = '[' + ', '.join(f'"{o}"' for o in scenario_overrides(_RATE, seconds + 60.0)) + ']'
        graph.start('simulator', SIMULATOR, *parameters({'scenario': find_config('crane'), 'overrides': overrides}))
        ages = _measure(graph, monitor, ports, seconds, console)
    figures = []
    published = len(ages['ROS 2 subscriber'])
    for name, seen in ages.items():
        if not len(seen):
            raise ConfigurationError(f'gateway: {name} saw no range in the measured time')
        goal = None if name.startswith('ROS') else _GOAL
        figures += [
            Figure(f'gateway at {_RATE:g} ranges/s, {name}: age p50', float(np.percentile(seen, 50)) * 1e3, 'ms'),
            Figure(f'gateway at {_RATE:g} ranges/s, {name}: age p99', float(np.percentile(seen, 99)) * 1e3, 'ms', goal),
            Figure(f'gateway at {_RATE:g} ranges/s, {name}: seen', len(seen), f'of {published}'),
        ]
    return figures
