"""The effects of the interface, written from its table of effects."""

import math

import numpy as np
from scipy import fft, interpolate

from ..generator.model import Motion, Ray, Scene, Stage, Stream
from .kinds import KINDS, Parameters, Size, decibel, deviate, full_scale, kind, linear

_BURST, _SPUR, _HUM = 1, 2, 5  # streams of random numbers
_LONGEST_SILENCE = 1 << 17  # samples behind a record in which a capacitor discharges


def _bowl(size: float) -> list[float]:
    """Return coefficients of a rate that is higher at both ends of the band, more at its start."""
    return [1.0 + size * x for x in (1.0, 0.0, -0.5, 0.0, 0.5)]


# --- clocks ---


def _step_within(scene: Scene) -> np.ndarray:
    """Return the time since each setting's first sweep [n] [s]."""
    first = np.searchsorted(scene.setting, scene.setting)
    return scene.time - scene.time[first]


def _above_calibration(scene: Scene, station: int) -> np.ndarray:
    return scene.board[station] - scene.condition.stations[station].calibration_temperature


@kind('reference_clock_offset', 'station', {'deviation': 'ppm'}, linear('deviation', 0.02, 100.0))
def _reference_clock_offset(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        deviate(scene, s, p['deviation'])


@kind('reference_clock_temperature', 'station', {'slope': 'ppm/K'}, linear('slope', 0.002, 10.0))
def _reference_clock_temperature(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        deviate(scene, s, p['slope'] * _above_calibration(scene, s))


@kind(
    'reference_clock_drift',
    'station',
    {'rate': 'ppm/h', 'warmup': 'ppm', 'time_constant': 's'},
    linear('rate', 0.1, 1000.0),
)
def _reference_clock_drift(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    ppm = p.get('rate', 0.0) * scene.time / 3600.0
    if 'warmup' in p:
        ppm = ppm + p['warmup'] * np.exp(-scene.time / p['time_constant'])
    for s in stations:
        deviate(scene, s, ppm)


@kind('sample_clock_offset', 'station', {'deviation': 'ppm'}, linear('deviation', 1.0, 500.0))
def _sample_clock_offset(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        scene.clock[s] = scene.clock[s] * (1.0 + 1e-6 * p['deviation'])


# --- delay and air ---


@kind('air_refractivity', 'path', {'offset': '1e-6'}, linear('offset', 1.0, 500.0))
def _air_refractivity(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.refractivity = scene.refractivity + p['offset']


@kind('delay_offset', 'path', {'delay': 'ns'}, linear('delay', 0.01, 100.0))
def _delay_offset(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.delay = scene.delay + 1e-9 * p['delay']


@kind('delay_temperature', 'station', {'slope': 'ps/K'}, linear('slope', 1.0, 1e4))
def _delay_temperature(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        scene.delay = scene.delay + 1e-12 * p['slope'] * _above_calibration(scene, s)


# --- rays ---


@kind('ground_reflection', 'path', {'height_product': 'm^2', 'coefficient': '1'}, linear('coefficient', 0.003, 0.9))
def _ground_reflection(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.rays.append(Ray(lambda r: np.sqrt(r * r + 4.0 * p['height_product']), -p['coefficient']))


@kind(
    'echo',
    'path',
    {'excess_range': 'm', 'relative_power': 'dB', 'phase': 'rad'},
    decibel('relative_power', -50.0, -110.0, -1.0),
)
def _echo(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    amplitude = 10.0 ** (p['relative_power'] / 20.0)
    scene.rays.append(Ray(lambda r: r + p['excess_range'], amplitude, p.get('phase', 0.0)))


@kind('amplitude_loss', 'path', {'loss': 'dB', 'specific': 'dB/km'}, linear('loss', 0.05, 40.0))
def _amplitude_loss(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.gain = scene.gain - p.get('loss', 0.0) - p.get('specific', 0.0) * scene.distance / 1e3


@kind('amplitude_slope', 'station', {'slope': 'dB'}, linear('slope', 0.02, 30.0))
def _amplitude_slope(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        scene.fall[s] += p['slope']


# --- motion and geometry ---


@kind('target_motion', 'path', {'velocity': 'm/s'}, linear('velocity', 0.003, 100.0))
def _target_motion(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    velocity = np.broadcast_to(np.asarray(p['velocity'], float), (len(scene.condition.distances),))[scene.setting]
    begin = scene.time - _step_within(scene)

    def displacement(rows: np.ndarray, time: np.ndarray) -> np.ndarray:
        shape = (-1,) + (1,) * (time.ndim - 1)
        return velocity[rows].reshape(shape) * (time - begin[rows].reshape(shape))

    scene.motions.append(Motion(displacement, seen=True))


@kind('sway', 'path', {'amplitude': 'm', 'frequency': 'Hz', 'phase': 'rad'}, linear('amplitude', 1e-4, 10.0))
def _sway(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    def displacement(rows: np.ndarray, time: np.ndarray) -> np.ndarray:
        return p['amplitude'] * np.sin(2.0 * math.pi * p['frequency'] * time + p.get('phase', 0.0))

    scene.motions.append(Motion(displacement, seen=False))


@kind('slant_geometry', 'path', {'height_difference': 'm'}, linear('height_difference', 0.5, 100.0))
def _slant_geometry(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.antenna_distance = lambda r: np.hypot(r, p['height_difference'])


# --- sweep shape: frequency error in Hz of the station's clock, phase its integral over the clock's time ---


@kind('sweep_curvature', 'station', {'deviation': 'Hz'}, linear('deviation', 5.0, 1e7))
def _sweep_curvature(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    ramp = scene.condition.ramp_duration
    for s in stations:
        # parabola 4 x (1 - x), x the share of the ramp, integrated
        scene.chirp[s].append(lambda t: p['deviation'] * ramp * (2.0 * (t / ramp) ** 2 - 4.0 / 3.0 * (t / ramp) ** 3))


@kind('sweep_ripple', 'station', {'deviation': 'Hz', 'rate': 'Hz', 'phase': 'rad'}, linear('deviation', 5.0, 1e6))
def _sweep_ripple(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    start, turn = p.get('phase', 0.0), 2.0 * math.pi * p['rate']
    for s in stations:
        # integral of sin(a + b) by half angles: no difference of cosines where it is small
        scene.chirp[s].append(
            lambda t: p['deviation'] * 2.0 * np.sin(0.5 * turn * t) * np.sin(start + 0.5 * turn * t) / turn
        )


@kind(
    'pll_settling',
    'station',
    {'step': 'Hz', 'natural_frequency': 'Hz', 'damping': '1'},
    linear('step', 300.0, 1e8),
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


@kind('sweep_rate', 'station', {'error': '%'}, linear('error', 1e-6, 10.0))
def _sweep_rate(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        scene.chirp[s].append(lambda t: 0.5e-2 * p['error'] * scene.condition.chirp_rate * t * t)


@kind('ramp_window', 'station', {'start': 's', 'end': 's'}, linear('start', 2e-6, 4e-4))
def _ramp_window(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        first, last = scene.straight[s]
        scene.straight[s] = max(first, p.get('start', 0.0)), min(last, p.get('end', math.inf))


@kind('frequency_modulation', 'station', {'deviation': 'Hz', 'rate': 'Hz'}, linear('deviation', 5.0, 1e6))
def _frequency_modulation(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        number = len(scene.own_phases)
        scene.own_phases.append((_HUM, number, s))
        scene.hums[s].append((p['deviation'], p['rate'], (_HUM, number)))


@kind('sweep_shape', 'station', {'relative_rate': '1'}, Size('relative_rate', _bowl, 1e-5, 1e-9, 0.5, neutral=1.0))
def _sweep_shape(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    ramp, k = scene.condition.ramp_duration, scene.condition.chirp_rate
    degree, weights = 3, np.asarray(p['relative_rate'], float)
    # a clamped knot vector, de Boor's mean of a B-spline over it, and both integrals as piecewise polynomials
    knots = np.concatenate([[0.0] * degree, np.linspace(0.0, 1.0, len(weights) - degree + 1), [1.0] * degree])
    mean = float(weights @ (knots[degree + 1 :] - knots[: -degree - 1])) / (degree + 1)
    rate = interpolate.PPoly.from_spline((knots, weights / mean - 1.0, degree), extrapolate=True)
    turns = rate.antiderivative(2)

    for s in stations:
        scene.chirp[s].append(lambda t: k * ramp * ramp * turns(t / ramp))


# --- noise ---


@kind('phase_noise', 'station', {'level': 'dBc/Hz', 'corner': 'Hz'}, Size('level', lambda s: -90.0 + s, 0.3, 1e-3, 40))
def _phase_noise(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        level, corner, shape = scene.oscillators[s]
        scene.oscillators[s] = (p.get('level', level), p.get('corner', corner), shape)


@kind('noise_floor', 'station', {'excess': 'dB'}, linear('excess', 0.05, 40.0))
def _noise_floor(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    for s in stations:
        scene.noise_floor[s] = scene.noise_floor[s] + p['excess']


@kind(
    'interference_burst',
    'station',
    {'probability': '1', 'level': 'dBFS', 'duration': 's'},
    decibel('level', -62.0, -90.0, -10.0),
)
def _interference_burst(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    std = full_scale(scene, p['level']) * math.sqrt(0.5)
    length = p['duration'] * scene.condition.sample_rate

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        x = x.copy()
        for i, row in enumerate(rows):
            random = scene.stream(Stream.EFFECT, _BURST, station, int(row))
            hit, position = random.random(2)
            if hit < p['probability']:
                t = np.arange(x.shape[1]) - position * x.shape[1]
                inside = (t >= 0.0) & (t < length)
                x[i, inside] += (std * random.standard_normal(int(inside.sum()))).astype(x.dtype)
        return x

    for s in stations:
        scene.analogue[s].append((Stage.INPUT, hook))
        scene.burst_power.append((s, p['probability'], length, std**2))


# --- receiver ---


@kind('tx_leakage', 'station', {'level': 'dBFS', 'delay': 'ns'}, decibel('level', -85.0, -120.0, -20.0))
def _tx_leakage(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    # a chirp mixed with itself: for as long as it is on a constant, or the line of its delay
    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        c, late = scene.condition, 1e-9 * p.get('delay', 0.0)
        own = scene.alpha[station, rows, None] * scene.step(station)[rows, None] * np.arange(x.shape[1])
        before = own - scene.alpha[station, rows, None] * late  # what the clock said when it left
        on = (before >= 0.0) & (own <= c.ramp_duration)
        turns = (own - before) * (c.start_frequency + 0.5 * c.chirp_rate * (own + before))
        return x + (full_scale(scene, p['level']) * on * np.cos(2.0 * math.pi * turns)).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.INPUT, hook))


@kind('spur', 'station', {'frequency': 'Hz', 'level': 'dBFS'}, decibel('level', -90.0, -130.0, -20.0))
def _spur(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    number = len(scene.own_phases)

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        start = scene.own_phase(_SPUR, number, station, rows)
        u = scene.step(station)[rows, None] * np.arange(x.shape[1])
        line = np.cos(2.0 * math.pi * (p['frequency'] * u + start[:, None]))
        return x + (full_scale(scene, p['level']) * line).astype(x.dtype)

    for s in stations:
        scene.own_phases.append((_SPUR, number, s))
        scene.analogue[s].append((Stage.INPUT, hook))


@kind('if_filter', 'station', {'pole': 'Hz', 'noise_behind': '1'}, Size('pole', lambda s: 1.0 / s, 1e-8, 1e-9, 1e-4))
def _if_filter(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    def response(frequency: np.ndarray) -> np.ndarray:
        return 1.0 / (1.0 + 1j * frequency / p['pole'])

    for s in stations:
        scene.responses[s].append(response)
        scene.poles[s].append(p['pole'])
        scene.noise_behind[s] |= bool(p.get('noise_behind', False))


@kind('ac_coupling', 'station', {'pole': 'Hz'}, linear('pole', 1e3, 1e7))
def _ac_coupling(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        # silence until the capacitor's charge is gone, or for as long as there is memory
        silence = min(16.0 * scene.condition.sample_rate / (2.0 * math.pi * p['pole']), _LONGEST_SILENCE)
        period = fft.next_fast_len(x.shape[1] + math.ceil(silence), real=True)
        frequency = np.fft.rfftfreq(period) / scene.step(station)[rows, None]
        passed = fft.rfft(x, period) * (1j * frequency / (1j * frequency + p['pole']))
        return fft.irfft(passed, period)[:, : x.shape[1]].astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.COUPLING, hook))


@kind('receiver_settling', 'station', {'level': 'dBFS', 'time_constant': 's'}, decibel('level', -75.0, -120.0, -10.0))
def _receiver_settling(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        per_sample = np.exp(-scene.step(station)[rows, None] / p['time_constant'])
        return x + (full_scale(scene, p['level']) * per_sample ** np.arange(x.shape[1])).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.INPUT, hook))


@kind('compression', 'station', {'third_order': '1'}, linear('third_order', 0.01, 20.0))
def _compression(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        share = x / scene.condition.full_scale
        return (x * (1.0 - p['third_order'] * share * share)).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.AMPLIFIER, hook))


@kind('second_order_distortion', 'station', {'second_order': '1'}, linear('second_order', 0.003, 20.0))
def _second_order_distortion(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        return (x * (1.0 + p['second_order'] * (x / scene.condition.full_scale))).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.AMPLIFIER, hook))


@kind('clipping', 'station', {'level': 'dBFS'}, Size('level', lambda s: -20.0 * math.log10(s), 3.0, 0.5, 1e3))
def _clipping(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        limit = full_scale(scene, p['level'])
        return np.clip(x, -limit, limit)

    for s in stations:
        scene.analogue[s].append((Stage.LIMITER, hook))


# --- reference instrument ---


@kind('reference_lag', 'reference', {'lag': 's'}, linear('lag', 0.003, 100.0))
def _reference_lag(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.reference_lag += p['lag']


@kind('reference_offset', 'reference', {'offset': 'm'}, linear('offset', 1e-3, 100.0))
def _reference_offset(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.reference_errors.append(lambda r: np.full(r.shape, p['offset']))


@kind('reference_scale', 'reference', {'scale': 'ppm'}, linear('scale', 1.0, 1e4))
def _reference_scale(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    scene.reference_errors.append(lambda r: 1e-6 * p['scale'] * r)


REGISTERED = tuple(sorted(name for name, kind_ in KINDS.items() if kind_.registered))
"""Names of the interface's effects."""
