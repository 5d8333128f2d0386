"""The host's page: CPU time, memory, updates and paint, beside three pairs at 1000 sweeps/s and beside a real graph."""

import asyncio
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from figures import Figure
from host_graph import FULL_RATE, RATE, ROUNDS, slowed
from host_page import chromium, open_pages, show_distance
from host_process import cpu, memory, start_host, streams
from rich.console import Console

from drfmcw_bringup.graph import Graph, Member, private_environment

_PAIRS = (('m0', 's0'), ('m1', 's1'), ('m2', 's2'))
_RATE, _USUAL_RATE = 1000.0, 50.0  # sweeps per second and pair
_CLIENTS = 20
_VIEWS = ('now', 'over-time', 'signals', 'stations')
_WARM_UP = 3.0  # not measured [s]
_LONGEST = 20.0  # of one measurement [s]
_UPDATES = 30.0  # that a browser shows [1/s]
_SLOWDOWN = 1.1  # accepted


@contextlib.contextmanager
def _load(environment: dict[str, str], rate: float) -> Iterator[None]:
    """Publish what three pairs publish."""
    script = str(Path(__file__).with_name('host_load.py'))
    command = [sys.executable, script]
    running = [subprocess.Popen([*command, *pair, str(rate)], env=environment) for pair in _PAIRS]
    try:
        yield
    finally:
        for process in running:
            process.terminate()
            process.wait()


def _streamed(host: Member, address: str, number: int, seconds: float) -> list[Figure]:
    """Measure the host while so many browsers take its streams."""
    views = [_VIEWS[i % len(_VIEWS)] for i in range(number)]
    asyncio.run(streams(address, views, _WARM_UP))
    used, kept, began = cpu(host), memory(host), time.monotonic()
    received = asyncio.run(streams(address, views, seconds))
    took = time.monotonic() - began
    of = f'{number} browser{"s" if number > 1 else ""}'
    goal = 30.0 if number == 1 else None
    slowest = min(count for count, _ in received) / took
    return [
        Figure(f'host, CPU time, {of}', 100.0 * (cpu(host) - used) / took, '% of a core', goal),
        Figure(f'host, ranges of each of three pairs, {of}', received[0][1], '1/s'),
        Figure(f'host, updates of the slowest, {of}', slowest, '1/s'),
        Figure(f'host, growth of memory in {seconds:g} s, {of}', memory(host) - kept, 'MB', 20.0),
    ]


def _opened(executable: str, folder: Path) -> list[Figure]:
    environment = private_environment()
    with _load(environment, _USUAL_RATE), Graph(environment, folder / 'opened') as graph:
        _, address = start_host(graph, folder)
        time.sleep(_WARM_UP)
        opened = open_pages(executable, address)
    return [
        Figure('host, first paint of the slowest view', opened.paint, 's', 1.0),
        Figure('host, largest page with all that it loads, compressed', opened.size, 'MB', 1.5),
    ]


def bench_host(seconds: float, console: Console) -> list[Figure]:
    """The host's page beside three pairs at 1000 sweeps/s and a real graph: CPU, memory, updates, paint, slow-down."""
    part = min(seconds, _LONGEST)
    figures = []
    executable = chromium()
    if executable is None:
        console.print('host: no Chromium on this machine, so nothing is measured in one', highlight=False)
    with tempfile.TemporaryDirectory(prefix='drfmcw-bench-') as directory:
        folder = Path(directory)
        environment = private_environment()
        with _load(environment, _RATE), Graph(environment, folder / 'log') as graph:
            host, address = start_host(graph, folder)
            time.sleep(_WARM_UP)
            for number in (1, _CLIENTS):
                console.print(f'host: {number} browsers, {part:g} s', highlight=False)
                figures += _streamed(host, address, number, part)
            if executable is not None:
                shown = show_distance(executable, address, part)
                figures += [
                    Figure('host, updates that a Chromium shows', shown.updates, '1/s', 0.99 * _UPDATES, '>='),
                    Figure('host, frames that it drops meanwhile', 100.0 * shown.dropped, '%', 0.0),
                ]
        if executable is not None:
            figures += _opened(executable, folder)
        figures += _slowed(seconds, folder, console)
    return [*figures, Figure('load of the machine (processes that run or wait, 1 min)', os.getloadavg()[0])]


def _slowed(seconds: float, folder: Path, console: Console) -> list[Figure]:
    """Measure what the host costs a real graph, at a crane's rate and at the largest."""
    usual, full = (slowed(rate, seconds, folder / f'graph {rate:g}', console) for rate in (RATE, FULL_RATE))
    return [
        *(
            Figure(
                f'graph at {rate:g} sweep pairs/s: reached beside a host',
                found.rate_with,
                '1/s',
                found.rate_without / _SLOWDOWN,
                '>=',
                reference=found.rate_without,
                reference_name='beside a process that sleeps',
            )
            for rate, found in ((RATE, usual), (FULL_RATE, full))
        ),
        Figure(
            f'graph at {RATE:g} sweep pairs/s: latency p50 beside a host',
            1e3 * usual.latency_with,
            'ms',
            reference=1e3 * usual.latency_without,
            reference_name='beside a process that sleeps',
        ),
        Figure(f'the same, mean ratio of {ROUNDS} rounds, less 1', 100.0 * usual.longer, '%'),
        Figure('standard error of that', 100.0 * usual.error, '%'),
    ]
