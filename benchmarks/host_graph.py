"""Whether the host slows a real graph: rate and latency of its ranges with and without it, in turns."""

import dataclasses
import statistics
import subprocess
import sys
import time
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
from drfmcw_ros.config_files import find_config

RATE = 200.0
"""Sweep pairs per second of the graph."""

_PAIR = 'master/slave'
_ROUNDS = 4  # times without and with
_SETTLE = 3.0  # after the host has started or ended [s]
_VIEWS = ('now', 'signals')  # that browsers show meanwhile; for "Signals" stations send spectra


@dataclasses.dataclass(frozen=True)
class Slowed:
    """Medians over the rounds."""

    rate_without: float  # [1/s]
    rate_with: float
    latency_without: float  # median of a round [s]
    latency_with: float


def _slice(monitor: RangeMonitor, seconds: float) -> tuple[float, float]:
    """Return (ranges per second, median latency [s]) of the next seconds.

    Raises:
        ConfigurationError: nothing came.
    """
    begin, first = time.monotonic(), len(monitor.arrivals)
    time.sleep(seconds)
    took, arrived = time.monotonic() - begin, monitor.arrivals[first:]
    if not arrived:
        raise ConfigurationError('graph: no range in the measured time')
    return len(arrived) / took, float(np.median([a.received - a.stamp for a in arrived])) * 1e-9


def slowed(seconds: float, folder: Path, console: Console) -> Slowed:
    """Measure the same running graph without and with a host and two open pages, in turns."""
    environment = private_environment()
    part = seconds / (2 * _ROUNDS)
    rounds: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
    with (
        Graph(environment, folder / 'log') as graph,
        monitored([_PAIR], int(environment['ROS_DOMAIN_ID']), keep=True) as monitor,
    ):
        start_fusion_and_stations(graph)
        overrides = '[' + ', '.join(f'"{o}"' for o in scenario_overrides(RATE, 10.0 * seconds + 300.0)) + ']'
        graph.start('simulator', SIMULATOR, *parameters({'scenario': find_config('crane'), 'overrides': overrides}))
        await_first(graph, monitor)
        for _ in track(range(_ROUNDS), description='host beside a graph', console=console, transient=True):
            time.sleep(_SETTLE)
            rounds[False].append(_slice(monitor, part))
            _, address = start_host(graph, folder / 'host')
            command = [sys.executable, host_process.__file__, address, str(_SETTLE + part), *_VIEWS]
            with subprocess.Popen(command) as watching:  # not in this process, which takes the ranges
                time.sleep(_SETTLE)
                rounds[True].append(_slice(monitor, part))
            if watching.returncode:
                raise ConfigurationError('host: its pages could not be watched; see above')
            graph.stop('host')
    (rate_without, latency_without), (rate_with, latency_with) = (
        [statistics.median(values) for values in zip(*rounds[with_host], strict=True)] for with_host in (False, True)
    )
    return Slowed(rate_without, rate_with, latency_without, latency_with)
