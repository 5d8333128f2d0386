"""Random conditions of recordings, and random shapes of effects with their indistinguishable rivals."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..generator.condition import Condition, StationCondition
from .concealing import KINDS, Applied

Rival = tuple[tuple[str, str | None], ...]
"""Another explanation: effects with their stations."""


@dataclasses.dataclass(frozen=True)
class Extent:
    """How large recordings are."""

    settings: int = 14
    sweeps: int = 24


def random_condition(random: np.random.Generator, extent: Extent, **changes: Any) -> Condition:
    """Return a condition like those of the practice recordings: every number varies, the layout is theirs."""
    n = extent.settings
    fixed = np.array([38, 75, 111, 157, 230, 307, 402, 501, 598, 680, 760, 852, 931, 1001], float)
    centres = np.interp(np.linspace(0.0, 13.0, n), np.arange(14.0), fixed)
    air = random.uniform(5.0, 25.0, n)
    boards = [air + random.uniform(5.0, 15.0, n) for _ in range(2)]
    calibrated = random.random() < 0.5
    stations = []
    for name, delay in ('master', 12e-9), ('slave', 15e-9):
        alpha = 1.0 + 1e-6 * random.uniform(-8.0, 8.0) * calibrated
        stations.append(
            StationCondition(
                name,
                delay=delay if random.random() < 0.5 else random.uniform(8e-9, 25e-9),
                alpha=alpha,
                sample_clock_alpha=alpha * (1.0 + 1e-6 * random.uniform(-2.0, 2.0) * calibrated),
                calibration_temperature=25.0,
                noise_floor=float(random.choice([-142.0, -140.0, -140.0, -137.0])),
                phase_noise_level=float(random.choice([-92.0, -90.0, -90.0, -88.0])),
                phase_noise_corner=float(random.choice([90e3, 120e3, 120e3, 160e3])),
            )
        )
    condition = Condition(
        seed=int(random.integers(2**62)),
        distances=floats(centres + random.uniform(-4.0, 4.0, n)),
        air_temperature=floats(air),
        air_pressure=floats(random.uniform(99e3, 104e3, n)),
        air_humidity=floats(random.uniform(0.1, 0.9, n)),
        board_temperature=(floats(boards[0]), floats(boards[1])),
        stations=(stations[0], stations[1]),
        sweeps=extent.sweeps,
    )
    return dataclasses.replace(condition, **changes)


def _uneven(values: np.ndarray) -> np.ndarray:
    """Return values less their mean: what is common to the coefficients of a shape changes nothing."""
    return values - values.mean()


def floats(values: np.ndarray) -> tuple[float, ...]:
    """Return plain numbers."""
    return tuple(float(v) for v in values)


def both_stations(condition: Condition, **changes: Any) -> Condition:
    """Return the condition with both stations changed alike."""
    first, second = (dataclasses.replace(s, **changes) for s in condition.stations)
    return dataclasses.replace(condition, stations=(first, second))


def template(random: np.random.Generator, effect: str, condition: Condition) -> tuple[Applied, ...]:
    """Return an effect of random shape and side, to be scaled; those that show it come before it."""
    station = condition.names[int(random.integers(2))] if KINDS[effect].of == 'station' else None
    sign = float(random.choice([-1.0, 1.0]))
    n, uniform = len(condition.distances), random.uniform

    def between(low: float, high: float) -> float:
        """Return a number of uniform logarithm."""
        return float(np.exp(uniform(np.log(low), np.log(high))))

    shapes: dict[str, Callable[[], dict[str, Any]]] = {
        'reference_clock_offset': lambda: {'deviation': sign},
        'reference_clock_temperature': lambda: {'slope': sign},
        'reference_clock_drift': lambda: (
            {'rate': sign} if uniform() < 0.5 else {'warmup': sign, 'time_constant': between(100.0, 400.0)}
        ),
        'sample_clock_offset': lambda: {'deviation': sign},
        'air_refractivity': lambda: {'offset': sign},
        'delay_offset': lambda: {'delay': sign},
        'delay_temperature': lambda: {'slope': sign},
        'ground_reflection': lambda: {'height_product': between(30.0, 200.0), 'coefficient': sign},
        'echo': lambda: {
            'excess_range': between(3.0, 40.0),
            'relative_power': -50.0,
            'phase': float(uniform(0.0, 6.28)),
        },
        'tx_leakage': lambda: {'level': -85.0},
        'spur': lambda: {'frequency': float(uniform(5e4, 9.5e5)), 'level': -90.0},
        'sweep_curvature': lambda: {'deviation': sign},
        'sweep_ripple': lambda: {'deviation': 1.0, 'rate': between(4e3, 4e4), 'phase': float(uniform(0.0, 6.28))},
        'pll_settling': lambda: {
            'step': sign,
            'natural_frequency': between(8e3, 4e4),
            'damping': float(uniform(0.2, 0.7)),
        },
        'sweep_rate': lambda: {'error': sign},
        'ramp_window': lambda: {'start': 1e-5},
        'frequency_modulation': lambda: {'deviation': 1.0, 'rate': between(1e3, 2e4)},
        'sweep_shape': lambda: {'relative_rate': floats(1.0 + _uneven(random.uniform(-1.0, 1.0, 5)))},
        'phase_noise': lambda: {'level': -90.0},
        'noise_floor': lambda: {'excess': 1.0},
        'amplitude_loss': lambda: {'loss': 1.0} if uniform() < 0.5 else {'specific': 1.0},
        'amplitude_slope': lambda: {'slope': sign},
        'target_motion': lambda: {'velocity': velocities(random, n)},
        'sway': lambda: {'amplitude': 1.0, 'frequency': float(uniform(0.2, 0.9))},
        'slant_geometry': lambda: {'height_difference': 1.0},
        'clipping': lambda: {'level': -25.0},
        'compression': lambda: {'third_order': sign},
        'ac_coupling': lambda: {'pole': 1e3},
        'receiver_settling': lambda: {'level': -75.0, 'time_constant': between(1e-5, 3e-4)},
        'second_order_distortion': lambda: {'second_order': sign},
        'if_filter': lambda: {'pole': 1e6},
        'interference_burst': lambda: {
            'probability': float(uniform(0.05, 0.3)),
            'level': -62.0,
            'duration': between(2e-5, 2e-4),
        },
        'reference_lag': lambda: {'lag': 1.0},
        'reference_offset': lambda: {'offset': sign},
        'reference_scale': lambda: {'scale': sign},
        'stuck_bit': lambda: {'bit': int(random.integers(3, 7)), 'value': int(random.integers(2))},
        'missing_codes': lambda: {'width': int(random.choice([8, 16, 32, 64]))},
        'gain_step': lambda: {'step': sign, 'time': float(uniform(2e-4, 8e-4))},
        'phase_jump': lambda: {'angle': sign, 'time': float(uniform(2e-4, 8e-4))},
        'frequency_step': lambda: {
            'step': sign,
            'temperature': float(np.median(condition.board_temperature[condition.names.index(str(station))])),
        },
        'fan_modulation': lambda: {'depth': 1.0, 'rate': between(3e3, 3e4), 'duty': float(uniform(0.1, 0.5))},
        'delay_hysteresis': lambda: {'slope': sign, 'time_constant': between(40.0, 200.0)},
        'adc_dither': lambda: {'amplitude': 1.0, 'period': float(uniform(5.0, 40.0))},
        'dropped_samples': lambda: {'count': int(random.integers(1, 4)), 'time': float(uniform(2e-4, 8e-4))},
        'frequency_glitch': lambda: {'peak': sign, 'time': float(uniform(2e-4, 8e-4)), 'width': between(5e-6, 5e-5)},
        'interleaving': lambda: {'skew': 1.0, 'period': int(random.choice([4, 8]))},
    }
    applied = Applied(effect, station, shapes[effect]())
    if effect == 'reference_lag':  # a late reference is right where nothing moves
        return Applied('target_motion', None, {'velocity': velocities(random, n)}), applied
    return (applied,)


def velocities(random: np.random.Generator, n: int) -> list[float]:
    """Return velocities of both signs, one for each setting [m/s]."""
    return [float(v) for v in random.choice([-1.0, 1.0], n) * random.uniform(0.2, 1.7, n)]


TWINS: dict[str, str] = {
    'delay_offset': 'reference_offset',
    'reference_offset': 'delay_offset',
    'air_refractivity': 'reference_scale',
    'reference_scale': 'air_refractivity',
}
"""Effects that change the data alike."""


AIR = 500.0
"""By how much the refractivity of air may differ from the measured one, as the effect bounds it [1e-6]."""


def other_station(condition: Condition, station: str | None) -> str:
    """Return the name of the other station."""
    return condition.names[1 - condition.names.index(str(station))]


def _alike(condition: Condition, effect: Applied) -> tuple[str, str | None] | None:
    """Return what changes the data as an effect does, whatever its size."""
    if effect.effect in TWINS:
        return TWINS[effect.effect], None
    if effect.effect in ('reference_clock_offset', 'reference_clock_drift', 'sweep_rate'):
        # an IF knows the difference of the references or the rates only, but for 1e-6 of it
        return effect.effect, other_station(condition, effect.station)
    return None


def rivals(condition: Condition, effects: Sequence[Applied]) -> tuple[Rival, ...]:
    """Return the explanations with one effect replaced that the data can hardly separate from the truth, if at all."""
    keys = [(e.effect, e.station) for e in effects]
    found = []
    for number, effect in enumerate(effects):
        alike = _alike(condition, effect)
        if alike is not None:
            found.append((*keys[:number], alike, *keys[number + 1 :]))
    return tuple(found)


def possible(alike: Sequence[Rival], effects: Sequence[Applied]) -> tuple[Rival, ...]:
    """Return the rivals that effects of these sizes have: air cannot differ by more than all of it."""
    beyond = any(e.effect == 'reference_scale' and abs(e.parameters['scale']) > AIR for e in effects)
    return tuple(r for r in alike if not (beyond and ('air_refractivity', None) in r))


def substitutes(condition: Condition, effect: str) -> tuple[Rival, ...]:
    """Return other effects that change the data as one that the registry lacks."""
    if effect in TWINS:
        return (((TWINS[effect], None),),)
    if effect == 'reference_clock_offset':  # a warm-up far slower than the recording is constant in it
        return tuple((('reference_clock_drift', station),) for station in condition.names)
    return ()
