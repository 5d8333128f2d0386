"""Measurements of a small scene with effects, for the tests of their physics."""

import math

import numpy as np
from scenes import mapping

from drfmcw_sim.effect_table import example_of
from drfmcw_sim.effects import Effect, Of, effect_from_mapping
from drfmcw_sim.scenario import scenario_from_mapping
from drfmcw_sim.synthesis.signal_model import synthesise
from drfmcw_sim.timeline import Timeline

C = 299792458.0
RATE = 2.048e6
CENTER = 5.8e9
CHIRP = 150e9  # Hz/s
BOTH_ON = slice(24, 2024)  # samples in which every station hears the other one
SEED = 5

# Every parameter away from the value at which it does nothing.
SIZES = {
    'reference_clock_drift': {'rate': 8.0, 'warmup': 2.0, 'time_constant': 300.0},
    'amplitude_loss': {'loss': 3.0, 'specific': 10.0},
    'echo': {'excess_range': 7.5, 'relative_power': -30.0, 'phase': 0.8},
    'sweep_ripple': {'deviation': 500.0, 'rate': 9000.0, 'phase': 2.2},
    'sway': {'amplitude': 0.005, 'frequency': 0.7, 'phase': 0.4},
    'phase_noise': {'level': -80.0, 'corner': 1e5},
    'compression': {'third_order': 0.3},
    'second_order_distortion': {'second_order': 0.3},
    'receiver_settling': {'level': -45.0, 'time_constant': 1e-4},
    'tx_leakage': {'level': -45.0, 'delay': 30.0},
    'spur': {'frequency': 3e5, 'level': -45.0},
    'target_motion': {'velocity': [0.3]},
    'interference_burst': {'probability': 1.0, 'level': -45.0, 'duration': 3e-4},
}


def sized(name, **parameters):
    """The entry of a scenario's list for one effect, at the slave where it belongs to a station."""
    cls = Effect.registry[name]
    return (
        {'effect': name}
        | ({'station': 'slave'} if cls.of is Of.STATION else {})
        | (parameters or SIZES.get(name) or example_of(cls))
    )


def made(effects):
    """Effects from entries."""
    return [effect_from_mapping(e, 'test', ['master', 'slave', 'third']) for e in effects]


def measured(n=3, distance=100.0, speed=None, alphas=(1.000006, 0.999991), homodyne=False, start=0, **sections):
    """Conditions of n measurements 50 s apart (0.05 s where the crane drives), boards 10 K above calibration."""
    trajectory = {'standing': {'distances': [distance], 'sweeps': n + start}}
    if speed is not None:
        ends = [distance, distance + math.copysign(400.0, speed)]
        trajectory = {'drive': {'waypoints': ends, 'speed': abs(speed), 'acceleration': 0.5, 'dwell': 0.0}}
    timing = {'start_delay_jitter': 0.0, 'amplitude_scatter': 0.0, 'sweep_interval': 50.0 if speed is None else 0.05}
    whole = mapping(trajectory, alphas, timing=timing, **sections)
    for settings in whole['stations'].values():
        settings['board_temperature'] = 35.0
    if homodyne:
        whole['pairs'][0]['second'] = 'master'
    timeline = Timeline(scenario_from_mapping(whole, 'test'), mode_by_range=False)
    return timeline.measurements(timeline.slots(n + start)[start:], 0)


def prepared(m, effects):
    """A copy of the measurements with all effects applied."""
    m = m.rows(slice(None))
    for effect in sorted(effects, key=lambda e: e.stage):
        effect.prepare(m)
    return m


def analogue(m, effects=()):
    """Noise-free complex IF of each station, float64 [n, samples]; real IF has no imaginary part."""
    signals = synthesise(m, SEED, effects, noise=False, quantised=False)
    return [s[..., 0].astype(float) + 1j * s[..., 1] if s.ndim == 3 else s.astype(float) for s in signals]


def reading(effects, time=7.0, distance=100.0, velocity=0.5):
    """What effects add to the reference of a crane that passes at constant velocity."""
    return sum(e.reference_error(time, distance, lambda t: distance + velocity * (t - time)) for e in effects)


def observed(m, effects):
    """Everything that effects change, as one vector: signals in parts of their amplitude, noise, reference."""
    parts = [(s / np.abs(n).max()).ravel() for s, n in zip(analogue(m, effects), analogue(m), strict=True)]
    whole = prepared(m, effects)
    noise = [s.noise_std() / n.noise_std() for s, n in zip(whole.stations, m.stations, strict=True)]
    offsets = np.array([1e3, 1e5, 5e5])
    oscillators = [
        np.log(s.phase_noise.phase_density(offsets) / n.phase_noise.phase_density(offsets))
        for s, n in zip(whole.stations, m.stations, strict=True)
    ]
    vector = np.concatenate([*parts, *noise, *oscillators, [reading(effects)]])
    return np.concatenate([vector.real, vector.imag])


def combined(m, effects):
    """Range that both beat frequencies give, minus that of the nominal signal [n] [m]: least squares, Hann window."""
    window = np.hanning(BOTH_ON.stop - BOTH_ON.start)
    time = (np.arange(len(window)) - (len(window) - 1) / 2) / RATE
    shift = 0.0
    for before, after in zip(analogue(m), analogue(m, effects), strict=True):
        phase = np.unwrap(np.angle(after * np.conj(before))[:, BOTH_ON], axis=1)
        shift = shift + (phase @ (window * time)) / np.sum(window * time**2) / (2.0 * np.pi)
    return shift * C / m.refractive_index / (2.0 * CHIRP)
