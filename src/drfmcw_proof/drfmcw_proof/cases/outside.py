"""Effects outside the interface's registry."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy import special

from ..generator.model import SPEED_OF_LIGHT, Ray, Scene, Stage
from .kinds import KINDS, Parameters, Size, decibel, deviate, kind, linear
from .side_bands import signed_line

_FAN, _DITHER, _SUPPLY = 3, 4, 6  # streams of random numbers, as the registered effects have theirs


def _outside(name: str, of: str, units: Mapping[str, str], size: Size) -> Callable[[Any], Any]:
    return kind(name, of, units, size, registered=False)


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
        position = np.mod(codes, 2 * width)
        return np.where(position < width, codes + (width - position), codes).astype(np.int16)

    for s in stations:
        scene.digital[s].append(hook)


@_outside('gain_step', 'station', {'step': 'dB', 'time': 's'}, linear('step', 0.02, 20.0))
def _gain_step(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The IF amplifier's gain changes at a time within the sweep."""
    _weigh(scene, stations, lambda u: p['step'] * (u >= p['time']))


@_outside('gain_ripple', 'station', {'ripple': 'dB', 'rate': 'Hz', 'phase': 'rad'}, linear('ripple', 0.02, 20.0))
def _gain_ripple(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """A standing wave in front of the receiver: its gain goes up and down over the ramp's frequencies."""
    _weigh(scene, stations, lambda u: p['ripple'] * np.sin(2.0 * math.pi * p['rate'] * u + p['phase']))


@_outside('gain_sag', 'station', {'sag': 'dB', 'time_constant': 's'}, linear('sag', 0.02, 20.0))
def _gain_sag(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The IF amplifier's supply gives way when the sweep begins, and recovers."""
    _weigh(scene, stations, lambda u: -p['sag'] * np.exp(-u / p['time_constant']))


def _weigh(
    scene: Scene,
    stations: tuple[int, ...],
    decibels: Callable[[np.ndarray], np.ndarray],
    stage: Stage = Stage.AMPLIFIER,
) -> None:
    """Change the gain of a stage [dB] by the time in the sweep [s]."""

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        u = scene.step(station)[rows, None] * np.arange(x.shape[1])
        return (x * 10.0 ** (decibels(u) / 20.0)).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((stage, hook))


@_outside('phase_jump', 'station', {'angle': 'rad', 'time': 's'}, linear('angle', 0.003, 3.0))
def _phase_jump(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The synthesiser restarts its accumulator within the ramp."""
    for s in stations:
        scene.chirp[s].append(lambda t: p['angle'] / (2.0 * math.pi) * (t >= p['time']))


@_outside('frequency_step', 'station', {'step': 'ppm', 'temperature': 'degC'}, linear('step', 0.05, 100.0))
def _frequency_step(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The reference jumps where its board is warmer than a temperature (an activity dip of the crystal)."""
    for s in stations:
        deviate(scene, s, p['step'] * (scene.board[s] >= p['temperature']))


@_outside(
    'fan_modulation', 'station', {'depth': '1', 'rate': 'Hz', 'duty': '1'}, Size('depth', lambda s: s, 3e-3, 1e-7, 0.9)
)
def _fan_modulation(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """A fan's blades, or a pulsed supply, take a share of the amplitude in pulses of their own phase."""
    number = len(scene.own_phases)

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        start = scene.own_phase(_FAN, number, station, rows)
        turn = p['rate'] * scene.step(station)[rows, None] * np.arange(x.shape[1]) + start[:, None]
        return (x * (1.0 - p['depth'] * (np.mod(turn, 1.0) < p['duty']))).astype(x.dtype)

    for s in stations:
        scene.own_phases.append((_FAN, number, s))
        scene.analogue[s].append((Stage.AMPLIFIER, hook))


@_outside('delay_hysteresis', 'station', {'slope': 'ps/K', 'time_constant': 's'}, linear('slope', 3.0, 1e4))
def _delay_hysteresis(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The delay follows the change of the board's temperature and creeps back: a high-pass over time."""
    for s in stations:
        creep, last, lag = np.zeros(len(scene)), scene.board[s, 0], 0.0
        for i in range(len(scene)):
            passed = scene.time[i] - scene.time[max(i - 1, 0)]
            lag = lag * math.exp(-passed / p['time_constant']) + (scene.board[s, i] - last)
            last, creep[i] = scene.board[s, i], lag
        scene.delay = scene.delay + 1e-12 * p['slope'] * creep


@_outside('adc_dither', 'station', {'amplitude': 'LSB', 'period': 'samples'}, linear('amplitude', 0.3, 2000.0))
def _adc_dither(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """Triangular dither of the converter that nobody subtracts, its start anywhere."""
    number = len(scene.own_phases)

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        start = scene.own_phase(_DITHER, number, station, rows)
        turn = np.mod(np.arange(x.shape[1]) / p['period'] + start[:, None], 1.0)
        return (x + p['amplitude'] * (4.0 * np.abs(turn - 0.5) - 1.0)).astype(x.dtype)

    for s in stations:
        scene.own_phases.append((_DITHER, number, s))
        scene.analogue[s].append((Stage.LIMITER, hook))


@_outside('dropped_samples', 'station', {'count': '1', 'time': 's'}, Size('count', lambda s: float(round(s)), 1, 1, 64))
def _dropped_samples(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The interface to the converter loses samples at one point; the rest moves up and the last one is repeated."""

    def hook(scene: Scene, station: int, rows: np.ndarray, codes: np.ndarray) -> np.ndarray:
        return _without_samples(scene, codes, p)

    for s in stations:
        scene.digital[s].append(hook)


def _without_samples(scene: Scene, codes: np.ndarray, p: Parameters) -> np.ndarray:
    """Return codes without some samples from a time on [s]; the last one is repeated."""
    position, count = int(p['time'] * scene.condition.sample_rate), int(p['count'])
    kept = np.arange(codes.shape[1])
    kept = np.minimum(np.where(kept < position, kept, kept + count), codes.shape[1] - 1)
    return codes[:, kept]


@_outside('frequency_glitch', 'station', {'peak': 'Hz', 'time': 's', 'width': 's'}, linear('peak', 300.0, 1e8))
def _frequency_glitch(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The synthesiser crosses an integer boundary: a Gaussian excursion of its frequency within the ramp."""
    scale = p['width'] * math.sqrt(0.5 * math.pi)
    for s in stations:
        scene.chirp[s].append(
            lambda t: p['peak'] * scale * (special.erf((t - p['time']) / (math.sqrt(2.0) * p['width'])))
        )


@_outside('interleaving', 'station', {'skew': 's', 'period': 'samples'}, linear('skew', 2e-9, 2e-7))
def _interleaving(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """Interleaved converters of unequal timing: every `period`-th samples are taken late."""
    _shift(scene, stations, lambda u: p['skew'] * (np.arange(u.shape[1]) % int(p['period']) == 0))


@_outside('sampling_ripple', 'station', {'skew': 's', 'rate': 'Hz', 'phase': 'rad'}, linear('skew', 2e-9, 5e-7))
def _sampling_ripple(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The converter's clock is pulled by a supply that starts with the sweep: times of samples go to and fro."""
    # no sample before the sweep
    _shift(scene, stations, lambda u: p['skew'] * (1.0 + np.sin(2.0 * math.pi * p['rate'] * u + p['phase'])))


@_outside('sampling_settling', 'station', {'skew': 's', 'time_constant': 's'}, linear('skew', 2e-9, 5e-7))
def _sampling_settling(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The converter's clock is late when the sweep begins, and settles."""
    _shift(scene, stations, lambda u: p['skew'] * np.exp(-u / p['time_constant']) - min(p['skew'], 0.0))


def _shift(scene: Scene, stations: tuple[int, ...], late: Callable[[np.ndarray], np.ndarray]) -> None:
    """Take samples later [s] by the time in the sweep [s]."""
    for s in stations:
        scene.warp[s].append(lambda scene, rows, u: u + late(u))


@_outside('aperture_jitter', 'station', {'jitter': 's'}, linear('jitter', 1e-9, 1e-7))
def _aperture_jitter(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The converter samples at uncertain times: white noise in proportion to the line's slope."""
    rows = np.arange(len(scene))
    for s in stations:
        slope = math.sqrt(0.5) * 2.0 * math.pi * np.abs(signed_line(scene, s, rows)) * scene.amplitude(s, rows)
        more = (p['jitter'] * slope / scene.noise_std(s)) ** 2
        scene.noise_floor[s] = scene.noise_floor[s] + 10.0 * np.log10(1.0 + more)


@_outside('crossover_distortion', 'station', {'depth': 'LSB'}, linear('depth', 0.3, 2000.0))
def _crossover_distortion(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """An output stage without bias gives too little about zero."""

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        return (x - p['depth'] * np.tanh(x / p['depth'])).astype(x.dtype)

    for s in stations:
        scene.analogue[s].append((Stage.AMPLIFIER, hook))


@_outside('gain_switch', 'station', {'step': 'dB', 'within': 'm'}, linear('step', 0.05, 20.0))
def _gain_switch(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The receiver takes another gain where the crane is near, and its calibration knows one only."""
    change = p['step'] * (scene.distance < p['within'])
    for s in stations:
        scene.gain[s] = scene.gain[s] + change
        scene.noise_floor[s] = scene.noise_floor[s] + change


@_outside('loose_contact', 'station', {'loss': 'dB', 'every': '1'}, linear('loss', 0.2, 20.0))
def _loose_contact(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """A plug shakes with a motor: one sweep of `every` is received weaker."""
    for s in stations:
        scene.gain[s] = scene.gain[s] - p['loss'] * (np.arange(len(scene)) % int(p['every']) == 0)


@_outside('gain_hum', 'station', {'depth': 'dB', 'rate': 'Hz'}, linear('depth', 0.02, 10.0))
def _gain_hum(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The mains come through the supply of the IF amplifier: slower than the sweep, in each at a phase of its own."""
    number = len(scene.own_phases)

    def hook(scene: Scene, station: int, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        start = scene.own_phase(_SUPPLY, number, station, rows)
        turn = p['rate'] * scene.step(station)[rows, None] * np.arange(x.shape[1]) + start[:, None]
        return (x * 10.0 ** (p['depth'] * np.sin(2.0 * math.pi * turn) / 20.0)).astype(x.dtype)

    for s in stations:
        scene.own_phases.append((_SUPPLY, number, s))
        scene.analogue[s].append((Stage.AMPLIFIER, hook))


@_outside('interleaving_gain', 'station', {'step': 'dB', 'period': 'samples'}, linear('step', 0.02, 10.0))
def _interleaving_gain(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """Interleaved converters of unequal gain: every `period`-th samples are larger."""
    larger = p['step'] * (np.arange(scene.condition.sample_count) % int(p['period']) == 0)
    _weigh(scene, stations, lambda u: larger, Stage.LIMITER)


@_outside(
    'sporadic_drop',
    'station',
    {'count': '1', 'time': 's', 'every': '1'},
    Size('count', lambda s: float(round(s)), 1, 1, 64),
)
def _sporadic_drop(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The interface to the converter loses samples in one sweep of `every`."""

    def hook(scene: Scene, station: int, rows: np.ndarray, codes: np.ndarray) -> np.ndarray:
        return np.where((rows % int(p['every']) == 0)[:, None], _without_samples(scene, codes, p), codes)

    for s in stations:
        scene.digital[s].append(hook)


# --- of the path and of the reference instrument ---


@_outside(
    'swinging_echo',
    'path',
    {'excess_range': 'm', 'relative_power': 'dB', 'swing': 'm', 'rate': 'Hz', 'phase': 'rad'},
    decibel('relative_power', -40.0, -110.0, -1.0),
)
def _swinging_echo(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """A load that swings on its ropes reflects: the echo's way becomes longer and shorter."""
    moved = p['swing'] * np.sin(2.0 * math.pi * p['rate'] * scene.time + p['phase'])
    middle = scene.condition.start_frequency + 0.5 * scene.condition.bandwidth
    turned = 2.0 * math.pi * middle / SPEED_OF_LIGHT * moved  # the way changes by far less than a resolution cell
    scene.rays.append(Ray(lambda r: r + p['excess_range'], 10.0 ** (p['relative_power'] / 20.0), turned))


@_outside(
    'triple_trip', 'path', {'relative_power': 'dB', 'phase': 'rad'}, decibel('relative_power', -40.0, -110.0, -1.0)
)
def _triple_trip(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """Both antennas reflect, so the wave comes again after three times the way; stated where the crane is nearest."""
    weaker = (np.min(scene.distance) / scene.distance) ** 2
    scene.rays.append(Ray(lambda r: 3.0 * r, 10.0 ** (p['relative_power'] / 20.0) * weaker, p['phase']))


@_outside('shadowing', 'path', {'loss': 'dB', 'from': 'm', 'to': 'm'}, linear('loss', 0.2, 30.0))
def _shadowing(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """Something stands in the way between two distances."""
    scene.gain = scene.gain - p['loss'] * ((scene.distance >= p['from']) & (scene.distance <= p['to']))


@_outside('wet_antenna', 'path', {'loss': 'dB', 'time': 's'}, linear('loss', 0.2, 30.0))
def _wet_antenna(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """It begins to rain on an antenna's cover."""
    scene.gain = scene.gain - p['loss'] * (scene.time >= p['time'])


@_outside('air_gradient', 'path', {'gradient': '1e-6/km'}, linear('gradient', 5.0, 5e3))
def _air_gradient(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """The air at the far end is another than at the weather sensor: the mean over the way grows with the distance."""
    scene.refractivity = scene.refractivity + p['gradient'] * 1e-3 * scene.distance


@_outside('reference_rounding', 'reference', {'step': 'm'}, linear('step', 0.02, 20.0))
def _reference_rounding(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """Marks along the rail are far apart: the reference gives the middle between two of them."""
    scene.reference_errors.append(lambda r: p['step'] * (np.floor(r / p['step']) + 0.5) - r)


@_outside(
    'local_echo',
    'path',
    {'excess_range': 'm', 'relative_power': 'dB', 'phase': 'rad', 'from': 'm', 'to': 'm'},
    decibel('relative_power', -40.0, -110.0, -1.0),
)
def _local_echo(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """Something beside the rail reflects while the crane passes it: an echo between two distances only."""
    there = (scene.distance >= p['from']) & (scene.distance <= p['to'])
    amplitude = 10.0 ** (p['relative_power'] / 20.0) * there
    scene.rays.append(Ray(lambda r: r + p['excess_range'], amplitude, p.get('phase', 0.0)))


@_outside(
    'fixed_reflector',
    'path',
    {'position': 'm', 'relative_power': 'dB', 'phase': 'rad'},
    decibel('relative_power', -40.0, -110.0, -1.0),
)
def _fixed_reflector(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """A mast behind the crane throws the signal back to it: this way becomes shorter as the crane comes near it."""
    before = scene.distance < p['position']
    length = 2.0 * p['position'] - scene.distance
    amplitude = 10.0 ** (p['relative_power'] / 20.0) * before * scene.distance / np.maximum(length, 1.0)
    scene.rays.append(Ray(lambda r: np.maximum(2.0 * p['position'] - r, r), amplitude, p.get('phase', 0.0)))


@_outside('rail_bend', 'reference', {'height': 'm', 'length': 'm'}, linear('height', 0.005, 10.0))
def _rail_bend(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """The rail bends: the straight line between the antennas is shorter than the way along it."""
    scene.reference_errors.append(lambda r: -p['height'] * np.sin(math.pi * r / p['length']))


@_outside(
    'reference_wander', 'reference', {'amplitude': 'm', 'period': 's', 'phase': 'rad'}, linear('amplitude', 5e-3, 10.0)
)
def _reference_wander(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """Multipath of a satellite receiver: its error changes over minutes."""
    error = p['amplitude'] * np.sin(2.0 * math.pi * scene.time / p['period'] + p['phase'])
    scene.reference_errors.append(lambda r: error)


@_outside('delay_step', 'station', {'step': 'ns', 'time': 's'}, linear('step', 0.01, 100.0))
def _delay_step(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """Somebody moves a connector: from a time on the delay is another one."""
    for _ in stations:
        scene.delay = scene.delay + 1e-9 * p['step'] * (scene.time >= p['time'])


@_outside('delay_creep', 'station', {'rate': 'ps/s'}, linear('rate', 0.05, 1e4))
def _delay_creep(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """A cable takes up water: its delay grows with time, whatever the temperature."""
    for _ in stations:
        scene.delay = scene.delay + 1e-12 * p['rate'] * scene.time


@_outside(
    'weather_wander', 'path', {'amplitude': '1e-6', 'period': 's', 'phase': 'rad'}, linear('amplitude', 1.0, 500.0)
)
def _weather_wander(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """Sun and shade move over the way: its air changes while the weather sensor stands still."""
    turns = scene.time / p['period']
    scene.refractivity = scene.refractivity + p['amplitude'] * np.sin(2.0 * math.pi * turns + p['phase'])


@_outside('reference_backlash', 'reference', {'play': 'm', 'from_afar': '1'}, linear('play', 5e-3, 1.0))
def _reference_backlash(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """A measuring wheel has play: it reads too far where the crane came from afar, and too near else."""
    direction = 1.0 - 2.0 * np.array(p['from_afar'])[scene.setting]
    scene.reference_errors.append(lambda r: -0.5 * p['play'] * direction)


@_outside(
    'reference_graduation',
    'reference',
    {'amplitude': 'm', 'period': 'm', 'phase': 'rad'},
    linear('amplitude', 5e-3, 1.0),
)
def _reference_graduation(scene: Scene, _: tuple[int, ...], p: Parameters) -> None:
    """A coded band is not evenly divided: its error repeats along the rail."""
    scene.reference_errors.append(lambda r: p['amplitude'] * np.sin(2.0 * math.pi * r / p['period'] + p['phase']))


@_outside('gain_temperature', 'station', {'slope': 'dB/K'}, linear('slope', 0.005, 2.0))
def _gain_temperature(scene: Scene, stations: tuple[int, ...], p: Parameters) -> None:
    """The receiver's gain follows its board's temperature."""
    for s in stations:
        above = scene.board[s] - scene.condition.stations[s].calibration_temperature
        scene.gain[s] = scene.gain[s] + p['slope'] * above


OUTSIDE = tuple(sorted(name for name, kind_ in KINDS.items() if not kind_.registered))
"""Names of effects that the interface does not know."""
