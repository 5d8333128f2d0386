"""One rehearsed commissioning: calibrate two simulated stations indoors, then range with them outdoors."""

import dataclasses
import math
from typing import Any

import numpy as np

from drfmcw_physics.air import refractive_index
from drfmcw_physics.oscillators import Calibration
from drfmcw_ros.calibration.document import Document
from drfmcw_sim.scenario import Scenario, scenario_from_mapping
from drfmcw_sim.trajectory import Standing

from ..indoors.curve import fit
from ..indoors.noise import receiver_noise
from ..indoors.oscillator import oscillator_noise
from ..indoors.path import KnownPath, path_calibration
from ..indoors.station import with_clocks, with_noise, with_oscillator, with_path
from .chain import Evaluated, evaluate, heard

FIRST, SECOND = 'slave', 'master'
"""The slower reference starts first: references 59 ppm apart act as 2.3 us of T_off, which T_off makes up for."""


@dataclasses.dataclass(frozen=True)
class Truth:
    """True state of one station, at 25 degC where it depends on the board temperature."""

    alpha: float  # [1]
    sample_clock: float  # [1]
    linear: float  # of the AT-cut curve [1/K]
    cubic: float  # [1/K^3]
    delay: float  # [s]
    delay_slope: float  # [s/K]
    noise_floor: float  # [dBm/Hz]
    phase_noise_level: float  # single side-band at 100 kHz [dBc/Hz]
    phase_noise_corner: float  # [Hz]


TRUTH = {
    'master': Truth(1.0 + 37e-6, 1.0 + 18e-6, -2.2e-7, 1.05e-10, 12.3e-9, 3e-12, -140.7, -90.0, 200e3),
    'slave': Truth(1.0 - 22e-6, 1.0 - 9e-6, -1.6e-7, 0.98e-10, 15.8e-9, 2e-12, -137.7, -92.0, 200e3),
}
"""Two stations with crystals of different cuts and oscillators of different noise (both chosen; the offsets, delays and
floors are those of issue 15)."""


@dataclasses.dataclass(frozen=True)
class Bench:
    """How the stations are calibrated indoors."""

    temperatures: tuple[float, ...] = (-10.0, -5.0, 0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0)  # [degC]
    counter_std: float = 0.005e-6  # of one reading [1]
    time_base_std: float = 0.02e-6  # of the counter's time base, the same in all readings [1]
    cable: float = 15.0  # electrical length [m]
    cable_std: float = 0.005  # [m]
    chambers: tuple[float, ...] = (-10.0, 4.0, 18.0, 32.0, 45.0)  # board temperatures of recordings through the cable
    sweeps: int = 8  # at each
    terminated: int = 20  # sweeps with the antennas terminated
    phase: int = 40  # sweeps through the cable for the phase noise


@dataclasses.dataclass(frozen=True)
class Field:
    """Where the stations range afterwards."""

    distances: tuple[float, ...] = (40.0, 150.0, 400.0, 620.0, 700.0, 1000.0)  # [m]
    coldest: float = -5.0  # board and air [degC]
    warmest: float = 40.0
    sweeps: int = 8  # at each distance


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Ranges at one distance after one commissioning."""

    distance: float  # [m]
    error: float  # mean of range minus distance [m]
    stated: float  # its standard deviation as stated: correlated part, and white part of the mean [m]
    correlated: float  # the correlated part alone [m]
    flags: int  # of all ranges
    without_curve: float  # mean error with the same calibration less its curves over the temperature [m]


def commission(seed: int, bench: Bench | None = None, field: Field | None = None) -> list[Outcome]:
    """Return what ranging shows after one commissioning with errors of counter, cable, noise and weather of its own."""
    bench, field = bench or Bench(), field or Field()
    random = np.random.default_rng([15, seed])
    documents = calibrate(random, bench)
    calibrations = {name: document.calibration() for name, document in documents.items()}
    flat = {name: _without_curves(c) for name, c in calibrations.items()}
    outcomes = []
    for distance in field.distances:
        air = random.uniform(field.coldest, field.warmest)
        boards = {name: float(np.clip(air + random.uniform(-3.0, 3.0), field.coldest, field.warmest)) for name in TRUTH}
        weather = {'temperature': air, 'pressure': random.uniform(98e3, 103e3), 'humidity': random.uniform(0.3, 0.9)}
        outdoors = _scenario(random, distance, boards, field.sweeps, {'weather': weather})
        found = evaluate(outdoors, calibrations)
        outcomes.append(_outcome(distance, found, _mean_error(evaluate(outdoors, flat))))
    return outcomes


def calibrate(random: np.random.Generator, bench: Bench) -> dict[str, Document]:
    """Return the documents of both stations.

    Clocks by a counter, noise floors with the antennas terminated, phase noise through the cable, both taken as equal,
    as one path shows their sum only; then the delay with each in a chamber, the other at 25 degC.
    """
    documents = {name: _clocks(name, random, bench) for name in TRUTH}
    dark = random.spawn(1)[0]
    for name, document in documents.items():
        terminated = _scenario(dark, bench.cable, dict.fromkeys(TRUTH, 25.0), bench.terminated, _TERMINATED)
        documents[name] = with_noise(document, receiver_noise(*heard(terminated, name)))
    length = bench.cable + bench.cable_std * random.standard_normal()
    for name, document in documents.items():
        through = _scenario(dark, length, dict.fromkeys(TRUTH, 25.0), bench.phase, _CABLE)
        documents[name] = with_oscillator(document, oscillator_noise(*heard(through, name)))
    path = KnownPath(bench.cable, bench.cable_std, in_air=False)
    for warm, peer in ((SECOND, FIRST), (FIRST, SECOND)):
        calibrations = {name: document.calibration() for name, document in documents.items()}
        runs = [
            evaluate(
                _scenario(random, length, {warm: chamber, peer: 25.0}, bench.sweeps, _CABLE),
                calibrations,
            )
            for chamber in bench.chambers
        ]
        results = [result for run in runs for result in run.results]
        board = np.concatenate([run.board[warm] for run in runs])
        found = path_calibration(results, board, np.full(len(board), calibrations[peer].delay_at(25.0)), path)
        documents[warm] = with_path(documents[warm], found, peer, _START_DELAY)
    return documents


def _clocks(name: str, random: np.random.Generator, bench: Bench) -> Document:
    truth = _calibration(name)
    board = np.array(bench.temperatures)
    time_base = bench.time_base_std * random.standard_normal()
    curves = {}
    for clock, values in (('reference', truth.alpha_at(board)), ('adc', truth.sample_clock_at(board))):
        read = values - 1.0 + time_base + bench.counter_std * random.standard_normal(len(board))
        curves[clock] = fit(read, board, np.full(len(board), bench.counter_std), bench.time_base_std)
    return with_clocks(Document(name), curves)


def _calibration(name: str) -> Calibration:
    """Return the true calibration of a station."""
    return _scenario(np.random.default_rng(0), 100.0, dict.fromkeys(TRUTH, 25.0), 1, {}).calibration(name)


_START_DELAY = 5.71e-6  # T_off at short distance: 3.41 us, and what the references' difference takes off [s]
_CABLE: dict[str, Any] = {
    'pairs': {'path_loss': 74.0},  # 13 dBm + 21 dB - 74 dB = -40 dBm at the receivers
    'weather': {'temperature': 25.0, 'humidity': 0.3},
}
_TERMINATED: dict[str, Any] = _CABLE | {'pairs': {'path_loss': 300.0}}  # far below the noise


def _scenario(
    random: np.random.Generator, distance: float, boards: dict[str, float], sweeps: int, changes: dict[str, Any]
) -> Scenario:
    """Return a scenario of a standing pair; a cable's electrical length counts as that much vacuum."""
    cable = 'pairs' in changes
    stations = {
        name: {
            'alpha': t.alpha,
            'sample_clock_alpha': t.sample_clock,
            'alpha_linear': t.linear,
            'alpha_cubic': t.cubic,
            'delay': t.delay,
            'delay_slope': t.delay_slope,
            'noise_floor': t.noise_floor,
            'phase_noise_level': t.phase_noise_level,
            'phase_noise_corner': t.phase_noise_corner,
            'board_temperature': boards[name],
        }
        for name, t in TRUTH.items()
    }
    scenario = scenario_from_mapping(
        {
            'stations': stations,
            'pairs': [
                {
                    'first': FIRST,
                    'second': SECOND,
                    'standing': {'distances': [distance], 'sweeps': sweeps},
                    **changes.get('pairs', {}),
                }
            ],
            'mode': {'start_delay_short': _START_DELAY, 'start_delay_long': 2.9e-6},
            'weather': changes.get('weather', {}),
            'reference': {'enabled': False},
            'seed': int(random.integers(1 << 62)),
        },
        'rehearsal',
    )
    if not cable:
        return scenario
    w = scenario.weather
    index = refractive_index(w.temperature.at(0.0), w.pressure.at(0.0), w.humidity.at(0.0))
    trajectory = Standing(distances=[distance / float(index)], sweeps=sweeps)
    pair = dataclasses.replace(scenario.pairs[0], trajectory=trajectory)
    return dataclasses.replace(scenario, pairs=(pair,))


def _without_curves(calibration: Calibration) -> Calibration:
    names = [f'{clock}_{order}' for clock in ('alpha', 'sample_clock') for order in ('linear', 'quadratic', 'cubic')]
    nothing: dict[str, Any] = dict.fromkeys(names, 0.0)
    return dataclasses.replace(calibration, **nothing)


def _mean_error(found: Evaluated) -> float:
    return float(np.mean([r.range for r in found.results] - found.true_range))


def _outcome(distance: float, found: Evaluated, without_curve: float) -> Outcome:
    white = np.array([r.white_std for r in found.results])
    correlated = float(np.mean([r.correlated_std for r in found.results]))
    flags = 0
    for result in found.results:
        flags |= result.flags
    return Outcome(
        distance=distance,
        error=_mean_error(found),
        stated=math.hypot(correlated, math.sqrt(float(np.sum(white**2))) / len(white)),
        correlated=correlated,
        flags=flags,
        without_curve=without_curve,
    )
