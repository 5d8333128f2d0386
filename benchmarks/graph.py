"""Loss, latency and CPU time of the live graph: real processes over DDS, spectra on."""

import dataclasses
import gc
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from figures import Figure
from rich.console import Console
from rich.progress import track
from rich.table import Table

from drfmcw_bringup.graph import FUSION, REPLAY, SIMULATOR, STATION, Graph, Member, parameters, private_environment
from drfmcw_bringup.monitor import RangeMonitor, monitored
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.config_files import find_config
from drfmcw_sim.recording import write_recording
from drfmcw_sim.scenario import read_scenario

_PAIR, STATIONS = 'master/slave', ('master', 'slave')
_TICKS = os.sysconf('SC_CLK_TCK')
_START_LIMIT = 60.0  # until the first range [s]
_WARM_UP = 3.0  # not measured: discovery, first use of every code path [s]
_LATENCY_GOAL = 10.0  # [ms]
_RECORDED = 10.0  # length of the recording that is played in a loop [s]
_SPEED_UP = 2.0  # of playing: a sweep of 1 ms cannot be recorded every millisecond


@dataclasses.dataclass(frozen=True)
class Run:
    """What one run of the graph showed."""

    published: int  # sweep pairs in the measured time, by their numbers
    received: int
    seconds: float
    latency: np.ndarray  # of each range [s]
    cpu: dict[str, float]  # process: CPU seconds used in the measured time


def scenario_overrides(rate: float, duration: float) -> tuple[str, ...]:
    """Return changes of the crane scenario: a slow drive of `duration` seconds at `rate` sweep pairs per second."""
    distance = 0.5 * duration + 10.0
    return (
        f'timing.sweep_interval={1.0 / rate!r}',
        f'pairs.0.drive.waypoints=[100.0, {100.0 + distance!r}]',
        'pairs.0.drive.speed=0.5',
    )


def _cpu_time(member: Member) -> float:
    fields = Path(f'/proc/{member.process.pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def await_first(graph: Graph, monitor: RangeMonitor) -> None:
    """Wait for the first range.

    Raises:
        ConfigurationError: none came, or a process ended.
    """
    end = time.monotonic() + _START_LIMIT
    while not monitor.total:
        failed = [m for m in graph.tend() if m.process.returncode]
        if failed or time.monotonic() > end:
            words = graph.last_words(failed[0]) if failed else f'no range within {_START_LIMIT:g} s'
            raise ConfigurationError(f'graph: {words}')
        time.sleep(0.05)


def _measure(graph: Graph, monitor: RangeMonitor, seconds: float, name: str, console: Console) -> Run:
    await_first(graph, monitor)
    gc.disable()  # of this process, which keeps every range: its pauses are not the graph's
    time.sleep(_WARM_UP)
    begin_time, begin_cpu = time.time_ns(), {n: _cpu_time(m) for n, m in graph.members.items()}
    for _ in track(range(round(seconds * 10)), description=name, console=console, transient=True):
        time.sleep(0.1)
    end_time, end_cpu = time.time_ns(), {n: _cpu_time(m) for n, m in graph.members.items()}
    time.sleep(1.0)  # what is still on its way
    for member in graph.tend():
        raise ConfigurationError(f'graph: {member.name} ended: {graph.last_words(member)}')
    gc.enable()
    measured = [a for a in monitor.arrivals if begin_time <= a.stamp < end_time]
    if not measured:
        raise ConfigurationError('graph: no range in the measured time')
    numbers = np.array([a.sweep_id for a in measured])
    return Run(
        published=int(numbers.max() - numbers.min() + 1),
        received=len(np.unique(numbers)),
        seconds=(end_time - begin_time) * 1e-9,
        latency=np.array([a.received - a.stamp for a in measured]) * 1e-9,
        cpu={n: end_cpu[n] - begin_cpu[n] for n in end_cpu},
    )


def start_fusion_and_stations(graph: Graph) -> None:
    """Start fusion and both stations."""
    graph.start('fusion', FUSION, '--pair', _PAIR)
    for station in STATIONS:
        graph.start(f'station {station}', STATION, '--station', station, *parameters({'spectrum': True}))


def _runs(seconds: float, directory: Path, console: Console) -> Iterator[tuple[str, float, Run]]:
    """Yield (name, rate asked for, run) of the simulated and of the played graph."""
    scenario = find_config('crane')
    for source, rate in (('simulator', 500.0), ('recording', 1000.0)):
        environment = private_environment()
        domain = int(environment['ROS_DOMAIN_ID'])
        name = f'{rate:g} sweep pairs/s from the {source}'
        with (
            Graph(environment, directory / source) as graph,
            monitored([_PAIR], domain, keep=True) as monitor,
        ):
            start_fusion_and_stations(graph)
            total = seconds + 60.0
            if source == 'simulator':
                overrides = '[' + ', '.join(f'"{o}"' for o in scenario_overrides(rate, total)) + ']'
                graph.start('simulator', SIMULATOR, *parameters({'scenario': scenario, 'overrides': overrides}))
            else:
                played = directory / 'played'
                write_recording(read_scenario(scenario, scenario_overrides(rate / _SPEED_UP, _RECORDED)), played)
                graph.start(
                    'player', REPLAY, str(played), '--publish', '--restamp', '--loop', '0', '--rate', str(_SPEED_UP)
                )
            yield name, rate, _measure(graph, monitor, seconds, name, console)


def bench_graph(seconds: float, console: Console) -> list[Figure]:
    """Run the live graph at 500 simulated and 1000 played sweep pairs per second; print where the time goes."""
    figures = []
    with tempfile.TemporaryDirectory(prefix='drfmcw-bench-') as directory:
        for name, rate, run in _runs(seconds, Path(directory), console):
            figures += [
                Figure(f'{name}: reached', run.received / run.seconds, 'ranges/s', 0.99 * rate, '>='),
                Figure(f'{name}: lost', run.published - run.received, f'of {run.published}', 0),
                Figure(f'{name}: latency p50', float(np.percentile(run.latency, 50)) * 1e3, 'ms'),
                Figure(f'{name}: latency p99', float(np.percentile(run.latency, 99)) * 1e3, 'ms', _LATENCY_GOAL),
                Figure(f'{name}: latency max', float(run.latency.max()) * 1e3, 'ms'),
            ]
            cpu = Table('process', 'CPU [% of a core]', 'per sweep pair [us]', title=name, header_style='bold')
            for process, used in run.cpu.items():
                cpu.add_row(process, f'{100 * used / run.seconds:.0f}', f'{1e6 * used / run.received:.0f}')
            console.print(cpu)
    return figures
