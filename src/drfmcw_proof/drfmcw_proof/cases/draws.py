"""Random conditions of recordings, and random shapes of effects with their indistinguishable rivals."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..generator.condition import Condition, StationCondition
from ..generator.model import SPEED_OF_LIGHT
from .concealing import KINDS, Applied

Rival = tuple[tuple[str, str | None], ...]
"""Another explanation: effects with their stations."""


@dataclasses.dataclass(frozen=True)
class Extent:
    """How large recordings are."""

    settings: int = 14
    sweeps: int = 24
    anywhere: bool = False  # site and schedule are random, too


def random_extent(random: np.random.Generator) -> Extent:
    """Return the extent of a recording at any site, by any schedule."""
    return Extent(int(random.integers(8, 15)), int(random.integers(10, 33)), anywhere=True)


def random_condition(random: np.random.Generator, extent: Extent, **changes: Any) -> Condition:
    """Return a random condition, with the layout of the practice recordings unless the extent says `anywhere`."""
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
    site = _anywhere(random, condition) if extent.anywhere else {}
    return dataclasses.replace(condition, **site | changes)


def _anywhere(random: np.random.Generator, condition: Condition) -> dict[str, Any]:
    """Return what is random of another site: distances and their order, time, stations, levels and references."""
    n, uniform = len(condition.distances), random.uniform
    distances = np.sort(np.exp(uniform(np.log(20.0), np.log(1000.0), n)))
    order = str(random.choice(['out', 'out', 'out and back', 'any']))
    if order == 'out and back':
        distances = np.concatenate([distances[::2], distances[1::2][::-1]])
    elif order == 'any':
        distances = random.permutation(distances)
    short = float(uniform(3.0e-6, 4.0e-6))
    alphas = 1.0 + 1e-6 * (uniform(-12.0, 12.0) + uniform(-3.0, 3.0, 2))
    # where both lines are within the IF: the second station's above 0 Hz, the first one's below Nyquist
    farthest = min(short - 0.8e-6, 6.0e-6 - short) * SPEED_OF_LIGHT
    stations = tuple(
        dataclasses.replace(
            station,
            delay=float(uniform(5e-9, 30e-9)),
            alpha=float(alpha),
            sample_clock_alpha=float(alpha) * station.sample_clock_alpha / station.alpha,
            noise_floor=float(uniform(-142.0, -135.0)),
            phase_noise_level=float(uniform(-93.0, -86.0)),
            phase_noise_corner=float(np.exp(uniform(np.log(70e3), np.log(240e3)))),
        )
        for station, alpha in zip(condition.stations, alphas, strict=True)
    )
    return {
        'distances': floats(distances),
        'stations': stations,
        'interval': float(uniform(5e-3, 50e-3)),
        'pause': float(uniform(15.0, 120.0)),
        'short_start_delay': short,
        'long_start_delay': float(uniform(0.4e-6, 0.7e-6)),
        'mode_boundary': float(uniform(0.8, 1.0)) * farthest,
        'tx_eirp': float(uniform(10.0, 16.0)),
        'full_scale_power': float(uniform(-24.0, -17.0)),
        'reference_std': float(uniform(3e-3, 8e-3)),
        'start_delay_jitter': float(uniform(1e-9, 4e-9)),
        'amplitude_scatter': float(uniform(0.1, 0.4)),
    }


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

    def wandering() -> dict[str, float]:
        """Return what changes slowly while the recording is made."""
        period = float(uniform(0.3, 1.2)) * condition.duration
        return {'amplitude': 1.0, 'period': period, 'phase': float(uniform(0.0, 6.28))}

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
        'sampling_ripple': lambda: {'skew': 1.0, 'rate': between(4e3, 4e4), 'phase': float(uniform(0.0, 6.28))},
        'sampling_settling': lambda: {'skew': sign, 'time_constant': between(2e-5, 2e-4)},
        'aperture_jitter': lambda: {'jitter': 1.0},
        'crossover_distortion': lambda: {'depth': 1.0},
        'gain_switch': lambda: {'step': sign, 'within': float(np.median(condition.distances))},
        'loose_contact': lambda: {'loss': 1.0, 'every': int(random.integers(2, 6))},
        'swinging_echo': lambda: {
            'excess_range': between(3.0, 40.0),
            'relative_power': -40.0,
            'swing': between(0.03, 0.5),
            'rate': between(0.1, 1.0),
            'phase': float(uniform(0.0, 6.28)),
        },
        'gain_hum': lambda: {'depth': 1.0, 'rate': between(50.0, 400.0)},
        'interleaving_gain': lambda: {'step': sign, 'period': int(random.choice([4, 8]))},
        'sporadic_drop': lambda: {
            'count': int(random.integers(1, 4)),
            'time': float(uniform(2e-4, 8e-4)),
            'every': int(random.integers(2, 6)),
        },
        'triple_trip': lambda: {'relative_power': -40.0, 'phase': float(uniform(0.0, 6.28))},
        'shadowing': lambda: {'loss': 1.0, **_stretch(random, condition)},
        'wet_antenna': lambda: {'loss': 1.0, 'time': float(uniform(0.25, 0.75)) * condition.duration},
        'air_gradient': lambda: {'gradient': sign},
        'reference_rounding': lambda: {'step': 1.0},
        'local_echo': lambda: {
            'excess_range': between(3.0, 40.0),
            'relative_power': -40.0,
            'phase': float(uniform(0.0, 6.28)),
            **_stretch(random, condition),
        },
        'fixed_reflector': lambda: {
            'position': _beyond_nearest(random, condition),
            'relative_power': -40.0,
            'phase': float(uniform(0.0, 6.28)),
        },
        'rail_bend': lambda: {'height': sign, 'length': float(uniform(0.8, 1.6)) * max(condition.distances)},
        'reference_wander': wandering,
        'delay_step': lambda: {'step': sign, 'time': float(uniform(0.25, 0.75)) * condition.duration},
        'gain_temperature': lambda: {'slope': sign},
        'gain_ripple': lambda: {'ripple': 1.0, 'rate': between(1e3, 1e4), 'phase': float(uniform(0.0, 6.28))},
        'gain_sag': lambda: {'sag': sign, 'time_constant': between(3e-5, 2e-4)},
        'delay_creep': lambda: {'rate': sign},
        'weather_wander': wandering,
        'reference_backlash': lambda: {'play': sign, 'from_afar': floats(random.permutation(np.arange(n) % 2))},
        'reference_graduation': lambda: {
            'amplitude': 1.0,
            'period': between(0.02, 0.5) * max(condition.distances),
            'phase': float(uniform(0.0, 6.28)),
        },
    }
    applied = Applied(effect, station, shapes[effect]())
    if effect == 'reference_lag':  # a late reference is right where nothing moves
        return Applied('target_motion', None, {'velocity': velocities(random, n)}), applied
    return (applied,)


def _stretch(random: np.random.Generator, condition: Condition) -> dict[str, float]:
    """Return a stretch of the rail that holds a third to two thirds of the distances, two at least."""
    ordered = sorted(condition.distances)
    n = len(ordered)
    count = max(2, round(n * random.uniform(0.33, 0.67)))
    first = int(random.integers(0, n - count + 1))
    return {'from': ordered[first] - 1.0, 'to': ordered[min(first + count, n) - 1] + 1.0}


def _beyond_nearest(random: np.random.Generator, condition: Condition) -> float:
    """Return a place beyond the nearest two to four distances, the farthest of which it is a resolution cell from."""
    ordered = sorted(condition.distances)
    return ordered[min(int(random.integers(1, 4)), len(ordered) - 1)] + float(random.uniform(3.0, 15.0))


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
