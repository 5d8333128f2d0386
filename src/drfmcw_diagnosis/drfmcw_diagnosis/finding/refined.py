"""The simulator's configuration that reproduces a recording, with the effects that were found in it."""

import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drfmcw_physics.constants import DECIBELS_PER_NEPER
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode, SweepSettings
from drfmcw_ros.commands.cli import write_atomically
from drfmcw_sim.effects import Effect, Of, effect_from_mapping
from drfmcw_sim.scenario import TimingSettings, WeatherSettings, scenario_from_mapping

from ..recording.dataset import Dataset
from .limits import SCENARIO

FoundEffect = tuple[str, str | None, Mapping[str, float | Sequence[float]]]
"""Name of an effect, its station (or None), its parameters."""


def scenario_mapping(dataset: Dataset, effects: Sequence[FoundEffect] = ()) -> dict[str, Any]:
    """Return the sections of a scenario file (drfmcw_sim.scenario) that simulates the recording again.

    The crane stands where the reference saw it, less what effects on the reference explain; times, temperatures and
    weather follow the recording; the scatter of T_off and amplitude is as measured.

    Args:
        dataset: the recording.
        effects: found in it.

    Raises:
        ConfigurationError: an effect or a value that the simulator refuses, or a recording whose waveform changes.
    """
    sweeps = dataset.sweeps[0]
    _refuse_other_waveforms(dataset)
    interval, pauses = _timing(dataset)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(dataset.group)) + 1])
    found = [_effect(dataset, effect) for effect in effects]
    distances, steps = _distances(dataset, starts, interval, found)
    settings = [dataset.sweeps[s] for s in dataset.setting[starts]]
    stop = {
        'distances': _numbers(distances),
        'steps': _numbers(steps),
        'sweeps': np.bincount(dataset.group).tolist(),
        'pauses': _numbers(pauses),
        'modes': [int(s[0].mode) for s in settings],
        'start_delays': [float(s[0].start_delay) for s in settings],
    }
    pair: dict[str, Any] = {'first': dataset.stations[0], 'second': dataset.stations[-1]}
    if _free_space(sweeps):
        if sweeps[0].start_frequency != sweeps[-1].start_frequency:
            pair['frequency_offset'] = float(sweeps[0].start_frequency - sweeps[-1].start_frequency)
    else:
        pair['path_loss'] = 0.0  # the stations' powers below are the measured ones
    modes = {Mode(s[0].mode): s[0].start_delay for s in reversed(dataset.sweeps)}
    names = {Mode.SHORT_DISTANCE: 'start_delay_short', Mode.LONG_DISTANCE: 'start_delay_long'}
    timing: dict[str, Any] = {'sweep_interval': _number(interval), 'mode_change_duration': 0.0}
    timing['start_time'] = float(dataset.stamp[0]) * 1e-9
    timing['start_delay_jitter'] = _number(_start_delay_jitter(dataset))
    timing['amplitude_scatter'] = _number(_amplitude_scatter(dataset))
    report = _report_interval(pauses)
    timing['status_interval'] = min(TimingSettings().status_interval, report)
    mapping: dict[str, Any] = {
        'description': f'as recorded in {Path(dataset.path).name}',
        'waveform': {
            'start_frequency': float(sweeps[0].start_frequency),
            'bandwidth': float(sweeps[0].bandwidth),
            'ramp_duration': float(sweeps[0].ramp_duration),
            'sample_rate': float(sweeps[0].sample_rate),
            'sample_count': int(sweeps[0].sample_count),
            'iq': bool(dataset.iq),
        },
        'mode': {names[mode]: float(delay) for mode, delay in sorted(modes.items())},
        'stations': {name: _station(dataset, i, pauses) for i, name in enumerate(dataset.stations)},
        'pairs': [pair | {'recorded': stop}],
        'weather': {
            quantity: _profile(dataset, getattr(dataset, quantity), pauses)
            for quantity in ('temperature', 'pressure', 'humidity')
        }
        | {'interval': min(WeatherSettings().interval, report)},
        'reference': _reference(dataset),
        'timing': timing,
        'effects': found,
        'seed': 1,
    }
    scenario_from_mapping(mapping, f'refined configuration of {dataset.path}')
    return mapping


def write_scenario(
    path: Path | str, dataset: Dataset, effects: Sequence[FoundEffect] = (), measured: str | None = None
) -> None:
    """Write the scenario file; arguments and errors as `scenario_mapping`.

    Args:
        path: of the file.
        dataset: the recording.
        effects: found in it.
        measured: name of the file beside it that holds the measured remainder.
    """
    mapping = scenario_mapping(dataset, effects)
    if measured is not None:
        mapping['measured'] = measured
    text = yaml.safe_dump(mapping, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True)
    write_atomically(path, text)


def _number(value: float) -> float:
    """Return a plain number of nine digits: micrometres and microseconds of a recording."""
    return float(f'{value:.9g}')


def _numbers(values: Sequence[float] | np.ndarray) -> list[float]:
    return [_number(v) for v in values]


def _refuse_other_waveforms(dataset: Dataset) -> None:
    names = ('start_frequency', 'bandwidth', 'ramp_duration', 'sample_rate', 'sample_count')
    for name in names:
        for i, station in enumerate(dataset.stations):
            values = sorted({getattr(s[i], name) for s in dataset.sweeps})
            if len(values) > 1:
                raise ConfigurationError(
                    f"{dataset.path}: {name} of '{station}' changes ({', '.join(f'{v:g}' for v in values)}): "
                    'no scenario can express that'
                )


def _free_space(sweeps: Sequence[SweepSettings]) -> bool:
    """Return True where the link budget is known."""
    return not any(math.isnan(s.tx_eirp + s.rx_antenna_gain) for s in sweeps)


def _effect(dataset: Dataset, effect: FoundEffect) -> dict[str, Any]:
    name, station, parameters = effect
    values = {
        key: _numbers(value) if isinstance(value, Sequence) else _number(value) for key, value in parameters.items()
    }
    return {'effect': name} | ({'station': station} if station else {}) | values


def _timing(dataset: Dataset) -> tuple[float, np.ndarray]:
    """Return the interval of the sweeps and the time beyond it before each group [s]."""
    same = np.diff(dataset.group) == 0
    step = np.diff(dataset.time)
    sweep = dataset.sweeps[0][0]
    busy = max(sweep.ramp_duration + s[0].start_delay for s in dataset.sweeps)
    interval = max(float(np.median(step[same])), busy) if same.any() else max(TimingSettings().sweep_interval, busy)
    pauses, now = [], 0.0
    for number in range(dataset.group[-1] + 1):
        rows = np.flatnonzero(dataset.group == number)
        pauses.append(max(round(float(dataset.time[rows[0]]) - now, 6), 0.0))
        now += pauses[-1] + len(rows) * interval
    return interval, np.array(pauses)


def _report_interval(pauses: np.ndarray) -> float:
    """Return the interval of weather and temperatures [s]: short enough for a new value before each stop."""
    moving = pauses[pauses > 0.0]
    return max(_number(moving.min() / 2.0), SCENARIO.shortest_report) if len(moving) else math.inf


def _distances(
    dataset: Dataset, starts: np.ndarray, interval: float, effects: Sequence[Mapping[str, Any]]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the true distance at the first sweep of each group, and its growth per sweep [m]."""
    of_reference = [
        e
        for i, mapping in enumerate(effects)
        if (e := effect_from_mapping(mapping, f'effects[{i}]', list(dataset.stations))).of is Of.REFERENCE
    ]
    distances, steps = [], []
    for number, start in enumerate(starts):
        rows = np.flatnonzero(dataset.group == number)
        velocity = float(dataset.velocity[start])
        if not abs(velocity) > SCENARIO.moving * float(dataset.velocity_std[start]):
            velocity = 0.0
        middle, time = float(np.mean(dataset.distance[rows])), float(np.mean(dataset.time[rows]))
        ends = dataset.time[rows[[0, -1]]]
        readings = middle + velocity * (ends - time)
        if np.isfinite(dataset.reference[rows]).all():
            readings, velocity = _without_errors(of_reference, ends, readings, velocity)
        distances.append(max(float(readings[0]), 0.0))
        steps.append(velocity * interval)
    return np.array(distances), np.array(steps)


def _without_errors(
    effects: Sequence[Effect], times: np.ndarray, readings: np.ndarray, velocity: float
) -> tuple[np.ndarray, float]:
    """Return the distances (2,) [m] and the velocity at which the reference, with the effects' errors, reads so.

    Args:
        effects: that change what the reference reads.
        times: of the first and the last sweep of a group (2,) [s].
        readings: at these times (2,) [m].
        velocity: their slope [m/s].
    """
    distances = readings
    for _ in range(SCENARIO.rounds if effects else 0):

        def at(t: float, known: float, time: float, speed: float = velocity) -> float:
            return known + speed * (t - time)

        distances = readings - [
            sum(float(e.reference_error(t, d, functools.partial(at, known=d, time=t))) for e in effects)
            for t, d in zip(times.tolist(), distances.tolist(), strict=True)
        ]
        if velocity:
            velocity = float(np.diff(distances)[0] / np.diff(times)[0])
    return distances, velocity


def _profile(dataset: Dataset, values: np.ndarray, pauses: np.ndarray) -> float | dict[str, list[float]]:
    """Return a quantity over time, known at the ends of each group; after a pause it has changed half-way through."""
    points: list[tuple[float, float]] = []
    for number, pause in enumerate(pauses):
        rows = np.flatnonzero(dataset.group == number)
        first, last = rows[0], rows[-1]
        if pause > 0.0:
            points.append((dataset.time[first] - pause / 2.0, values[first]))
        points.append((dataset.time[first], values[first]))
        points.append((dataset.time[last], values[last]))
    kept: list[tuple[float, float]] = []
    for i, (time, value) in enumerate(points):
        if kept and time <= kept[-1][0]:
            continue
        flat = kept and i + 1 < len(points) and kept[-1][1] == value == points[i + 1][1]
        if not flat:
            kept.append((time, value))
    if all(value == kept[0][1] for _, value in kept):
        return _number(kept[0][1])
    return {'times': _numbers([t for t, _ in kept]), 'values': _numbers([v for _, v in kept])}


def _station(dataset: Dataset, i: int, pauses: np.ndarray) -> dict[str, Any]:
    calibration, sweep = dataset.calibration[i], dataset.sweeps[0][i]
    full_scale = float(np.median(dataset.full_scale[i]))
    bits = math.ceil(math.log2(full_scale)) + 1
    result: dict[str, Any] = {
        'alpha': float(calibration.alpha),
        'sample_clock_alpha': float(calibration.sample_clock_alpha),
        'calibration_temperature': float(calibration.temperature),
        'delay': float(calibration.delay),
        'phase_noise_level': float(calibration.phase_noise_level),
        'tx_eirp': float(sweep.tx_eirp),
        'rx_antenna_gain': float(sweep.rx_antenna_gain),
        # where full scale is no power of two, the level of a code stays
        'full_scale_power': _number(sweep.full_scale_power + 20.0 * math.log10(2.0 ** (bits - 1) / full_scale)),
        'adc_bits': bits,
    }
    for name in ('alpha_linear', 'alpha_quadratic', 'alpha_cubic', 'delay_slope'):
        if getattr(calibration, name):
            result[name] = float(getattr(calibration, name))
    if sweep.frame_id:
        result['frame_id'] = sweep.frame_id
    if not math.isnan(calibration.noise_floor):
        result['noise_floor'] = _number(calibration.noise_floor)
    if not math.isnan(calibration.phase_noise_corner):
        result['phase_noise_corner'] = float(calibration.phase_noise_corner)
    if not _free_space(dataset.sweeps[0]):
        powers = dataset.received_power[i][np.isfinite(dataset.received_power[i])]
        result |= {'tx_eirp': 0.0, 'rx_antenna_gain': _number(np.mean(powers)) if len(powers) else 0.0}
    temperature = dataset.board_temperature[i]
    known = np.isfinite(temperature).all()
    result['board_temperature'] = _profile(dataset, temperature, pauses) if known else float(calibration.temperature)
    return result


def _reference(dataset: Dataset) -> dict[str, Any]:
    known = dataset.reference_std[np.isfinite(dataset.reference)]
    return {'range_std': _number(np.sqrt(np.mean(known**2)))} if len(known) else {'enabled': False}


def _start_delay_jitter(dataset: Dataset) -> float:
    """Return the standard deviation of the true T_off from sweep to sweep, estimated from both lines [s]."""
    if not dataset.topology.both_heard:
        return TimingSettings().start_delay_jitter
    variances = []
    for rows in _sizeable_groups(dataset):
        first, second = dataset.sweeps[dataset.setting[rows[0]]]
        lines, slope = dataset.lines.frequency[:, rows], 2.0 * first.chirp_rate
        start_delay = (first.line_sign() * lines[0] + second.line_sign() * lines[1]) / slope  # eqs. 1-4
        noise = np.sum(dataset.lines.frequency_std[:, rows] ** 2, axis=0) / slope**2
        variances.append(_scatter(dataset.time[rows], start_delay) - np.mean(noise))
    return _pooled(variances, TimingSettings().start_delay_jitter)


def _amplitude_scatter(dataset: Dataset) -> float:
    """Return the standard deviation of the received power from sweep to sweep, without the noise's share [dB]."""
    variances = []
    for i in range(len(dataset.stations)):
        for rows in _sizeable_groups(dataset):
            power = dataset.lines.power[i, rows]
            snr = power - dataset.lines.noise_density[i, rows] + 10.0 * np.log10(dataset.sweeps[0][i].ramp_duration)
            noise = DECIBELS_PER_NEPER**2 / 2.0 * 10.0 ** (-snr / 10.0)
            variances.append(_scatter(dataset.time[rows], power) - np.mean(noise))
    return _pooled(variances, TimingSettings().amplitude_scatter)


def _sizeable_groups(dataset: Dataset) -> list[np.ndarray]:
    """Return the rows of groups in which every station found a line often enough for a scatter."""
    found = np.isfinite(dataset.lines.frequency[[s is not None for s in dataset.samples]]).all(axis=0)
    groups = [np.flatnonzero(found & (dataset.group == number)) for number in range(dataset.group[-1] + 1)]
    return [rows for rows in groups if len(rows) >= SCENARIO.fewest]


def _scatter(time: np.ndarray, values: np.ndarray) -> float:
    """Return the variance of values (n,) about a straight line over time (n,)."""
    t = time - np.mean(time)
    residual = values - np.mean(values) - t * np.sum(t * values) / np.sum(t * t)
    return float(np.sum(residual**2) / (len(values) - 2))


def _pooled(variances: Sequence[float], default: float) -> float:
    """Return the standard deviation of groups alike; the median holds where some of them are disturbed."""
    finite = [v for v in variances if math.isfinite(v)]
    return math.sqrt(max(float(np.median(finite)), 0.0)) if finite else default
