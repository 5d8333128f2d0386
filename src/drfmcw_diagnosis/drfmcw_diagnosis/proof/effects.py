"""The effects of the interface, and others outside its registry, as changes of a `generator.Scene`.

Written from the interface's table of effects. Units of parameters are the interface's, also where they are not SI.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from .generator import FIRST, SECOND, Motion, Ray, Scene, Stage, Stream

Parameters = Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Applied:
    """One effect with its parameters, as a sealed truth tells it."""

    effect: str
    station: str | None
    parameters: Parameters

    def as_object(self) -> dict[str, Any]:
        """Return a JSON-ready object."""
        return {'effect': self.effect, 'station': self.station, 'parameters': dict(self.parameters)}


@dataclasses.dataclass(frozen=True)
class Size:
    """How an effect is made larger: value of `parameter` at size s > 0, rising in effect from `lower` to `upper`."""

    parameter: str
    value: Callable[[float], float]
    start: float
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True)
class Kind:
    """What an effect is."""

    name: str
    of: str  # 'station', 'path' or 'reference'
    units: Mapping[str, str]
    size: Size
    apply: Callable[[Scene, tuple[int, ...], Parameters], None]
    registered: bool  # named by the interface


KINDS: dict[str, Kind] = {}
"""All effects by name."""


def _linear(parameter: str, start: float, upper: float) -> Size:
    return Size(parameter, lambda s: s, start, start * 1e-6, upper)


def _decibel(parameter: str, start: float, lower: float, upper: float) -> Size:
    """Amplitudes in dB: s is their linear value."""
    size = [10.0 ** (x / 20.0) for x in (start, lower, upper)]
    return Size(parameter, lambda s: 20.0 * math.log10(s), *size)


def _kind(name: str, of: str, units: Mapping[str, str], size: Size, registered: bool = True) -> Callable[[Any], Any]:
    def register(function: Callable[[Scene, tuple[int, ...], Parameters], None]) -> Any:
        KINDS[name] = Kind(name, of, units, size, function, registered)
        return function

    return register


def conceal(scene: Scene, effects: Sequence[Applied]) -> Scene:
    """Put effects into a scene, changing it, and return it.

    Raises:
        ValueError: no such effect, station or parameter.
    """
    for applied in effects:
        if applied.effect not in KINDS:
            raise ValueError(f"no effect '{applied.effect}'")
        kind, names = KINDS[applied.effect], scene.condition.names
        unknown = set(applied.parameters) - set(kind.units)
        if unknown:
            raise ValueError(f'{applied.effect}: no parameter {sorted(unknown)}')
        if applied.station is None:
            stations: tuple[int, ...] = (FIRST, SECOND)
        elif kind.of == 'station' and applied.station in names:
            stations = (names.index(applied.station),)
        else:
            raise ValueError(f"{applied.effect}: no station '{applied.station}'")
        kind.apply(scene, stations, applied.parameters)
    return scene


def _full_scale(scene: Scene, level: float) -> float:
    return scene.condition.full_scale * 10.0 ** (level / 20.0)


def _step_within(scene: Scene) -> np.ndarray:
    """Return the time since each setting's first sweep [n] [s]."""
    first = np.searchsorted(scene.setting, scene.setting)
    return scene.time - scene.time[first]


# --- clocks ---


def _deviate(scene: Scene, station: int, ppm: np.ndarray | float) -> None:
    """Change a reference; the ADC runs from it."""
    change = 1e-6 * ppm / scene.alpha[station]
    scene.alpha[station] = scene.alpha[station] * (1.0 + change)
    scene.clock[station] = scene.clock[station] * (1.0 + change)


def _above_calibration(scene: Scene, station: int) -> np.ndarray:
    return scene.board[station] - scene.condition.stations[station].calibration_temperature


@_kind('reference_clock_offset', 'station', {'deviation': 'ppm'}, _linear('deviation', 0.02, 100.0))
def _reference_clock_offset(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        _deviate(scene, s, p['deviation'])


@_kind('reference_clock_temperature', 'station', {'slope': 'ppm/K'}, _linear('slope', 0.002, 10.0))
def _reference_clock_temperature(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        _deviate(scene, s, p['slope'] * _above_calibration(scene, s))


@_kind(
    'reference_clock_drift',
    'station',
    {'rate': 'ppm/h', 'warmup': 'ppm', 'time_constant': 's'},
    _linear('rate', 0.1, 1000.0),
)
def _reference_clock_drift(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    ppm = p.get('rate', 0.0) * scene.time / 3600.0
    if 'warmup' in p:
        ppm = ppm + p['warmup'] * np.exp(-scene.time / p['time_constant'])
    for s in stations:
        _deviate(scene, s, ppm)


@_kind('sample_clock_offset', 'station', {'deviation': 'ppm'}, _linear('deviation', 1.0, 500.0))
def _sample_clock_offset(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        scene.clock[s] = scene.clock[s] * (1.0 + 1e-6 * p['deviation'])


# --- delay and air ---


@_kind('air_refractivity', 'path', {'offset': '1e-6'}, _linear('offset', 1.0, 500.0))
def _air_refractivity(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.refractivity = scene.refractivity + p['offset']


@_kind('delay_offset', 'path', {'delay': 'ns'}, _linear('delay', 0.01, 100.0))
def _delay_offset(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.delay = scene.delay + 1e-9 * p['delay']


@_kind('delay_temperature', 'station', {'slope': 'ps/K'}, _linear('slope', 1.0, 1e4))
def _delay_temperature(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        scene.delay = scene.delay + 1e-12 * p['slope'] * _above_calibration(scene, s)


# --- rays ---


@_kind('ground_reflection', 'path', {'height_product': 'm^2', 'coefficient': '1'}, _linear('coefficient', 0.003, 0.9))
def _ground_reflection(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.rays.append(Ray(lambda r: np.sqrt(r * r + 4.0 * p['height_product']), -p['coefficient']))


@_kind(
    'echo',
    'path',
    {'excess_range': 'm', 'relative_power': 'dB', 'phase': 'rad'},
    _decibel('relative_power', -50.0, -110.0, -1.0),
)
def _echo(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    amplitude = 10.0 ** (p['relative_power'] / 20.0)
    scene.rays.append(Ray(lambda r: r + p['excess_range'], amplitude, p.get('phase', 0.0)))


@_kind('amplitude_loss', 'path', {'loss': 'dB', 'specific': 'dB/km'}, _linear('loss', 0.05, 40.0))
def _amplitude_loss(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.gain = scene.gain - p.get('loss', 0.0) - p.get('specific', 0.0) * scene.distance / 1e3


# --- motion and geometry ---


@_kind('target_motion', 'path', {'velocity': 'm/s'}, _linear('velocity', 0.003, 100.0))
def _target_motion(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    velocity = np.broadcast_to(np.asarray(p['velocity'], float), (len(scene.condition.distances),))[scene.setting]
    begin = scene.time - _step_within(scene)

    def displacement(rows: np.ndarray, time: np.ndarray) -> np.ndarray:
        shape = (-1,) + (1,) * (time.ndim - 1)
        return velocity[rows].reshape(shape) * (time - begin[rows].reshape(shape))

    scene.motions.append(Motion(displacement, seen=True))


@_kind('sway', 'path', {'amplitude': 'm', 'frequency': 'Hz', 'phase': 'rad'}, _linear('amplitude', 1e-4, 10.0))
def _sway(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    def displacement(rows: np.ndarray, time: np.ndarray) -> np.ndarray:
        return p['amplitude'] * np.sin(2.0 * math.pi * p['frequency'] * time + p.get('phase', 0.0))

    scene.motions.append(Motion(displacement, seen=False))


@_kind('slant_geometry', 'path', {'height_difference': 'm'}, _linear('height_difference', 0.5, 100.0))
def _slant_geometry(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.antenna_distance = lambda r: np.hypot(r, p['height_difference'])


# --- sweep shape: frequency error in Hz of the station's clock, phase its integral over the clock's time ---


@_kind('sweep_curvature', 'station', {'deviation': 'Hz'}, _linear('deviation', 5.0, 1e7))
def _sweep_curvature(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    ramp = scene.condition.ramp_duration
    for s in stations:
        # parabola 4 x (1 - x), x the share of the ramp, integrated
        scene.chirp[s].append(lambda t: p['deviation'] * ramp * (2.0 * (t / ramp) ** 2 - 4.0 / 3.0 * (t / ramp) ** 3))


@_kind('sweep_ripple', 'station', {'deviation': 'Hz', 'rate': 'Hz', 'phase': 'rad'}, _linear('deviation', 5.0, 1e6))
def _sweep_ripple(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    start, turn = p.get('phase', 0.0), 2.0 * math.pi * p['rate']
    for s in stations:
        # integral of sin(a + b) by half angles: no difference of cosines where it is small
        scene.chirp[s].append(
            lambda t: p['deviation'] * 2.0 * np.sin(0.5 * turn * t) * np.sin(start + 0.5 * turn * t) / turn
        )


@_kind(
    'pll_settling',
    'station',
    {'step': 'Hz', 'natural_frequency': 'Hz', 'damping': '1'},
    _linear('step', 300.0, 1e8),
)
def _pll_settling(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    turn = 2.0 * math.pi * p['natural_frequency']
    decay, swing = turn * p['damping'], turn * math.sqrt(1.0 - p['damping'] ** 2)

    def phase(t: np.ndarray) -> np.ndarray:
        t = np.maximum(t, 0.0)
        integral = np.exp(-decay * t) * (swing * np.sin(swing * t) - decay * np.cos(swing * t)) + decay
        return p['step'] / turn**2 * integral

    for s in stations:
        scene.chirp[s].append(phase)


# --- noise ---


@_kind('phase_noise', 'station', {'level': 'dBc/Hz', 'corner': 'Hz'}, Size('level', lambda s: -90.0 + s, 0.3, 1e-3, 40))
def _phase_noise(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        level, corner, shape = scene.oscillators[s]
        scene.oscillators[s] = (p.get('level', level), p.get('corner', corner), shape)


@_kind('noise_floor', 'station', {'excess': 'dB'}, _linear('excess', 0.05, 40.0))
def _noise_floor(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        scene.noise_floor[s] = scene.noise_floor[s] + p['excess']


@_kind(
    'interference_burst',
    'station',
    {'probability': '1', 'level': 'dBFS', 'duration': 's'},
    _decibel('level', -62.0, -90.0, -10.0),
)
def _interference_burst(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    std = _full_scale(scene, p['level']) * math.sqrt(0.5)
    length = p['duration'] * scene.condition.sample_rate

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        x = x.copy()
        for i, row in enumerate(rows):
            random = scene.stream(Stream.EFFECT, 1, station, int(row))
            hit, place = random.random(2)
            if hit < p['probability']:
                t = np.arange(x.shape[1]) - place * x.shape[1]
                inside = (t >= 0.0) & (t < length)
                x[i, inside] += (std * random.standard_normal(int(inside.sum()))).astype(x.dtype)
        return x

    for s in stations:
        scene.analogue[s].append((Stage.INPUT, hook))
        scene.burst_power.append((s, p['probability'], length, std**2))


# --- receiver ---


@_kind('tx_leakage', 'station', {'level': 'dBFS'}, _decibel('level', -85.0, -120.0, -20.0))
def _tx_leakage(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    # a chirp mixed with itself without delay: a constant for as long as it is on
    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        u = scene.step(station)[rows, None] * np.arange(x.shape[1])
        on = scene.alpha[station, rows, None] * u <= scene.condition.ramp_duration
        return x + (_full_scale(scene, p['level']) * on).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.INPUT, hook))


@_kind('spur', 'station', {'frequency': 'Hz', 'level': 'dBFS'}, _decibel('level', -90.0, -130.0, -20.0))
def _spur(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        start = np.array([scene.stream(Stream.EFFECT, 2, station, int(row)).random() for row in rows])
        u = scene.step(station)[rows, None] * np.arange(x.shape[1])
        line = np.cos(2.0 * math.pi * (p['frequency'] * u + start[:, None]))
        return x + (_full_scale(scene, p['level']) * line).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.INPUT, hook))


@_kind('if_filter', 'station', {'pole': 'Hz'}, Size('pole', lambda s: 1.0 / s, 1e-8, 1e-9, 1e-4))
def _if_filter(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    def response(frequency: np.ndarray) -> np.ndarray:
        return 1.0 / (1.0 + 1j * frequency / p['pole'])

    for s in stations:
        scene.responses[s].append(response)
        scene.poles[s].append(p['pole'])


@_kind('compression', 'station', {'third_order': '1'}, _linear('third_order', 0.01, 20.0))
def _compression(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        share = x / scene.condition.full_scale
        return (x * (1.0 - p['third_order'] * share * share)).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.AMPLIFIER, hook))


@_kind('clipping', 'station', {'level': 'dBFS'}, Size('level', lambda s: -20.0 * math.log10(s), 3.0, 0.5, 1e3))
def _clipping(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        limit = _full_scale(scene, p['level'])
        return np.clip(x, -limit, limit)

    for s in stations:
        scene.analogue[s].append((Stage.LIMITER, hook))


# --- reference instrument ---


@_kind('reference_lag', 'reference', {'lag': 's'}, _linear('lag', 0.003, 100.0))
def _reference_lag(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.reference_lag += p['lag']


@_kind('reference_offset', 'reference', {'offset': 'm'}, _linear('offset', 1e-3, 100.0))
def _reference_offset(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.reference_errors.append(lambda r: np.full(r.shape, p['offset']))


@_kind('reference_scale', 'reference', {'scale': 'ppm'}, _linear('scale', 1.0, 1e4))
def _reference_scale(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.reference_errors.append(lambda r: 1e-6 * p['scale'] * r)


# --- outside the registry ---


def _outside(name: str, of: str, units: Mapping[str, str], size: Size) -> Callable[[Any], Any]:
    return _kind(name, of, units, size, registered=False)


@_outside('stuck_bit', 'station', {'bit': '1', 'value': '1'}, Size('bit', lambda s: float(round(s)), 3.0, 1.0, 12.0))
def _stuck_bit(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    mask = np.int16(1 << int(p['bit']))

    def hook(scene: Scene, station: int, rows: np.ndarray, codes: np.ndarray) -> np.ndarray:
        return codes | mask if p['value'] else codes & ~mask

    for s in stations:
        scene.digital[s].append(hook)


@_outside('missing_codes', 'station', {'width': 'LSB'}, Size('width', lambda s: float(round(s)), 16.0, 3.0, 4000.0))
def _missing_codes(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The lower half of every `width` codes around zero and upwards is never given: what falls there is raised."""
    width = int(p['width'])

    def hook(scene: Scene, station: int, rows: np.ndarray, codes: np.ndarray) -> np.ndarray:
        place = np.mod(codes, 2 * width)
        return np.where(place < width, codes + (width - place), codes).astype(np.int16)

    for s in stations:
        scene.digital[s].append(hook)


@_outside('gain_step', 'station', {'step': 'dB', 'time': 's'}, _linear('step', 0.02, 20.0))
def _gain_step(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The IF amplifier's gain changes at a time within the sweep."""

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        u = scene.step(station)[rows, None] * np.arange(x.shape[1])
        return (x * 10.0 ** (p['step'] / 20.0 * (u >= p['time']))).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.AMPLIFIER, hook))


@_outside('phase_jump', 'station', {'angle': 'rad', 'time': 's'}, _linear('angle', 0.003, 3.0))
def _phase_jump(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The synthesiser restarts its accumulator within the ramp."""
    for s in stations:
        scene.chirp[s].append(lambda t: p['angle'] / (2.0 * math.pi) * (t >= p['time']))


@_outside('frequency_step', 'station', {'step': 'ppm', 'temperature': 'degC'}, _linear('step', 0.05, 100.0))
def _frequency_step(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The reference jumps where its board is warmer than a temperature (an activity dip of the crystal)."""
    for s in stations:
        _deviate(scene, s, p['step'] * (scene.board[s] >= p['temperature']))


@_outside(
    'fan_modulation', 'station', {'depth': '1', 'rate': 'Hz', 'duty': '1'}, Size('depth', lambda s: s, 3e-3, 1e-7, 0.9)
)
def _fan_modulation(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """A fan's blades, or a pulsed supply, take a share of the amplitude in pulses of their own phase."""

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        start = np.array([scene.stream(Stream.EFFECT, 3, station, int(row)).random() for row in rows])
        turn = p['rate'] * scene.step(station)[rows, None] * np.arange(x.shape[1]) + start[:, None]
        return (x * (1.0 - p['depth'] * (np.mod(turn, 1.0) < p['duty']))).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.AMPLIFIER, hook))


@_outside('second_harmonic', 'station', {'second_order': '1'}, _linear('second_order', 0.003, 20.0))
def _second_harmonic(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The mixer's even-order product: c x^2, x = 1 at full scale, its constant blocked by the coupling capacitor."""

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        square = x * x
        square -= square.mean(axis=1, keepdims=True)
        return (x + p['second_order'] / scene.condition.full_scale * square).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.AMPLIFIER, hook))


@_outside('delay_hysteresis', 'station', {'slope': 'ps/K', 'time_constant': 's'}, _linear('slope', 3.0, 1e4))
def _delay_hysteresis(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The delay follows the change of the board's temperature and creeps back: a high-pass over time."""
    for s in stations:
        creep, last, lag = np.zeros(len(scene)), scene.board[s, 0], 0.0
        for i in range(len(scene)):
            passed = scene.time[i] - scene.time[max(i - 1, 0)]
            lag = lag * math.exp(-passed / p['time_constant']) + (scene.board[s, i] - last)
            last, creep[i] = scene.board[s, i], lag
        scene.delay = scene.delay + 1e-12 * p['slope'] * creep


@_outside('adc_dither', 'station', {'amplitude': 'LSB', 'period': 'samples'}, _linear('amplitude', 0.3, 2000.0))
def _adc_dither(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """Triangular dither of the converter that nobody subtracts, its start anywhere."""

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        start = np.array([scene.stream(Stream.EFFECT, 4, station, int(row)).random() for row in rows])
        turn = np.mod(np.arange(x.shape[1]) / p['period'] + start[:, None], 1.0)
        return (x + p['amplitude'] * (4.0 * np.abs(turn - 0.5) - 1.0)).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.LIMITER, hook))


@_outside('dropped_samples', 'station', {'count': '1', 'time': 's'}, Size('count', lambda s: float(round(s)), 1, 1, 64))
def _dropped_samples(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The interface to the converter loses samples at a place; what follows moves up and the last one is repeated."""

    def hook(scene: Scene, station: int, rows: np.ndarray, codes: np.ndarray) -> np.ndarray:
        place, count = int(p['time'] * scene.condition.sample_rate), int(p['count'])
        kept = np.arange(codes.shape[1])
        kept = np.minimum(np.where(kept < place, kept, kept + count), codes.shape[1] - 1)
        return codes[:, kept]

    for s in stations:
        scene.digital[s].append(hook)


@_outside('frequency_glitch', 'station', {'peak': 'Hz', 'time': 's', 'width': 's'}, _linear('peak', 300.0, 1e8))
def _frequency_glitch(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The synthesiser crosses an integer boundary: a Gaussian excursion of its frequency within the ramp."""
    scale = p['width'] * math.sqrt(0.5 * math.pi)
    for s in stations:
        scene.chirp[s].append(
            lambda t: p['peak'] * scale * (special.erf((t - p['time']) / (math.sqrt(2.0) * p['width'])))
        )


@_outside('interleaving', 'station', {'skew': 's', 'period': 'samples'}, _linear('skew', 2e-9, 2e-7))
def _interleaving(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """Interleaved converters of unequal timing: every `period`-th samples are taken late."""

    def warp(scene: Scene, rows: np.ndarray, u: np.ndarray) -> np.ndarray:
        return u + p['skew'] * (np.arange(u.shape[1]) % int(p['period']) == 0)

    for s in stations:
        scene.warp[s].append(warp)


REGISTERED = tuple(sorted(name for name, kind in KINDS.items() if kind.registered))
"""Names of the interface's effects."""

OUTSIDE = tuple(sorted(name for name, kind in KINDS.items() if not kind.registered))
"""Names of effects that the interface does not know."""
