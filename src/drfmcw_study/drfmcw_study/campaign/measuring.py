"""One case of the campaign: a pair measured by the nodes' own classes, clean at first, then with the fault."""

import dataclasses
import math
from typing import Any

import numpy as np
from sensor_msgs.msg import FluidPressure, RelativeHumidity, Temperature

from drfmcw_fusion.offline import read_weather
from drfmcw_fusion.pipeline import Flag, RangeFusion, RangeResult
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.processing.pair_processor import PairProcessor
from drfmcw_node.processing.processor import StationProcessor
from drfmcw_node.processing.records import Beat, Sweep
from drfmcw_physics.rules.history import LIVE
from drfmcw_physics.rules.mode import choose_mode
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.graph.messages import ImplausibleError
from drfmcw_sim.measurements import Measurements
from drfmcw_sim.scenario import Scenario, scenario_from_mapping
from drfmcw_sim.synthesis.signal_model import synthesise
from drfmcw_sim.timeline import NANOSECONDS, Slots, Timeline

from .faults import Fault

ESTIMATORS = ('paper', 'hann', 'ml', 'pair')
DISTANCES = (60.0, 300.0, 900.0)
WRONG = 5.0
"""Standard deviations beyond which an error makes a range wrong."""

INTERVAL = 0.02  # between sweeps [s]
CLEAN = 60  # sweeps before the fault
_SPEED = 1.5  # of every second case, in the sense of a range that grows [m/s]
UNUSABLE = Flag.WEAK_SIGNAL | Flag.MODE_MISMATCH | Flag.SIGNAL_QUALITY | Flag.OUT_OF_LIMITS
_MESSAGES: dict[str, tuple[type, str]] = {
    '/site/temperature': (Temperature, 'temperature'),
    '/site/pressure': (FluidPressure, 'fluid_pressure'),
    '/site/humidity': (RelativeHumidity, 'relative_humidity'),
}
_WEATHER = {'/site/temperature': 15.0, '/site/pressure': 1e5, '/site/humidity': 0.5}


@dataclasses.dataclass(frozen=True)
class Case:
    """What is tried."""

    fault: Fault
    distance: float  # [m]
    estimator: str
    speed: float  # [m/s]
    sweeps: int  # with the fault
    seed: int


@dataclasses.dataclass(frozen=True)
class Counts:
    """What came of a case, of the sweeps with the fault."""

    sweeps: int
    valid: int  # a finite range, whose standard deviation is stated
    wrong: int  # of these, off by more than `WRONG` standard deviations
    beyond: int  # of the valid ones, off by more than their protection level
    undetected: int  # sweeps before the first one with a flag, all of them where none has one
    worst: float  # error of a valid range [m]


def measure(case: Case) -> Counts:
    """Return what comes of a case."""
    clean, faulty = scenario_of(case, ()), scenario_of(case, case.fault.effects)
    m = conditions(clean, case, 0.0)
    sweeps = sweeps_of(case, clean, m, synthesise(m, clean.seed, clean.effects), _faulty_samples(case, faulty))
    beats = beats_of(case, clean, m, sweeps)
    results = {r.sweep_id: r for r in _ranges(case, clean, m, beats)}
    return _counts(case, m, results)


def scenario_of(case: Case, effects: tuple[dict[str, Any], ...]) -> Scenario:
    """Return a site with one pair, nothing but `effects` wrong."""
    station = {'noise_floor': -140.7, 'phase_noise_level': -90.0, 'phase_noise_corner': 200e3}
    return scenario_from_mapping(
        {
            'stations': {
                'master': station | {'alpha': 1.000006, 'delay': 12e-9},
                'slave': station | {'alpha': 0.999991, 'delay': 15e-9},
            },
            'pairs': [{'first': 'master', 'second': 'slave', 'standing': {'distances': [case.distance], 'sweeps': 1}}],
            'timing': {'sweep_interval': INTERVAL},
            'weather': {name.rpartition('/')[2]: value for name, value in _WEATHER.items()},
            'effects': list(effects),
            'seed': case.seed,
        },
        'campaign',
    )


def conditions(scenario: Scenario, case: Case, farther: float) -> Measurements:
    """Return what determines the sweeps of a crane that moves at constant speed."""
    timeline = Timeline(scenario)
    timeline.change_mode(0, choose_mode(None, case.distance, scenario.mode), None)
    n = CLEAN + case.sweeps
    time = np.arange(n) * INTERVAL
    slots = Slots(
        sweep_id=np.arange(n),
        time=time,
        pair=np.zeros(n, int),
        distance=case.distance + farther + case.speed * time,
        velocity=np.full(n, case.speed),
        acceleration=np.zeros(n),
    )
    return timeline.measurements(slots, 0)


def _faulty_samples(case: Case, scenario: Scenario) -> tuple[np.ndarray, ...]:
    """Return both stations' records as the fault leaves them, of all sweeps."""
    samples = synthesise(conditions(scenario, case, case.fault.farther), scenario.seed, scenario.effects)
    if case.fault.samples is None:
        return samples
    hit = [s[CLEAN:] for s in samples]
    changed = case.fault.samples((hit[0], hit[1]), np.random.default_rng(case.seed))
    return tuple(np.concatenate([s[:CLEAN], c]) for s, c in zip(samples, changed, strict=True))


def sweeps_of(
    case: Case, scenario: Scenario, m: Measurements, clean: tuple[np.ndarray, ...], faulty: tuple[np.ndarray, ...]
) -> list[Sweep]:
    """Return both stations' sweeps, `faulty` ones where the fault hits."""
    generator = np.random.default_rng(case.seed + 1)
    hit = (np.arange(len(m)) >= CLEAN) & (generator.random(len(m)) < case.fault.share)
    start = round(scenario.timing.start_time * NANOSECONDS)
    sweeps = []
    for i in range(len(m)):
        for number, station in enumerate(m.stations):
            stamp = start + round(float(m.time[i]) * NANOSECONDS)
            if number:
                stamp += round(station.sweep.start_delay * NANOSECONDS)
                stamp += case.fault.first_stamp * round(INTERVAL * NANOSECONDS) * bool(hit[i])
            rows = faulty if hit[i] else clean
            names = station.sweep.station, station.sweep.peer
            sweeps.append(Sweep(*names, i, float(station.full_scale), station.iq, rows[number][i], stamp, names[0]))
    return sweeps


def _settings(case: Case, m: Measurements) -> list[SweepSettings]:
    found = [s.sweep for s in m.stations]
    if case.fault.said_mode is None:
        return found
    return [dataclasses.replace(s, mode=case.fault.said_mode) for s in found]


def processor_of(case: Case, scenario: Scenario, m: Measurements) -> StationProcessor:
    """Return a processor of both stations that knows settings and calibrations."""
    settings = EstimatorSettings(estimator=case.estimator)
    processor = PairProcessor(settings, LIVE) if case.estimator == 'pair' else StationProcessor(settings, LIVE)
    for sweep in _settings(case, m):
        processor.add_sweep_config(sweep)
        processor.add_calibration(scenario.calibration(sweep.station))
    return processor


def beats_of(case: Case, scenario: Scenario, m: Measurements, sweeps: list[Sweep]) -> list[Beat]:
    """Return what the stations make of sweeps, in order."""
    processor = processor_of(case, scenario, m)
    beats = processor.process(sweeps)
    if isinstance(processor, PairProcessor):
        beats += processor.finish()
    return sorted(beats, key=lambda beat: (beat.stamp, beat.sweep_id))


def fresh_fusion(case: Case, scenario: Scenario, m: Measurements) -> RangeFusion:
    """Return a fusion that knows settings, calibrations, weather and what else the fault says."""
    fusion = RangeFusion(kept=LIVE)
    start = round(scenario.timing.start_time * NANOSECONDS)
    begin = start + round(CLEAN * INTERVAL * NANOSECONDS)
    give_weather(fusion, start - 1)
    if case.fault.weather is not None:
        _add_weather(fusion, *case.fault.weather, begin)
    for sweep in _settings(case, m):
        fusion.add_sweep_config(sweep)
        fusion.add_calibration(scenario.calibration(sweep.station))
        fusion.add_lock(sweep.station, start - 1, True)
    if case.fault.unlocked:
        fusion.add_lock(m.stations[1].name, begin, False)
    return fusion


def _ranges(case: Case, scenario: Scenario, m: Measurements, beats: list[Beat]) -> list[RangeResult]:
    fusion = fresh_fusion(case, scenario, m)
    low, high = case.fault.jitter
    delays = np.random.default_rng(case.seed + 2).uniform(low, high, len(beats))
    arrivals = np.array([b.stamp * 1e-9 for b in beats]) + delays
    if high > 0.0:
        beats = [beats[i] for i in np.argsort(arrivals, kind='stable')]
    found = (fusion.add_beat(beat, number * 1e-6) for number, beat in enumerate(beats))
    return [result for result in found if result is not None]


def give_weather(fusion: RangeFusion, stamp: int) -> None:
    """Hand a reading of each weather sensor to the fusion, as at the site of `scenario_of`."""
    for topic, value in _WEATHER.items():
        _add_weather(fusion, topic, value, stamp)


def _add_weather(fusion: RangeFusion, topic: str, value: float, stamp: int) -> None:
    """Hand a reading to the fusion as its node does; a refused one leaves the last."""
    kind, field = _MESSAGES[topic]
    try:
        quantity, read = read_weather(topic, kind(**{field: value}))
    except ImplausibleError:
        return
    fusion.add_weather(quantity, stamp, read)


def _counts(case: Case, m: Measurements, results: dict[int, RangeResult]) -> Counts:
    valid = wrong = beyond = 0
    undetected, worst = case.sweeps, 0.0
    for i in range(CLEAN, len(m)):
        result = results.get(i)
        if result is None or result.flags & ~Flag.UNKNOWN_VELOCITY:
            undetected = min(undetected, i - CLEAN)
        if result is None or result.flags & (UNUSABLE | Flag.UNKNOWN_VELOCITY) or not math.isfinite(result.range):
            continue
        error = abs(result.range - float(m.range[i]))
        valid += 1
        wrong += error > WRONG * result.range_std
        beyond += error > result.protection_level
        worst = max(worst, error)
    return Counts(case.sweeps, valid, wrong, beyond, undetected, worst)


def cases(fault: Fault, sweeps: int, seed: int) -> list[Case]:
    """Return the cases of a fault: every distance and estimator, standing and moving in turn."""
    found = []
    for estimator in ESTIMATORS:
        for number, distance in enumerate(DISTANCES):
            speed = _SPEED if (number + ESTIMATORS.index(estimator)) % 2 else 0.0
            found.append(Case(fault, distance, estimator, speed, sweeps, seed + number))
    return found
