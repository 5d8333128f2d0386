"""CPU time, memory and updates of the host's page: three pairs at 1000 sweeps/s, one browser and twenty."""

import asyncio
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import websockets
from figures import Figure
from rich.console import Console

from drfmcw_bringup.graph import HOST, Graph, Member, private_environment
from drfmcw_physics.settings import ConfigurationError

_PAIRS = (('m0', 's0'), ('m1', 's1'), ('m2', 's2'))
_RATE = 1000.0  # sweeps per second and pair
_CLIENTS = 20
_VIEWS = ('now', 'over-time', 'signals', 'stations')
_START_LIMIT = 60.0  # [s]
_WARM_UP = 3.0  # not measured [s]
_LONGEST = 20.0  # of one measurement [s]
_TICKS = os.sysconf('SC_CLK_TCK')
_PAGE = os.sysconf('SC_PAGE_SIZE')


def _cpu(member: Member) -> float:
    """Return the CPU time of a process [s]."""
    fields = Path(f'/proc/{member.process.pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _memory(member: Member) -> float:
    """Return the resident memory of a process [MB]."""
    return int(Path(f'/proc/{member.process.pid}/statm').read_text().split()[1]) * _PAGE / 1e6


@contextlib.contextmanager
def _load(environment: dict[str, str]) -> Iterator[None]:
    """Publish what three pairs publish."""
    script = str(Path(__file__).with_name('host_load.py'))
    command = [sys.executable, script]
    running = [subprocess.Popen([*command, *pair, str(_RATE)], env=environment) for pair in _PAIRS]
    try:
        yield
    finally:
        for process in running:
            process.terminate()
            process.wait()


async def _watch(address: str, view: str, seconds: float) -> tuple[int, float]:
    """Return (messages, ranges per second that the last one shows) of one browser's stream in `seconds`."""
    origin = address.replace('ws:', 'http:')
    async with websockets.connect(f'{address}/live?view={view}', origin=origin, max_size=None) as stream:  # type: ignore[arg-type]
        end, count, rate = time.monotonic() + seconds, 0, 0.0
        while (left := end - time.monotonic()) > 0.0:
            with contextlib.suppress(TimeoutError):
                message = await asyncio.wait_for(stream.recv(), left)
                count += 1
                text = json.loads(message).get('text', {}).get('hero.rate', '')
                rate = float(text.partition(' ')[0]) if text else rate
        return count, rate


async def _browsers(address: str, number: int, seconds: float) -> list[tuple[int, float]]:
    views = [_VIEWS[i % len(_VIEWS)] for i in range(number)]
    return list(await asyncio.gather(*(_watch(address, view, seconds) for view in views)))


def _measure(host: Member, address: str, number: int, seconds: float) -> tuple[float, float, float, float]:
    """Return (CPU share [1], messages per second of the slowest browser, growth of memory [MB], ranges per second)."""
    asyncio.run(_browsers(address, number, _WARM_UP))
    used, kept, began = _cpu(host), _memory(host), time.monotonic()
    received = asyncio.run(_browsers(address, number, seconds))
    took = time.monotonic() - began
    return (_cpu(host) - used) / took, min(count for count, _ in received) / took, _memory(host) - kept, received[0][1]


def bench_host(seconds: float, console: Console) -> list[Figure]:
    """The host's page beside three pairs at 1000 sweeps/s: CPU time, updates, memory, with 1 and 20 browsers."""
    seconds = min(seconds, _LONGEST)
    environment = private_environment()
    figures = []
    with tempfile.TemporaryDirectory() as folder, _load(environment), Graph(environment, Path(folder) / 'log') as graph:
        host = graph.start('host', HOST, '--port', '0', '--state', folder, '--read-only')
        end = time.monotonic() + _START_LIMIT
        while not graph.last_words(host).startswith('host: '):
            if host.process.poll() is not None or time.monotonic() > end:
                raise ConfigurationError(f'host: {graph.last_words(host)}')
            time.sleep(0.1)
        address = graph.last_words(host).removeprefix('host: http').rstrip('/')
        time.sleep(_WARM_UP)
        for number in (1, _CLIENTS):
            console.print(f'host: {number} browsers, {seconds:g} s', highlight=False)
            share, updates, growth, rate = _measure(host, f'ws{address}', number, seconds)
            of = f'{number} browser{"s" if number > 1 else ""}'
            goal = 30.0 if number == 1 else None
            figures += [
                Figure(f'host, CPU time, {of}', 100.0 * share, '% of a core', goal),
                Figure(f'host, ranges of each of three pairs, {of}', rate, '1/s'),
                Figure(f'host, updates of the slowest, {of}', updates, '1/s'),
                Figure(f'host, growth of memory in {seconds:g} s, {of}', growth, 'MB', 20.0),
            ]
    return figures
