"""Monte Carlo points of the paper's figures: simulated over all cores, and what the physics predicts for them."""

import copy
import dataclasses
import functools
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.estimators.noise import QUANTISATION
from drfmcw_physics import bounds
from drfmcw_physics.air import refractive_index
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import delay_from_beat_sum
from drfmcw_physics.phase_noise import PhaseNoise
from drfmcw_physics.settings import read_yaml
from drfmcw_physics.sweep import Mode, SweepSettings, beat_frequency
from drfmcw_ros.commands.config_files import find_config
from drfmcw_sim.measurements import Measurements, Station
from drfmcw_sim.scenario import Scenario, scenario_from_mapping

from ..measurement import Trials, conditions, measure
from ..trials.results import ResultDirectory
from ..trials.running import run as run_study
from ..trials.study import Study, point_seed

IF_BAND = 1.024e6
"""IF bandwidth to which a noise power belongs, half of Table 1's sampling rate [Hz]."""

NOISE_FLOORS = {'A': -97.7, 'B': -80.6}
"""Noise power in the whole IF band, at the receive antenna port [dBm]; the paper gives none, see `claims`."""


_BATCH = 500  # trials that a worker gets at once


def floor_density(name: str) -> float:
    """Return the noise density of floor 'A' or 'B' at the receive antenna port [dBm/Hz]."""
    return NOISE_FLOORS[name] - 10.0 * float(np.log10(IF_BAND))


@functools.cache
def _site(name: str) -> dict[str, Any]:
    return read_yaml(find_config(name))


def site(
    name: str, distance: float, *, floor: str = 'B', alphas: tuple[float, float] | None = None, **sections: Any
) -> dict[str, Any]:
    """Return a scenario of config/ as a mapping, with one distance, its stations' noise floor and clocks changed.

    Args:
        name: 'gantry' (the crane) or 'cable' (the laboratory).
        distance: of the antennas; of the laboratory's cable, the length of air that delays alike [m].
        floor: 'A' or 'B'.
        alphas: references of both stations / nominal, with nominal ADC clocks; None keeps the site's.
        sections: replaced, or merged into those of the site where they are mappings; `station` holds for both
            stations, `pair` for the pair.
    """
    mapping = copy.deepcopy(_site(name))
    for number, station in enumerate(mapping['stations'].values()):
        station |= {'noise_floor': floor_density(floor), 'phase_noise_level': -90.0, 'phase_noise_corner': 200e3}
        if alphas is not None:
            station |= {'alpha': alphas[number], 'sample_clock_alpha': 1.0}
    mapping['pairs'][0]['standing'] = {'distances': [distance]}
    for key, value in sections.items():
        if key == 'pair':
            mapping['pairs'][0] |= value
        elif key == 'station':  # the same for both
            for station in mapping['stations'].values():
                station |= value
        else:
            mapping[key] = mapping.get(key, {}) | value if isinstance(value, dict) else value
    return mapping


@dataclasses.dataclass(frozen=True)
class Point:
    """One point of a figure: a standing pair measured again and again."""

    label: str  # unlike any other point's; together with the seed it decides the random numbers
    mapping: Mapping[str, Any]  # scenario, of `site`
    mode: Mode
    start_delay: float | None = None  # [s]; None: the scenario's for the mode

    @functools.cached_property
    def scenario(self) -> Scenario:
        """The scenario, with its own seed still to be given."""
        return scenario_from_mapping(self.mapping, self.label)

    def seeded(self, seed: int) -> Scenario:
        """Return the scenario with this point's own seed, which no other point and no choice of figures changes."""
        return dataclasses.replace(self.scenario, seed=point_seed(seed, self.label))

    def conditions(self, count: int = 1) -> Measurements:
        """Return what determines the IF signals of the first `count` sweeps, jitter and scatter still to be drawn."""
        return conditions(self.scenario, range(count), self.mode, self.start_delay)


@dataclasses.dataclass(frozen=True)
class Run:
    """How all points are simulated."""

    trials: int  # of each point
    seed: int  # of all random numbers
    estimator: EstimatorSettings  # of the beat frequencies

    def expected(self, prediction: 'Prediction') -> float:
        """Return the standard deviation that the estimator should have [m]."""
        return prediction.bound if self.estimator.estimator == 'ml' else prediction.windowed


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Statistics of a point's trials."""

    count: int
    bias: float  # mean range error [m]
    std: float  # of the range [m]
    reported_std: float  # root mean square of the standard deviations reported with the ranges [m]
    uncorrected_bias: float  # mean range error where every clock counts as nominal in eqs. 5 and 6 [m]
    synchronised_std: float  # of station 2 alone, perfectly synchronised [m]
    power: float  # mean received power as estimated by station 1 [dBm]

    @property
    def bias_error(self) -> float:
        """Standard error of the bias [m]."""
        return self.std / self.count**0.5

    @property
    def std_error(self) -> float:
        """Standard error of the standard deviation, Gaussian ranges [m]."""
        return self.std / (2.0 * (self.count - 1)) ** 0.5


def simulate(point: Point, run: Run, sweeps: range) -> dict[str, np.ndarray]:
    """Return the trials with these sweep numbers: errors of range, nominal and synchronised range [m], power [dBm]."""
    scenario = point.seeded(run.seed)
    result = measure(
        scenario,
        sweeps,
        mode=point.mode,
        start_delay=point.start_delay,
        estimator=run.estimator,
        synchronised=True,
    )
    return {
        'error': result.error,
        'variance': result.range_std**2,
        'nominal': _nominal_range(result, point, sweeps) - result.true_range,
        'synchronised': result.synchronised_range - result.true_range,
        'power': result.stations[0].power,
    }


def _nominal_range(result: Trials, point: Point, sweeps: range) -> np.ndarray:
    """Return the ranges by eqs. 5 and 6 alone: both clocks as nominal; weather and hardware delays are known [m]."""
    scenario = point.scenario
    m = conditions(scenario, sweeps, point.mode, point.start_delay)
    first, second = (s.sweep for s in m.stations)
    sign = second.line_sign() * first.line_sign()
    total = first.line_sign() * (result.stations[0].frequency - sign * result.stations[1].frequency)
    delay = delay_from_beat_sum(total, first.chirp_rate, 1.0, 1.0)
    hardware = sum(scenario.stations[s.station].delay for s in (first, second))
    return (delay - hardware) * SPEED_OF_LIGHT / _index(scenario, m.time)


def _try_point(order: Mapping[str, Any], sweeps: range) -> dict[str, np.ndarray]:
    """Return the trials of an order made by `simulate_all`: the task of `drfmcw_study.trials`."""
    point = Point(**{**order['point'], 'mode': Mode(order['point']['mode'])})
    run = Run(**{**order['run'], 'estimator': EstimatorSettings(**order['run']['estimator'])})
    return simulate(point, run, sweeps)


def simulate_all(
    points: Sequence[Point], run: Run, jobs: int, progress: Callable[[int], None] = lambda done: None
) -> list[Outcome]:
    """Measure points in `jobs` processes; the outcomes are in order, and the same whatever the number of processes.

    Args:
        points: with different labels.
        run: how they are simulated.
        jobs: number of processes; 1 works in this one.
        progress: called with the number of trials done.

    Raises:
        StudyStopped: a worker process died.
    """
    if not points:
        return []
    how = dataclasses.asdict(run)
    orders = [{'point': {f.name: getattr(p, f.name) for f in dataclasses.fields(p)}, 'run': how} for p in points]
    with tempfile.TemporaryDirectory(prefix='drfmcw-') as folder:
        study = Study(points=tuple(orders), trials=run.trials, batch=min(run.trials, _BATCH))
        with ResultDirectory(folder, study) as results:
            run_study(results, _try_point, jobs=jobs, progress=progress)
            return [_outcome(list(results.batches(number))) for number in range(len(points))]


def _outcome(batches: Sequence[Mapping[str, np.ndarray]]) -> Outcome:
    values = {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}
    return Outcome(
        count=len(values['error']),
        bias=float(values['error'].mean()),
        std=float(values['error'].std(ddof=1)),
        reported_std=float(np.sqrt(values['variance'].mean())),
        uncorrected_bias=float(values['nominal'].mean()),
        synchronised_std=float(values['synchronised'].std(ddof=1)),
        power=float(values['power'].mean()),
    )


@dataclasses.dataclass(frozen=True)
class Prediction:
    """What `drfmcw_physics.bounds` says about the standard deviation of one measurement."""

    frequencies: tuple[float, float]  # of both stations' lines [Hz]
    windowed: float  # FFT, zoom and parabola with the estimator's window [m]
    bound: float  # Cramer-Rao bound under the coloured noise, for every unbiased estimator [m]
    synchronised: float  # station 2 alone, perfectly synchronised, with the window [m]


def phase_noises(m: Measurements) -> tuple[PhaseNoise, ...]:
    """Return each station's phase noise; one without has a density of zero."""
    return tuple(PhaseNoise(-math.inf, 1.0) if s.phase_noise is None else s.phase_noise for s in m.stations)


def predict(point: Point, window: str = 'hann') -> Prediction:
    """Return the standard deviations that follow from a point's link budget, noise floor and phase noise."""
    m = point.conditions()
    first, second = (s.sweep for s in m.stations)
    delay = float(m.paths[0].delay[0])
    start, end = first.analysis_window()
    duration, rate = end - start, first.sample_rate
    noises = phase_noises(m)
    offset = first.start_frequency - second.start_frequency  # f_o,off, of which a station's settings say nothing
    variances, lines = [], []
    for number, station in enumerate(m.stations):
        carrier_to_noise = 10.0 ** (float(station.received_power[0]) / 10.0) / additive_density(station)
        own, peer = float(station.alpha[0]), float(m.stations[1 - number].alpha[0])
        frequency = beat_frequency(station.sweep, delay, own, peer) + station.sweep.line_sign() * offset
        ratio = 1.0 / (carrier_to_noise * duration)
        ratio += sum(float(bounds.image_noise_ratio(n, frequency, duration, rate)) for n in noises)
        variances.append(bounds.additive_std(1.0 / ratio, duration, window) ** 2)
        lines.append(bounds.LineNoise(carrier_to_noise, frequency, rate))
    shared = sum(bounds.phase_noise_std(n, duration, window, delay) ** 2 for n in noises)
    whole = sum(bounds.phase_noise_std(n, duration, window) ** 2 for n in noises)
    per_hertz = velocity(point.scenario) / abs(2.0 * second.chirp_rate)
    return Prediction(
        frequencies=(lines[0].frequency, lines[1].frequency),
        windowed=per_hertz * float(np.sqrt(sum(variances) + shared)),
        bound=per_hertz * bounds.coloured_bound(tuple(lines), noises, duration, delay).frequency,
        synchronised=2.0 * per_hertz * float(np.sqrt(variances[1] + whole)),
    )


def additive_density(station: Station) -> float:
    """Return the density of a station's additive noise and quantisation noise at its antenna port [mW/Hz]."""
    unit = station.full_scale**2 / 2.0 / 10.0 ** (station.sweep.full_scale_power / 10.0)  # [LSB^2/mW]
    return 10.0 ** (float(station.noise_density[0]) / 10.0) + QUANTISATION / unit / (station.sweep.sample_rate / 2)


def velocity(scenario: Scenario) -> float:
    """Return the propagation velocity in the scenario's weather at its start [m/s]."""
    return SPEED_OF_LIGHT / float(_index(scenario, 0.0))


def _index(scenario: Scenario, time: np.ndarray | float) -> np.ndarray:
    """Return the refractive index at `time` since the scenario's start [s]."""
    weather = scenario.weather
    return refractive_index(weather.temperature.at(time), weather.pressure.at(time), weather.humidity.at(time))


def table_1() -> SweepSettings:
    """Return station 1's sweep of Table 1."""
    return Point('Table 1', site('gantry', 1000.0), Mode.SHORT_DISTANCE).conditions().stations[0].sweep
