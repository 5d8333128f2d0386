"""Speed of the simulator: both stations' IF per second of CPU time, and recordings by one and two processes."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import references
from figures import Figure
from measuring import rates
from rich.console import Console

from drfmcw_ros.commands.config_files import find_config
from drfmcw_sim.recording import write_recording
from drfmcw_sim.scenario import Scenario, read_scenario
from drfmcw_sim.synthesis.signal_model import synthesise
from drfmcw_sim.timeline import Timeline

_TRIALS = 256
_PLAIN_TRIALS = 16  # at once in float64: the fastest number, by the processor's cache
_GOAL = 6000.0  # trials/s
_RECORDED = 12000  # sweep pairs
_EQUAL = 'stations.master.alpha=1', 'stations.slave.alpha=1'
_APART = 'stations.master.alpha=1.00001', 'stations.slave.alpha=0.99999'
_QUIET = tuple(f'stations.{s}.phase_noise_level=nan' for s in ('master', 'slave'))
_EFFECTS = (
    'effects=['
    '{effect: echo, excess_range: 3, relative_power: -20}, {effect: delay_offset, delay: 1},'
    '{effect: delay_temperature, slope: 10}, {effect: amplitude_loss, loss: 3},'
    '{effect: reference_clock_temperature, slope: 0.05}, {effect: sample_clock_offset, deviation: 1},'
    '{effect: noise_floor, excess: 3}, {effect: spur, frequency: 2e5, level: -60},'
    '{effect: tx_leakage, level: -30}, {effect: reference_clock_offset, deviation: 1}]'
)


def _scenario(*overrides: str) -> Scenario:
    """Return the gantry's measurements at 100 m."""
    standing = 'pairs.0.standing.distances=[100]', f'pairs.0.standing.sweeps={_RECORDED}'
    return read_scenario(find_config('gantry'), (*standing, *overrides))


def _synthesis(*overrides: str) -> Callable[[], int]:
    """Return a function that makes both stations' samples of the scenario's first measurements."""
    scenario = _scenario(*overrides)
    timeline = Timeline(scenario)
    measurements = timeline.measurements(timeline.slots(_TRIALS), 0)

    def work() -> int:
        synthesise(measurements, scenario.seed, scenario.effects)
        return _TRIALS

    return work


def _plain(first: float, second: float) -> Callable[[], int]:
    """Return a function that makes both stations' samples in plain NumPy."""

    def work() -> int:
        references.two_station_if(_PLAIN_TRIALS, 1, alphas=(first, second), start_delay_jitter=1e-10)
        return _PLAIN_TRIALS

    return work


def _scikit_radar() -> int:
    references.scikit_radar_if(_TRIALS)
    return _TRIALS


def _recordings(seconds: float) -> dict[int, float]:
    """Return sweep pairs per second into a recording, by number of processes: the best of some in turns."""
    best = {1: 0.0, 2: 0.0}
    with tempfile.TemporaryDirectory(prefix='drfmcw-bench-') as directory:
        for _ in range(3 if seconds >= 10.0 else 1):
            for jobs in best:
                start = time.perf_counter()
                count = write_recording(_scenario(), Path(directory) / 'recording', overwrite=True, jobs=jobs)
                best[jobs] = max(best[jobs], count / (time.perf_counter() - start))
    return best


def bench_simulation(seconds: float, console: Console) -> list[Figure]:
    """Measure trials per second beside the same job in plain NumPy and scikit-radar, and rendering of recordings."""
    jobs = {
        'equal': _synthesis(*_EQUAL),
        'apart': _synthesis(*_APART),
        'iq': _synthesis(*_EQUAL, 'waveform.iq=true'),
        'effects': _synthesis(*_APART, _EFFECTS),
        'quiet': _synthesis(*_EQUAL, *_QUIET),
        'plain equal': _plain(1.0, 1.0),
        'plain apart': _plain(1.00001, 0.99999),
    }
    try:
        references.scikit_radar()
        jobs['scikit-radar'] = _scikit_radar
    except ImportError as error:
        console.print(f'left out: {error}', style='yellow')
    rate = rates(jobs, seconds, console, 'simulation')
    recordings = _recordings(seconds)
    trials, pairs, numpy = 'trials/s', 'sweep pairs/s', 'NumPy float64'
    return [
        Figure('simulation: both stations, phase noise', rate['equal'], trials, _GOAL, '>=',
               reference=rate['plain equal'], reference_name=numpy),
        Figure('simulation: the same, clocks 20 ppm apart', rate['apart'], trials, _GOAL, '>=',
               reference=rate['plain apart'], reference_name=numpy),
        Figure('simulation: the same, I/Q', rate['iq'], trials),
        Figure('simulation: the same, ten effects', rate['effects'], trials),
        Figure('simulation: one line in noise', 2.0 * rate['quiet'], 'sweeps/s',
               reference=rate.get('scikit-radar'), reference_name='scikit-radar' if 'scikit-radar' in rate else ''),
        Figure('simulation: recording, one process', recordings[1], pairs),
        Figure('simulation: recording, two processes', recordings[2], pairs,
               reference=recordings[1], reference_name='one process'),
    ]  # fmt: skip
