"""Age of a value when a controller first sees it, by OPC UA subscription and by Modbus polling, from a live graph."""

import asyncio
import datetime
import logging
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
from drfmcw_ros.commands.config_files import find_config
from drfmcw_study.soak_gateway import free_port

_PAIR = 'master/slave'
_ROS = 'ROS 2 subscriber'
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
_RATE = 50.0  # ranges per second
_GOAL = 20.0  # age of a value [ms]
_POLL = 1e-3  # between two Modbus requests [s]
_PUBLISH = 5.0  # interval that the OPC UA client asks for [ms]
_WARM_UP = 3.0  # not measured [s]
_START_LIMIT = 60.0  # until the gateway answers [s]


class _Opcua:
    """A subscription in a thread of its own; keeps the age [s] of each value by its stamp [us]."""

    def __init__(self, port: int) -> None:
        logging.getLogger('asyncua').setLevel(logging.ERROR)  # which intervals were agreed on
        self.ages: dict[int, float] = {}
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
        since = data.monitored_item.Value.SourceTimestamp - _EPOCH
        stamp = (since.days * 86400 + since.seconds) * 1_000_000 + since.microseconds
        self.ages.setdefault(stamp, time.time() - 1e-6 * stamp)

    def close(self) -> None:
        """Disconnect."""
        if self._client is not None:
            asyncio.run_coroutine_threadsafe(self._client.disconnect(), self._loop).result(10.0)
        self._loop.call_soon_threadsafe(self._loop.stop)


class _Modbus:
    """Polls a pair's block in a thread of its own; keeps the age [s] of each new value by its stamp [us]."""

    def __init__(self, port: int) -> None:
        self.ages: dict[int, float] = {}
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
                stamp = seconds * 1_000_000 + fraction // 1000
                newest = counter
                self.ages[stamp] = time.time() - 1e-6 * stamp
            time.sleep(_POLL)

    def close(self) -> None:
        """Disconnect."""
        self._running = False
        self._thread.join(5.0)
        self._client.close()


def _measure(
    graph: Graph, monitor: RangeMonitor, ports: tuple[int, int], seconds: float, console: Console
) -> dict[str, dict[int, float]]:
    """Return {who: {stamp [us]: age [s]}} of each client and of a ROS 2 subscriber."""
    await_first(graph, monitor)
    clients: dict[str, _Opcua | _Modbus] = {
        'OPC UA subscription': _Opcua(ports[0]),
        'Modbus polling': _Modbus(ports[1]),
    }
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
    ages = {_ROS: {a.stamp // 1000: (a.received - a.stamp) * 1e-9 for a in monitor.arrivals}}
    ages |= {name: client.ages for name, client in clients.items()}
    return {name: {t: age for t, age in seen.items() if begin <= t * 1e-6 < end} for name, seen in ages.items()}


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
    published = len(ages[_ROS])
    if not published:
        raise ConfigurationError('gateway: no range in the measured time')
    for name, seen in ages.items():
        what = f'gateway at {_RATE:g} ranges/s, {name}'
        values = np.array(list(seen.values()))
        if not len(values):
            raise ConfigurationError(f'gateway: {name} saw no range in the measured time')
        figures += [
            Figure(f'{what}: age p50', float(np.percentile(values, 50)) * 1e3, 'ms'),
            Figure(f'{what}: age p99', float(np.percentile(values, 99)) * 1e3, 'ms', None if name == _ROS else _GOAL),
        ]
        if name != _ROS:
            beyond = np.array([age - ages[_ROS][stamp] for stamp, age in seen.items() if stamp in ages[_ROS]])
            figures += [
                Figure(f'{what}: later than at a ROS 2 subscriber, p50', float(np.percentile(beyond, 50)) * 1e3, 'ms'),
                Figure(f'{what}: seen', len(values), f'of {published}'),
            ]
    return figures
