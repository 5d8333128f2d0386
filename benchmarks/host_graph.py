"""Whether the host slows a real graph: rate and latency of its ranges beside it, and beside a process that sleeps."""

import contextlib
import dataclasses
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import host_process
import numpy as np
from graph import await_first, scenario_overrides, start_fusion_and_stations
from host_process import start_host
from rich.console import Console
from rich.progress import track

from drfmcw_bringup.graph import SIMULATOR, Graph, parameters, private_environment
from drfmcw_bringup.monitor import RangeMonitor, monitored
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.config_files import find_config

RATE, FULL_RATE = 200.0, 900.0
"""Sweep pairs per second of a crane, and of a graph that is nearly as fast as it can be."""

ROUNDS = 10
"""Times beside each, in turns: a single slice of some seconds is off by a tenth."""

_PAIR = 'master/slave'
_SETTLE = 3.0  # after a process has started [s]
_VIEWS = ('now', 'signals')  # that browsers show meanwhile; for "Signals" stations send spectra


@dataclasses.dataclass(frozen=True)
class Slowed:
    """Medians over the rounds, and what is the same for each round."""

    rate_without: float  # [1/s]
    rate_with: float
    latency_without: float  # median of a round [s]
    latency_with: float
    longer: float  # mean over the rounds, of the latency with the host over that without, less 1 [1]
    error: float  # standard error of this mean [1]


def _slice(monitor: RangeMonitor, seconds: float) -> tuple[float, float]:
    """Return (ranges per second, median latency [s]) of the next seconds.

    Raises:
        ConfigurationError: nothing came.
    """
    time.sleep(_SETTLE)
    begin, first = time.monotonic(), len(monitor.arrivals)
    time.sleep(seconds)
    took, arrived = time.monotonic() - begin, monitor.arrivals[first:]
    if not arrived:
        raise ConfigurationError('graph: no range in the measured time')
    return len(arrived) / took, float(np.median([a.received - a.stamp for a in arrived])) * 1e-9


@contextlib.contextmanager
def _sleeper() -> Iterator[None]:
    """Start a process that does nothing: starting any shifts the latency by some per cent."""
    with subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(3600.0)']) as process:
        yield
        process.kill()


@contextlib.contextmanager
def _host(graph: Graph, folder: Path, seconds: float) -> Iterator[None]:
    """Start a host and two browsers for some seconds."""
    _, address = start_host(graph, folder)
    command = [sys.executable, host_process.__file__, address, str(seconds), *_VIEWS]
    with subprocess.Popen(command) as watching:  # not in this process, which takes the ranges
        yield
    graph.stop('host')
    if watching.returncode:
        raise ConfigurationError('host: its pages could not be watched; see above')


def slowed(rate: float, seconds: float, folder: Path, console: Console) -> Slowed:
    """Measure the same running graph beside a sleeping process, and beside a host and two open pages, in turns."""
    environment = private_environment()
    part = seconds / (2 * ROUNDS)
    rounds: list[tuple[tuple[float, float], tuple[float, float]]] = []
    with (
        Graph(environment, folder / 'log') as graph,
        monitored([_PAIR], int(environment['ROS_DOMAIN_ID']), keep=True) as monitor,
    ):
        start_fusion_and_stations(graph)
        overrides = '[' + ', '.join(f'"{o}"' for o in scenario_overrides(rate, 10.0 * seconds + 300.0)) + ']'
        graph.start('simulator', SIMULATOR, *parameters({'scenario': find_config('crane'), 'overrides': overrides}))
        await_first(graph, monitor)
        name = f'host beside a graph at {rate:g}/s'
        for _ in track(range(ROUNDS), description=name, console=console, transient=True):
            with _sleeper():
                without = _slice(monitor, part)
            with _host(graph, folder / 'host', _SETTLE + part):
                rounds.append((without, _slice(monitor, part)))
    ratios = np.array([beside[1] / without[1] for without, beside in rounds])
    return Slowed(
        rate_without=statistics.median(without[0] for without, _ in rounds),
        rate_with=statistics.median(beside[0] for _, beside in rounds),
        latency_without=statistics.median(without[1] for without, _ in rounds),
        latency_with=statistics.median(beside[1] for _, beside in rounds),
        longer=float(ratios.mean()) - 1.0,
        error=float(ratios.std(ddof=1)) / len(ratios) ** 0.5,
    )
