"""Every effect of the registry: one contract for all, and the physics of each against its closed form."""

import dataclasses
import inspect
import itertools
import math
import re

import numpy as np
import pytest
import yaml
from checkout import DATA, ROOT
from scenes import mapping, scene
from scipy import integrate
from scipy.signal import hilbert

from drfmcw_physics.settings import ConfigurationError, declared_parameters
from drfmcw_sim.effect_table import example_of
from drfmcw_sim.effects import Effect, Of, effect_from_mapping
from drfmcw_sim.scenario import scenario_from_mapping
from drfmcw_sim.synthesis.signal_model import draw_sweeps, synthesise
from drfmcw_sim.timeline import Timeline

C = 299792458.0
RATE = 2.048e6
CENTER = 5.8e9
CHIRP = 150e9  # Hz/s
BOTH_ON = slice(24, 2024)  # samples in which every station hears the other one
SEED = 5

# Names, what one instance belongs to, and parameters with their units, as the interfaces have them.
INTERFACE = {
    'reference_clock_offset': ('station', {'deviation': 'ppm'}),
    'reference_clock_temperature': ('station', {'slope': 'ppm/K'}),
    'reference_clock_drift': ('station', {'rate': 'ppm/h', 'warmup': 'ppm', 'time_constant': 's'}),
    'sample_clock_offset': ('station', {'deviation': 'ppm'}),
    'air_refractivity': ('path', {'offset': '1e-6'}),
    'delay_offset': ('path', {'delay': 'ns'}),
    'delay_temperature': ('station', {'slope': 'ps/K'}),
    'ground_reflection': ('path', {'height_product': 'm^2', 'coefficient': '1'}),
    'echo': ('path', {'excess_range': 'm', 'relative_power': 'dB', 'phase': 'rad'}),
    'tx_leakage': ('station', {'level': 'dBFS', 'delay': 'ns'}),
    'spur': ('station', {'frequency': 'Hz', 'level': 'dBFS'}),
    'sweep_curvature': ('station', {'deviation': 'Hz'}),
    'sweep_ripple': ('station', {'deviation': 'Hz', 'rate': 'Hz'}),
    'pll_settling': ('station', {'step': 'Hz', 'natural_frequency': 'Hz', 'damping': '1'}),
    'sweep_rate': ('station', {'error': '%'}),
    'ramp_window': ('station', {'start': 's', 'end': 's'}),
    'frequency_modulation': ('station', {'deviation': 'Hz', 'rate': 'Hz'}),
    'sweep_shape': ('station', {'relative_rate': '1'}),
    'phase_noise': ('station', {'level': 'dBc/Hz', 'corner': 'Hz'}),
    'noise_floor': ('station', {'excess': 'dB'}),
    'amplitude_loss': ('path', {'loss': 'dB', 'specific': 'dB/km'}),
    'amplitude_slope': ('station', {'slope': 'dB'}),
    'target_motion': ('path', {'velocity': 'm/s'}),
    'sway': ('path', {'amplitude': 'm', 'frequency': 'Hz'}),
    'slant_geometry': ('path', {'height_difference': 'm'}),
    'clipping': ('station', {'level': 'dBFS'}),
    'compression': ('station', {'third_order': '1'}),
    'ac_coupling': ('station', {'pole': 'Hz'}),
    'receiver_settling': ('station', {'level': 'dBFS', 'time_constant': 's'}),
    'iq_imbalance': ('station', {'gain': 'dB', 'phase': 'deg'}),
    'second_order_distortion': ('station', {'second_order': '1'}),
    'if_filter': ('station', {'pole': 'Hz', 'noise_behind': '1'}),
    'interference_burst': ('station', {'probability': '1', 'level': 'dBFS', 'duration': 's'}),
    'reference_lag': ('reference', {'lag': 's'}),
    'reference_offset': ('reference', {'offset': 'm'}),
    'reference_scale': ('reference', {'scale': 'ppm'}),
}
# Parameters that make an effect vanish, where they are not zero.
NOTHING = {
    'echo': {'relative_power': -200.0, 'excess_range': 7.5, 'phase': 1.0},
    'ground_reflection': {'coefficient': 0.0, 'height_product': 50.0},
    'tx_leakage': {'level': -200.0},
    'spur': {'level': -200.0, 'frequency': 3e5},
    'sweep_ripple': {'deviation': 0.0, 'rate': 5e3},
    'pll_settling': {'step': 0.0, 'natural_frequency': 2e4, 'damping': 0.5},
    'phase_noise': {},
    'sweep_shape': {'relative_rate': [1.0, 1.0, 1.0, 1.0]},
    'frequency_modulation': {'deviation': 0.0, 'rate': 100.0},
    'ramp_window': {},
    'reference_clock_drift': {},
    'amplitude_loss': {},
    'clipping': {'level': 20.0},
    'if_filter': {'pole': 1e17},
    'receiver_settling': {'level': -200.0, 'time_constant': 1e-4},
    'interference_burst': {'probability': 0.0, 'level': -10.0, 'duration': 1e-4},
    'sway': {'amplitude': 0.0, 'frequency': 1.0},
}
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
# What a step does not move smoothly: an event, and its length in whole samples.
DISCRETE = {
    ('interference_burst', 'probability'), ('interference_burst', 'duration'),
    ('ramp_window', 'start'), ('ramp_window', 'end'),
}  # fmt: skip
ON_RECEIVER_ONLY = (
    'sample_clock_offset', 'tx_leakage', 'spur', 'noise_floor', 'clipping', 'compression', 'if_filter',
    'interference_burst', 'amplitude_slope', 'second_order_distortion', 'ac_coupling',
    'receiver_settling', 'iq_imbalance',
)  # fmt: skip
EFFECTS = sorted(INTERFACE)


def sized(name, **parameters):
    """The entry of a scenario's list for one effect, at the slave where it belongs to a station."""
    parameters = parameters or SIZES.get(name) or example_of(Effect.registry[name])
    return {'effect': name} | ({'station': 'slave'} if INTERFACE[name][0] == 'station' else {}) | parameters


def flags(name):
    """Names of the parameters of an effect that are true or false."""
    return {f.name for f in dataclasses.fields(Effect.registry[name]) if f.type in (bool, 'bool')}


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


# --- the contract ---


def test_registry_is_that_of_the_interfaces():
    """All names, nothing else; their parameters with units; what the interfaces do not name has a default."""
    assert sorted(Effect.registry) == EFFECTS
    for name, (of, parameters) in INTERFACE.items():
        cls = Effect.registry[name]
        declared = declared_parameters(cls)
        assert cls.of == of, name
        assert {p: declared[p][1].unit for p in parameters} == parameters, name
        for extra in set(declared) - set(parameters):
            assert declared[extra][0].default is not dataclasses.MISSING, (name, extra)


@pytest.mark.parametrize('name', EFFECTS)
def test_effect_is_declared(name):
    """One short file each, that says what it is, what it does, what it acts on, and a typical size."""
    cls = Effect.registry[name]
    assert len(inspect.getsource(inspect.getmodule(cls)).splitlines()) < 70
    assert cls.__doc__ and cls.formula and '\n' not in cls.formula and cls.example
    assert cls.acts_on and cls.headline and cls.title and isinstance(cls.of, Of)
    for parameter, (_, declared) in declared_parameters(cls).items():
        assert declared.description and declared.unit, parameter
        assert math.isfinite(sum(declared.bounds)) or parameter in flags(name), parameter


@pytest.mark.parametrize('name', EFFECTS)
def test_round_trip_through_yaml(name):
    """An effect written as YAML is read as the same effect; a scenario takes it."""
    (effect,) = made([sized(name)])
    values = {k: v for k, v in dataclasses.asdict(effect).items() if v == v and v != ''}
    entry = yaml.safe_load(yaml.safe_dump({'effect': name} | values))
    (again,) = made([entry])
    assert {k: v for k, v in dataclasses.asdict(again).items() if v == v and v != ''} == values
    assert len(scene({'standing': {'distances': [100]}}, effects=[entry]).effects) == 1


@pytest.mark.parametrize('name', EFFECTS)
def test_size_of_zero_changes_no_bit(name):
    """Samples with noise, and the reference."""
    effects = made([sized(name, **NOTHING.get(name, dict.fromkeys(INTERFACE[name][1], 0.0)))])
    if name in NOTHING and not NOTHING[name]:
        effects = made([{'effect': name}])
    m = measured(6)
    for nominal, changed in zip(synthesise(m, SEED), synthesise(m, SEED, effects), strict=True):
        assert np.array_equal(nominal, changed)
    assert reading(effects) == 0.0


@pytest.mark.parametrize('name', [n for n in EFFECTS if INTERFACE[n][0] == 'station'])
def test_acts_at_its_station_only(name):
    """An effect of a third station changes no bit; one of the slave's receiver none of the master's samples."""
    m = measured(4, waveform={'iq': name == 'iq_imbalance'})
    nominal = synthesise(m, SEED)
    for a, b in zip(nominal, synthesise(m, SEED, made([sized(name) | {'station': 'third'}])), strict=True):
        assert np.array_equal(a, b)
    changed = synthesise(m, SEED, made([sized(name)]))
    assert not np.array_equal(nominal[1], changed[1])
    clean, effects = analogue(m), made([sized(name)])
    assert np.array_equal(clean[0], analogue(m, effects)[0]) == (name in (*ON_RECEIVER_ONLY, 'phase_noise'))
    everywhere = {k: v for k, v in sized(name).items() if k != 'station'}
    both = synthesise(m, SEED, made([everywhere]))
    assert not np.array_equal(nominal[0], both[0])
    assert not np.array_equal(nominal[1], both[1])


@pytest.mark.parametrize(
    ('name', 'parameter'),
    [
        (n, p)
        for n in EFFECTS
        for p in declared_parameters(Effect.registry[n])
        if (n, p) not in DISCRETE and p not in flags(n)
    ],
)
def test_smooth_in_each_parameter(name, parameter):
    """Finite differences of two step sizes agree, so that the effect has a derivative, and it is not zero."""
    m = measured(3, waveform={'iq': True})
    entry = sized(name)
    value = entry[parameter]
    scale = value[0] if isinstance(value, list) else value

    def derivative(step):
        near = [scale + s * step for s in (0.5, -0.5)]
        values = [[v, *value[1:]] for v in near] if isinstance(value, list) else near
        high, low = (observed(m, made([entry | {parameter: v}])) for v in values)
        return (high - low) / step

    step = 1e-4 * abs(scale)
    for _ in range(2):  # so that samples change by a hundredth of the amplitude, well above their float32 rounding
        change = np.max(np.abs(derivative(step))) * step
        assert change > 0.0
        step = min(step * 0.01 / change, 0.2 * abs(scale))
    one, half = derivative(step), derivative(step / 2.0)
    # a limiter's kink moves: a sample on it takes part or not
    tolerance = 0.2 if name == 'clipping' else 0.01
    assert np.linalg.norm(one - half) < tolerance * np.linalg.norm(half)


@pytest.mark.parametrize('name', EFFECTS)
def test_row_does_not_depend_on_its_batch(name):
    """Bit-identical samples however the sweeps are batched."""
    effects = made([sized(name)])
    m = measured(19)
    whole = synthesise(m, SEED, effects, quantised=False)
    for size in (1, 7):
        for begin in range(0, 19, 3 * size):
            rows = slice(begin, begin + size)
            for a, b in zip(whole, synthesise(m.rows(rows), SEED, effects, quantised=False), strict=True):
                assert np.array_equal(a[rows], b)


@pytest.mark.parametrize('name', EFFECTS)
def test_copies_are_the_same_sweeps(name):
    """Bit-identical samples whether or not it is said that rows are copies that differ in their initial phases."""
    effects = made([sized(name)])
    m = measured(17).rows(np.tile(np.arange(17), 3))
    m.initial_phase[0] += np.repeat(np.arange(3) / 3.0, 17)
    apart, said = (synthesise(m, SEED, effects, noise=False, quantised=False, copies=c) for c in (1, 3))
    for a, b in zip(apart, said, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize('name', EFFECTS)
def test_works_with_every_receiver_and_ramp(name):
    """Real and quadrature IF, rising and falling ramps, pairs and stations that hear themselves: finite samples."""
    for iq, bandwidth, homodyne in itertools.product((False, True), (150e6, -150e6), (False, True)):
        m = measured(2, waveform={'iq': iq, 'bandwidth': bandwidth}, homodyne=homodyne)
        effects = made([sized(name) | ({'station': 'master'} if INTERFACE[name][0] == 'station' else {})])
        for signal, clean in zip(analogue(m, effects), analogue(m), strict=True):
            assert signal.shape == clean.shape
            assert np.all(np.isfinite(signal))


@pytest.mark.parametrize('name', EFFECTS)
def test_refuses_what_is_out_of_bounds(name):
    """One clear line that names the effect, the parameter and its bounds."""
    for parameter, (_, declared) in declared_parameters(Effect.registry[name]).items():
        low, high = (0.0, 1.0) if parameter in flags(name) else declared.bounds
        for wrong in (low - 1.0 - abs(low), high * 2.0 + 1.0, 'much'):
            with pytest.raises(ConfigurationError) as refusal:
                made([sized(name) | {parameter: wrong}])
            message = str(refusal.value)
            assert '\n' not in message
            assert name in message and parameter in message
    with pytest.raises(ConfigurationError, match='unknown key'):
        made([sized(name) | {'sise': 1.0}])


def test_order_in_a_scenario_does_not_matter():
    """All effects at once, forwards and backwards: the same bits but for the order of sums and filters.

    A filter's ringing ahead of the record is cut before the next one: thousandths of an LSB, which turn few codes.
    """
    effects = made([sized(name) for name in EFFECTS])
    m = measured(3)
    for a, b in zip(synthesise(m, SEED, effects), synthesise(m, SEED, effects[::-1]), strict=True):
        assert np.mean(a != b) < 0.01
        assert np.max(np.abs(a.astype(int) - b)) <= 1


def test_catalogue_has_every_effect_and_its_snippet_works():
    text = (ROOT / 'docs/effects.md').read_text(encoding='utf-8')
    sections = dict(re.findall(r'^## (\w+)\n(.*?)(?=^## |\Z)', text, re.DOTALL | re.MULTILINE))
    assert sorted(sections) == EFFECTS
    for name, section in sections.items():
        for parameter, (_, declared) in declared_parameters(Effect.registry[name]).items():
            assert re.search(rf'^\| `{parameter}` \|', section, re.MULTILINE), (name, parameter)
            assert declared.unit == '1' or declared.unit in section, (name, parameter)
        (snippet,) = re.findall(r'```yaml\n(.*?)```', section, re.DOTALL)
        assert made(yaml.safe_load(snippet)['effects'])[0].name == name


# --- ramps ---


def curvature(t, deviation, duration):
    return deviation * (1.0 - (2.0 * t / duration - 1.0) ** 2)


def ripple(t, deviation, rate, phase=0.0):
    return deviation * np.sin(2.0 * np.pi * rate * t + phase)


def settling(t, step, natural_frequency, damping):
    turning = natural_frequency * math.sqrt(1.0 - damping**2)
    return np.where(
        t < 0,
        0.0,
        step
        * np.exp(-2.0 * np.pi * damping * natural_frequency * np.maximum(t, 0.0))
        * np.cos(2.0 * np.pi * turning * t),
    )


def shape(t, coefficients, bandwidth):
    """Frequency error of a rate made of Bernstein's polynomials, to which four coefficients without knots come down."""
    x = np.asarray(t) / 1e-3
    mean = sum(coefficients) / 4
    integral = sum(
        (c / mean - 1.0) * sum(math.comb(4, j) * x**j * (1.0 - x) ** (4 - j) for j in range(i + 1, 5)) / 4
        for i, c in enumerate(coefficients)
    )
    return bandwidth * integral


UNEVEN = [1.002, 0.999, 1.0005, 1.001]
SHAPES = [
    ('sweep_curvature', {'deviation': 20e3}, lambda t: curvature(t, 20e3, 1e-3)),
    ('sweep_ripple', {'deviation': 500.0, 'rate': 9e3}, lambda t: ripple(t, 500.0, 9e3)),
    ('sweep_ripple', {'deviation': -3e3, 'rate': 700.0, 'phase': 2.2}, lambda t: ripple(t, -3e3, 700.0, 2.2)),
    ('sweep_shape', {'relative_rate': UNEVEN}, lambda t: shape(t, UNEVEN, 150e6)),
    (
        'pll_settling',
        {'step': 60e3, 'natural_frequency': 18e3, 'damping': 0.35},
        lambda t: settling(t, 60e3, 18e3, 0.35),
    ),
    (
        'pll_settling',
        {'step': -30e3, 'natural_frequency': 5e4, 'damping': 1.0},
        lambda t: settling(t, -30e3, 5e4, 1.0),
    ),
]


@pytest.mark.parametrize(('name', 'parameters', 'error'), SHAPES)
def test_chirp_phase_is_the_integral_of_the_frequency_error(name, parameters, error):
    """Against adaptive quadrature; the station's own clock runs 30 ppm fast, and so does the frequency."""
    m = measured(1, alphas=(1.0, 1.00003))
    (effect,) = made([sized(name, **parameters)])
    times = np.array([0.0, 1e-6, 33e-6, 0.5e-3, 1e-3])
    phase = effect.chirp_phase(m.stations[1], times[None])[0]
    for u, value in zip(times, phase, strict=True):
        integral, _ = integrate.quad(lambda t: 1.00003 * error(1.00003 * t), 0.0, u, epsabs=1e-12, limit=500)
        assert value == pytest.approx(2.0 * np.pi * integral, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ('name', 'parameters', 'count', 'share'),
    [
        ('sweep_curvature', {'deviation': 20e3}, 5, 1e-9),  # its rate is linear over the ramp
        ('sweep_shape', {'relative_rate': UNEVEN}, 4, 1e-9),
        ('sweep_shape', {'relative_rate': UNEVEN}, 7, 1e-9),  # the knots of four coefficients are among those of seven
        ('sweep_ripple', {'deviation': -3e3, 'rate': 1e3, 'phase': 2.2}, 12, 1e-3),  # one turn
    ],
)
def test_coefficients_imitate_what_another_effect_does_to_a_chirp(name, parameters, count, share):
    """What is left of its phase is a straight line: another start phase and another frequency."""
    m = measured(1, alphas=(1.0, 1.0))
    station = m.stations[1]
    times = np.linspace(0.0, station.sweep.ramp_duration, 400)[None]
    (effect,) = made([sized(name, **parameters)])
    phase = effect.chirp_phase(station, times)[0]
    shape_of = Effect.registry['sweep_shape']
    imitation = shape_of(relative_rate=shape_of.imitating(phase, station.sweep, count), station=station.name)

    def bend(phase):
        return np.abs(phase - np.polyval(np.polyfit(times[0], phase, 1), times[0])).max()

    assert bend(phase - imitation.chirp_phase(station, times)[0]) < share * bend(phase)


def dense_phase(station, times, error):
    """Transmit phase at `times`, in turns, by 5-point Gauss quadrature of the frequency between them; 64-bit mantissa.

    Args:
        station: its alpha counts; its ramp starts at time 0.
        times: rising [s].
        error: of the frequency in the station's own time and Hz; none is None.
    """
    x = np.longdouble
    alpha, sweep = x(station.alpha[0]), station.sweep
    nodes, weights = np.polynomial.legendre.leggauss(5)
    edges = np.concatenate([[0.0], times]).astype(x)
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    t = alpha * (middle[:, None] + half[:, None] * nodes.astype(x))
    frequency = x(sweep.start_frequency) + x(sweep.bandwidth) / x(sweep.ramp_duration) * t
    if error is not None:
        frequency = frequency + error(t.astype(float))
    return np.cumsum(alpha * np.sum(frequency * weights.astype(x), axis=1) * half)


@pytest.mark.parametrize('homodyne', [False, True])
@pytest.mark.parametrize('bandwidth', [150e6, -150e6])
@pytest.mark.parametrize(('name', 'parameters', 'error'), SHAPES)
def test_shaped_chirps_against_the_time_domain(name, parameters, error, bandwidth, homodyne):
    """Received phase within 1e-6 rad of chirps integrated step by step, mixed sample by sample.

    The shape acts at every station; the float32 samples' own rounding is 2e-7 rad of angle and as much of I and Q.
    """
    m = measured(1, 300.0, homodyne=homodyne, waveform={'iq': True, 'bandwidth': bandwidth})
    effects = made([{'effect': name, **parameters}])
    falls = name == 'sweep_shape' and bandwidth < 0.0  # its error goes with the rate
    drawn = m.rows(slice(None))
    draw_sweeps(drawn, SEED)

    def signed(t):
        return -error(t) if falls else error(t)

    for receiver, signal in enumerate(analogue(m, effects)):
        own, peer = m.stations[receiver], m.stations[-1 - receiver]
        sample = np.arange(24, 2024)
        u = np.longdouble(sample) / (np.longdouble(own.sweep.sample_rate) * np.longdouble(own.sample_clock[0]))
        between = 0.0 if homodyne else (m.start_delay[0], -m.start_delay[0])[receiver]
        v = u - np.longdouble(between) - np.longdouble(m.paths[0].delay[0])
        phases = drawn.initial_phase[:, 0]
        turns = dense_phase(own, u, signed) - dense_phase(peer, v, signed)
        turns = turns + (0.0 if homodyne else phases[receiver] - phases[1 - receiver])
        difference = np.angle(signal[0, sample]) / (2.0 * np.pi) - turns
        difference = (difference - np.rint(difference)).astype(float)
        assert np.max(np.abs(2.0 * np.pi * difference)) < 1e-6


@pytest.mark.parametrize('homodyne', [False, True])
@pytest.mark.parametrize('bandwidth', [150e6, -150e6])
def test_rate_is_that_of_another_bandwidth(bandwidth, homodyne):
    """0.4 % too slow at every station: the phases of a ramp of 0.4 % less bandwidth that starts where this one does."""
    waveform = {'iq': True, 'bandwidth': bandwidth}
    stated, slow = (
        measured(2, 300.0, homodyne=homodyne, waveform=waveform | {'bandwidth': b})
        for b in (bandwidth, 0.996 * bandwidth)
    )
    effects = made([{'effect': 'sweep_rate', 'error': -0.4}])
    for a, b in zip(analogue(stated, effects), analogue(slow), strict=True):
        assert np.max(np.abs(np.angle(a[:, BOTH_ON] * np.conj(b[:, BOTH_ON])))) < 1e-6


def test_shape_of_any_mean_is_of_mean_one():
    """Coefficients twice as large are the same ramp; fewer than a cubic's are refused."""
    m = measured(1, alphas=(1.0, 1.0))
    one, twice = made([sized('sweep_shape', relative_rate=[f * r for r in UNEVEN]) for f in (1.0, 2.0)])
    t = np.linspace(0.0, 1e-3, 50)[None]
    assert np.allclose(one.chirp_phase(m.stations[1], t), twice.chirp_phase(m.stations[1], t), rtol=1e-9, atol=1e-6)
    with pytest.raises(ConfigurationError, match='too few'):
        made([sized('sweep_shape', relative_rate=[1.0, 1.0, 1.0])])


def test_nothing_of_a_ramp_is_received_outside_of_its_window():
    """Own samples by the own clock, the other's by its clock, when its chirp arrives; inside, every bit as it was."""
    m = measured(1, alphas=(1.0, 1.0), waveform={'iq': True})
    start, end = 50.2e-6, 900.3e-6
    tau, offset = m.paths[0].delay[0], m.start_delay[0]
    for name, late in (('slave', (tau + offset, 0.0)), ('master', (0.0, tau - offset))):  # when it counts zero
        entry = {'effect': 'ramp_window', 'station': name, 'start': start, 'end': end}
        for receiver, shift in enumerate(late):
            before, after = (analogue(m, made(entries))[receiver][0] for entries in ([], [entry]))
            time = np.arange(2048) / RATE - shift
            inside = (time >= start) & (time <= end)
            assert np.array_equal(after[inside], before[inside]) and np.all(before[inside])
            assert not after[~inside].any()
    apart = [sized('ramp_window', start=0.0, end=2e-4), {'effect': 'ramp_window', 'station': 'master', 'start': 5e-4}]
    assert not any(s.any() for s in analogue(m, made(apart)))  # never both at once


def test_hum_has_a_phase_of_its_own_in_each_sweep():
    """deviation / rate (cos psi - cos(2 pi rate u + psi)) at its own station, its negative a delay later at the other.

    psi, fitted to each of 40 sweeps, is uniform: its mean phasor exceeds 0.5 by chance once in 20000 (exp(-40 / 4)).
    """
    m = measured(40, alphas=(1.0, 1.0), waveform={'iq': True})
    deviation, rate = 300.0, 7e3
    effects = made([sized('frequency_modulation', deviation=deviation, rate=rate)])
    own, heard = (
        np.unwrap(np.angle(after * np.conj(before))[:, BOTH_ON], axis=1)
        for before, after in zip(analogue(m)[::-1], analogue(m, effects)[::-1], strict=True)
    )
    turn = 2.0 * np.pi * rate * np.arange(2048)[BOTH_ON] / RATE
    basis = np.stack([np.cos(turn), np.sin(turn), np.ones_like(turn)], axis=1)
    (cosine, sine, constant), *_ = np.linalg.lstsq(basis, own.T, rcond=None)
    psi = np.arctan2(sine, -cosine)
    assert np.hypot(cosine, sine) == pytest.approx(deviation / rate, rel=1e-4)
    assert constant == pytest.approx(deviation / rate * np.cos(psi), abs=1e-5)
    assert abs(np.mean(np.exp(1j * psi))) < 0.5
    late = turn - 2.0 * np.pi * rate * (m.paths[0].delay + m.start_delay)[:, None]
    expected = deviation / rate * (np.cos(late + psi[:, None]) - np.cos(psi[:, None]))
    assert np.max(np.abs(heard - expected)) < 1e-5


def test_ripple_in_closed_form():
    """(deviation / rate) (1 - cos 2 pi rate t), and nothing at the start whatever its phase."""
    m = measured(1, alphas=(1.0, 1.0))
    (effect,) = made([sized('sweep_ripple', deviation=500.0, rate=9000.0)])
    t = np.linspace(0.0, 1e-3, 500)[None]
    assert np.allclose(
        effect.chirp_phase(m.stations[1], t), 500 / 9000 * (1 - np.cos(2 * np.pi * 9000 * t)), atol=1e-12
    )
    (shifted,) = made([sized('sweep_ripple', deviation=500.0, rate=9000.0, phase=1.0)])
    assert shifted.chirp_phase(m.stations[1], t)[0, 0] == 0.0


# --- paths and motion ---


def path_delay(m, effects, path=0):
    """Delay that effects add to the direct path, or that another path has beyond it [n] [s]."""
    whole = prepared(m, effects)
    return whole.paths[path].delay - (m.paths[0].delay if path == 0 else whole.paths[0].delay)


def test_refractivity_is_millimetres_per_kilometre():
    """One N-unit more, one millimetre of air per kilometre more, as if the weather had been that."""
    m = measured(2, 1000.0, waveform={'iq': True})
    effects = made([sized('air_refractivity', offset=10.0)])
    assert path_delay(m, effects) * C == pytest.approx(10e-3, rel=1e-9)
    assert prepared(m, effects).refractive_index == pytest.approx(m.refractive_index + 10e-6, rel=1e-12)
    assert combined(m, effects) == pytest.approx(10e-3 / m.refractive_index, rel=1e-4)
    driving = measured(3, 500.0, speed=10.0, start=500)
    rate = prepared(driving, effects).paths[0].rate - driving.paths[0].rate
    assert rate * C == pytest.approx(driving.velocity * 10e-6, rel=1e-6)


def test_ground_reflection_is_the_longer_side():
    """Length sqrt(R^2 + 4 h1 h2) of air, sign reversed, and moving as that length does."""
    effects = made([sized('ground_reflection', height_product=60.0, coefficient=0.3)])
    for distance in (15.0, 100.0, 1000.0):
        m = measured(1, distance)
        excess = math.sqrt(distance**2 + 240.0) - distance
        assert path_delay(m, effects, 1) == pytest.approx(excess * m.refractive_index / C, rel=1e-9)
        assert prepared(m, effects).paths[1].amplitude == pytest.approx(-0.3)
    m = measured(60, 40.0, speed=3.0, start=20)  # speeds up, then drives evenly
    whole = prepared(m, effects)
    path = whole.paths[1]
    for t in (0.5e-3, 10e-3):
        r = m.range + m.velocity * t + 0.5 * m.paths[0].acceleration * C / m.refractive_index * t * t
        hardware = m.paths[0].delay - m.range * m.refractive_index / C
        expected = hardware + np.sqrt(r * r + 240.0) * m.refractive_index / C
        length = path.delay + path.rate * t + 0.5 * path.acceleration * t * t
        assert np.max(np.abs(length - expected)) < 1e-2 * t**3 / C + 1e-21  # what the parabola leaves out


def test_two_paths_interfere():
    """What the second path adds is -coefficient times the signal over the longer path alone."""
    m = measured(2, waveform={'iq': True})
    effects = made([sized('ground_reflection', height_product=60.0, coefficient=0.3)])
    longer = m.rows(slice(None))
    longer.paths[0].delay = prepared(m, effects).paths[1].delay
    for nominal, both, alone in zip(analogue(m), analogue(m, effects), analogue(longer), strict=True):
        amplitude = np.abs(nominal[0, 1000])
        assert np.max(np.abs((both - nominal + 0.3 * alone)[:, BOTH_ON])) < 1e-6 * amplitude


@pytest.mark.parametrize('homodyne', [False, True])
def test_phase_of_an_echo_is_that_of_a_longer_way(homodyne):
    """An echo of excess L and phase 2 pi f_c dL / c is one of L + dL at both stations, but for the delay of dL.

    The frequency that is heard lies within 75 MHz of the centre f_c: a fifth of a wave is 1.3 % of 2 pi / 5 off there.
    """
    m = measured(2, waveform={'iq': True}, homodyne=homodyne)
    wave = C / m.refractive_index[0] / CENTER
    echo = {'effect': 'echo', 'excess_range': 7.5, 'relative_power': -20.0}
    longer = made([echo | {'excess_range': 7.5 + 0.2 * wave}])
    turned = made([echo | {'phase': 0.4 * math.pi}])
    opposite = made([echo | {'phase': -0.4 * math.pi}])
    for nominal, way, phase, wrong in zip(*(analogue(m, e) for e in ((), longer, turned, opposite)), strict=True):
        way, phase, wrong = (s[:, BOTH_ON] - nominal[:, BOTH_ON] for s in (way, phase, wrong))
        angle = np.angle(way * np.conj(phase))
        assert np.max(np.abs(angle)) < 1.1 * 0.4 * math.pi * 75e6 / CENTER
        assert np.max(np.abs(np.mean(angle, axis=1))) < 2e-3  # at the centre nothing is left
        assert np.min(np.abs(np.angle(way * np.conj(wrong)))) > 2.0


def test_motion_shifts_the_combined_beat_frequency():
    """f_c / k = 38.67 mm of range per m/s, and the way until the window's centre, 0.50 mm."""
    m = measured(2, waveform={'iq': True}, alphas=(1.0, 1.0))
    for velocity in (-1.0, 0.25):
        effects = made([sized('target_motion', velocity=velocity)])
        center = np.mean(np.arange(2048)[BOTH_ON]) / RATE + m.start_delay[0] / 2
        expected = velocity * (CENTER / CHIRP + center)
        assert CENTER / CHIRP == pytest.approx(38.67e-3, abs=5e-6)
        assert combined(m, effects) == pytest.approx(expected, abs=3e-6)
        assert path_delay(m, effects) == pytest.approx(0.0, abs=1e-20)


def test_motion_of_each_distance():
    """One velocity for each of a standing crane's distances; too few are refused."""
    entry = sized('target_motion', velocity=[0.5, -0.2])
    trajectory = {'standing': {'distances': [50, 100, 150], 'sweeps': 2}}
    timeline = Timeline(scene(trajectory))
    m = timeline.measurements(timeline.slots(4), 0)
    assert prepared(m, made([entry])).velocity == pytest.approx([0.5, 0.5, -0.2, -0.2])
    with pytest.raises(ConfigurationError, match='too few'):
        prepared(timeline.measurements(timeline.slots(6), 0), made([entry]))
    with pytest.raises(ConfigurationError, match='empty'):
        made([sized('target_motion') | {'velocity': []}])


def test_sway_is_a_sine_in_time():
    """Place, velocity and acceleration at each sweep are those of the sine; within it too, to the third order."""
    m = measured(5, speed=2.0)
    for phase in (0.0, 1.0):
        effects = made([sized('sway', amplitude=0.02, frequency=3.0, phase=phase)])
        path, direct = prepared(m, effects).paths[0], m.paths[0]
        for t in (0.0, 0.5e-3, 1e-3):
            added = path.delay - direct.delay + (path.rate - direct.rate) * t
            added = added + (path.acceleration - direct.acceleration) * t * t / 2
            place = 0.02 * np.sin(2 * np.pi * 3.0 * (m.time + t) + phase)
            assert added * C / m.refractive_index == pytest.approx(
                place, abs=0.02 * (2 * np.pi * 3.0 * t) ** 3 / 6 + 1e-12
            )


def test_slant_is_longer_than_its_horizontal():
    """sqrt(R^2 + h^2) of air, at any sign of h; spread over the longer way the power is less."""
    for distance in (0.0, 20.0, 200.0):
        m = measured(1, distance)
        for height in (7.0, -7.0):
            effects = made([sized('slant_geometry', height_difference=height)])
            slant = math.hypot(distance, height)
            assert path_delay(m, effects) == pytest.approx((slant - distance) * m.refractive_index / C, rel=1e-9)
            if distance:
                loss = m.stations[0].received_power - prepared(m, effects).stations[0].received_power
                assert loss == pytest.approx(20.0 * math.log10(slant / distance))
    driving = measured(1, 30.0, speed=2.0, start=80)
    effects = made([sized('slant_geometry', height_difference=20.0)])
    cosine = driving.range / np.hypot(driving.range, 20.0)
    assert prepared(driving, effects).paths[0].rate == pytest.approx(driving.paths[0].rate * cosine)


# --- clocks and noise ---


def test_reference_drifts_and_warms_up():
    """ppm per hour from the start on; a warm-up falls to 1/e of itself in its time constant; the ADC goes along."""
    m = measured(13)  # 0, 50, ... 600 s
    before = m.stations[1].alpha
    steady = prepared(m, made([sized('reference_clock_drift', rate=-12.0)])).stations[1]
    assert steady.alpha - before == pytest.approx(-12e-6 * m.time / 3600.0, abs=1e-15)
    assert steady.sample_clock / m.stations[1].sample_clock == pytest.approx(steady.alpha / before, rel=1e-13)
    warming = prepared(m, made([sized('reference_clock_drift', warmup=2.0, time_constant=300.0)])).stations[1]
    assert (warming.alpha - before)[[0, 6, 12]] == pytest.approx([2e-6, 2e-6 / math.e, 2e-6 / math.e**2], rel=1e-9)


def test_phase_noise_takes_level_and_corner():
    """10 dB more of the same noise turns each sample's phase by sqrt(10) as much; left out, level and corner stay."""
    m = measured(3, waveform={'iq': True})
    for station in m.stations:
        station.noise_density[:] = -400.0
    errors = []
    for effects in ([], made([{'effect': 'phase_noise', 'level': -80.0}])):
        noisy = synthesise(m, SEED, effects, quantised=False)[0]
        clean = analogue(m)[0][:, BOTH_ON]
        errors.append(np.angle((noisy[..., 0] + 1j * noisy[..., 1])[:, BOTH_ON] * np.conj(clean)))
    assert np.allclose(errors[1], math.sqrt(10.0) * errors[0], atol=3e-6)
    changed = prepared(m, made([sized('phase_noise', corner=5e4)])).stations
    assert (changed[1].phase_noise.level, changed[1].phase_noise.corner) == (-90.0, 5e4)
    assert changed[0].phase_noise == m.stations[0].phase_noise
    for station in m.stations:
        station.phase_noise = None
    assert prepared(m, made([sized('phase_noise', level=-85.0, corner=1e5)])).stations[1].phase_noise.level == -85.0
    with pytest.raises(ConfigurationError, match='slave'):
        prepared(m, made([sized('phase_noise', level=-85.0)]))


def test_bursts_are_as_frequent_long_and_strong_as_declared():
    """1500 sweeps at probability 0.3: 1.2 % standard deviation, asserted to 6 % (5 sigma: false failure below 1e-6).

    Samples of noise in the bursts: 45000 and more, their power to 0.7 %, asserted to 4 %. Both stations' differ.
    """
    m = measured(1500)
    level, duration = -30.0, 5e-5
    effects = made([{'effect': 'interference_burst', 'probability': 0.3, 'level': level, 'duration': duration}])
    added = [b - a for a, b in zip(analogue(m), analogue(m, effects), strict=True)]
    for signal in added:
        hit = np.any(signal, axis=1)
        assert abs(np.mean(hit) - 0.3) < 0.06
        span = [np.ptp(np.flatnonzero(row)) + 1 for row in signal[hit]]
        assert max(span) <= math.ceil(duration * RATE) + 1
        assert np.median(span) == pytest.approx(duration * RATE, abs=1.0)
        power = np.sum(signal**2) / np.sum(span)
        assert power == pytest.approx((8192.0 * 10 ** (level / 20)) ** 2 / 2, rel=0.04)
    assert np.any(np.any(added[0], axis=1) != np.any(added[1], axis=1))


# --- receivers ---


def test_received_signal_falls_over_the_ramp():
    """The line's logarithmic amplitude has the slope over the station's own ramp, with an echo too; noise has none."""
    m = measured(2, waveform={'iq': True}, alphas=(1.0, 1.0))
    entry = sized('amplitude_slope', slope=3.0)
    with_echo = sized('echo', excess_range=7.5, relative_power=-20.0)
    for others in ([], [with_echo]):
        before, after = (analogue(m, made(entries))[1][:, BOTH_ON] for entries in (others, [*others, entry]))
        time = np.arange(2048)[BOTH_ON] / RATE
        fitted = np.polyfit(time / 1e-3, 20.0 * np.log10(np.abs(after / before)).T, 1)
        assert fitted[0] == pytest.approx(-3.0, abs=1e-4)
        assert fitted[1] == pytest.approx(0.0, abs=1e-4)
    for station in m.stations:
        station.received_power[:] = -300.0
    assert np.array_equal(synthesise(m, SEED)[1], synthesise(m, SEED, made([entry]))[1])


def received(entry, signal, iq=False):
    """A signal [LSB] after the receive hook of an effect at the slave."""
    m = measured(1, waveform={'iq': iq}, alphas=(1.0, 1.0))
    (effect,) = made([entry])
    signal = np.array(signal, np.float32)[None]
    effect.receive(signal, m.stations[1], m, lambda: [np.random.default_rng(1)])
    return signal[0].astype(float)


def tone(amplitude, cycles, count=2048):
    """A cosine with a whole number of cycles in the record."""
    return amplitude * np.cos(2.0 * np.pi * cycles * np.arange(count) / count)


def line(signal, cycles):
    """Complex amplitude of a line with that many cycles in the record."""
    return 2.0 * np.mean(signal * np.exp(-2j * np.pi * cycles * np.arange(len(signal)) / len(signal)))


def test_compression_makes_a_third_harmonic():
    """x - c x^3 of A cos: A - 3/4 c A^3 at f and -1/4 c A^3 at 3f, also where 3f aliases."""
    for cycles, third in ((100, 300), (500, 2048 - 1500)):
        for level in (0.0, -6.0):
            a = 10 ** (level / 20)
            signal = received(sized('compression', third_order=0.2), tone(8192.0 * a, cycles)) / 8192.0
            assert line(signal, cycles) == pytest.approx(a - 0.75 * 0.2 * a**3, abs=1e-6)
            assert line(signal, third) == pytest.approx(-0.25 * 0.2 * a**3, abs=1e-6)


def test_second_order_makes_a_second_harmonic_and_a_mean():
    """x + c x^2 of A cos: c A^2 / 2 at 2f and as the mean, also where 2f aliases; -20 log10(c A / 2) below the line."""
    for cycles, second in ((100, 200), (700, 2048 - 1400)):
        for a in (1.0, 0.5):
            signal = received(sized('second_order_distortion', second_order=-0.2), tone(8192.0 * a, cycles)) / 8192.0
            assert line(signal, cycles) == pytest.approx(a, abs=1e-6)
            assert line(signal, second) == pytest.approx(-0.5 * 0.2 * a**2, abs=1e-6)
            assert np.mean(signal) == pytest.approx(-0.5 * 0.2 * a**2, abs=1e-6)
            below = 20.0 * math.log10(abs(line(signal, cycles)) / abs(line(signal, second)))
            assert below == pytest.approx(-20.0 * math.log10(0.2 * a / 2.0), abs=1e-3)


def test_leakage_is_a_line_at_its_delay():
    """A constant without delay; with one a line at k delay, its phase f_0 delay less half of what the chirp adds."""
    level = 8192.0 * 10 ** (-40.0 / 20)
    constant = received(sized('tx_leakage', level=-40.0), np.zeros(2048))
    assert constant[:2048] == pytest.approx(level)
    for delay in (40e-9, 700e-9):
        added = received(sized('tx_leakage', level=-40.0, delay=1e9 * delay), np.zeros((2048, 2)), iq=True)
        wave = added[:, 0] + 1j * added[:, 1]
        first = math.ceil(delay * RATE)  # before, the leaked chirp has not arrived
        assert not wave[:first].any()
        turns = np.arange(first, 2048) / RATE * CHIRP * delay + 5.725e9 * delay - 0.5 * CHIRP * delay**2
        assert np.max(np.abs(wave[first:] - level * np.exp(2j * np.pi * turns))) < 1e-4
        real = received(sized('tx_leakage', level=-40.0, delay=1e9 * delay), np.zeros(2048))
        assert np.array_equal(real, added[:, 0])


def test_clipping_is_a_limiter():
    """A sine of twice the limit keeps the fundamental of a clipped sine; one below the limit is not touched."""
    limit = 8192.0 * 10 ** (-33.0 / 20)
    for ratio in (2.0, 1.2):
        signal = received(sized('clipping', level=-33.0), tone(ratio * limit, 101))
        assert np.max(np.abs(signal)) == pytest.approx(limit, rel=1e-6)
        share = 2.0 / np.pi * (math.asin(1 / ratio) + math.sqrt(1 - 1 / ratio**2) / ratio)
        assert abs(line(signal, 101)) == pytest.approx(ratio * limit * share, rel=1e-4)
    below = tone(0.99 * limit, 101).astype(np.float32)
    assert np.array_equal(received(sized('clipping', level=-33.0), below), below.astype(float))


def test_filter_halves_the_power_at_its_pole():
    """1/sqrt(2) and -45 degrees at the pole, 1 / (1 + j f / pole) at all frequencies, mirrored in a quadrature IF."""
    middle = slice(500, 1500)  # the record's ends ring
    n = np.arange(2048)
    for pole, frequency in ((3e5, 3e5), (3e5, 1e5), (1.5e6, 3e5), (3e5, 8e5)):
        wave = 2.0 * np.pi * frequency / RATE * n
        expected = 1.0 / (1.0 + 1j * frequency / pole)
        if pole == frequency:
            assert abs(expected) == pytest.approx(math.sqrt(0.5)) and np.angle(expected) == pytest.approx(-np.pi / 4)
        kernel = np.hanning(1000) * np.exp(-1j * wave[middle])
        real = received(sized('if_filter', pole=pole), 1000.0 * np.cos(wave))
        measured_ = np.sum(real[middle] * kernel) / np.sum(np.cos(wave[middle]) * kernel) / 1000.0
        assert measured_ == pytest.approx(expected, abs=2e-5)
        for sign in (1.0, -1.0):
            stacked = 1000.0 * np.stack([np.cos(wave), sign * np.sin(wave)], axis=-1)
            both = received(sized('if_filter', pole=pole), stacked, iq=True)
            both = both[:, 0] + 1j * both[:, 1]
            kernel = np.hanning(1000) * np.exp(-1j * sign * wave[middle])
            filtered = np.sum(both[middle] * kernel) / np.sum(np.hanning(1000)) / 1000.0
            assert filtered == pytest.approx(expected if sign > 0 else np.conj(expected), abs=2e-5)


def test_coupling_passes_a_line_and_forgets_a_constant():
    """j f / (pole + j f) of a line; a step decays to 1/e in 1 / (2 pi pole), also over many times the record.

    The step is that of a record that begins: band-limited, it counts from half a sample before its first sample, and
    the cut at Nyquist rings by pole / (f_s / 2) / (pi n) n samples from it.
    """
    middle, n = slice(500, 1500), np.arange(2048)
    for pole, frequency in ((3e5, 3e5), (3e4, 1e5), (1e3, 8e5), (30.0, 3e5)):
        wave = 2.0 * np.pi * frequency / RATE * n
        expected = 1j * frequency / (pole + 1j * frequency)
        kernel = np.hanning(1000) * np.exp(-1j * wave[middle])
        passed = received(sized('ac_coupling', pole=pole), 1000.0 * np.cos(wave))
        found = np.sum(passed[middle] * kernel) / np.sum(np.cos(wave[middle]) * kernel) / 1000.0
        assert found == pytest.approx(expected, abs=5e-5)
        step = received(sized('ac_coupling', pole=pole), np.full(2048, 1000.0))
        decay = 1000.0 * np.exp(-2.0 * np.pi * pole * (n + 0.5) / RATE)
        ringing = 1000.0 * pole / (RATE / 2) / np.pi / np.minimum(n + 1.0, 2048.0 - n)
        assert np.all(np.abs(step - decay)[20:-20] < ringing[20:-20] + 0.01)


def test_settling_is_an_exponential():
    """Its level as the sweep starts, 1/e of it a time constant later, in I alone."""
    added = received(sized('receiver_settling', level=-40.0, time_constant=2e-4), np.zeros(2048))
    assert added == pytest.approx(81.92 * np.exp(-np.arange(2048) / RATE / 2e-4), rel=1e-5)
    both = received(sized('receiver_settling', level=-40.0, time_constant=2e-4), np.zeros((2048, 2)), iq=True)
    assert np.array_equal(both[:, 0], added) and not both[:, 1].any()


def test_imbalance_makes_an_image():
    """Q is cos(D - 90 deg - phase), gain times: (1 + g exp(-j phase)) / 2 at f, (1 - g exp(j phase)) / 2 at -f."""
    turn = 2.0 * np.pi * 100.0 * np.arange(2048) / 2048
    stacked = 1000.0 * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    for gain, phase in ((0.5, 2.0), (-1.0, 0.0), (0.0, -5.0)):
        found = received(sized('iq_imbalance', gain=gain, phase=phase), stacked, iq=True)
        g, angle = 10.0 ** (gain / 20.0), math.radians(phase)
        assert found[:, 0] == pytest.approx(stacked[:, 0], abs=1e-4)
        assert found[:, 1] == pytest.approx(1000.0 * g * np.cos(turn - math.pi / 2 - angle), abs=1e-3)
        spectrum = np.fft.fft(found[:, 0] + 1j * found[:, 1]) / 2048 / 1000.0
        assert spectrum[100] == pytest.approx(0.5 * (1.0 + g * np.exp(-1j * angle)), abs=1e-6)
        assert spectrum[-100] == pytest.approx(0.5 * (1.0 - g * np.exp(1j * angle)), abs=1e-6)
    real = tone(1000.0, 100).astype(np.float32)
    assert np.array_equal(received(sized('iq_imbalance', gain=1.0, phase=5.0), real), real)


def test_filter_acts_on_noise_too():
    """White noise leaves with the mean of |H|^2; 300 sweeps of 1900 samples, correlated over 3: 0.4 %; within 3 %."""
    m = measured(300)
    for station in m.stations:
        station.received_power[:] = -300.0
    noise = synthesise(m, SEED, quantised=False)[1]
    filtered = synthesise(m, SEED, made([sized('if_filter', pole=2e5)]), quantised=False)[1]
    nyquist = RATE / 2.0
    expected = 2e5 / nyquist * math.atan(nyquist / 2e5)
    assert np.var(filtered[:, 100:-48]) / np.var(noise[:, 100:-48]) == pytest.approx(expected, rel=0.03)
    behind = synthesise(m, SEED, made([sized('if_filter', pole=2e5, noise_behind=True)]), quantised=False)[1]
    assert np.allclose(behind, noise, atol=1e-6)
    m = measured(2)  # the signal is filtered all the same, and an amplifier sees both
    for station in m.stations:
        station.phase_noise = None
    entries = [sized('if_filter', pole=2e5), sized('compression', third_order=50.0)]
    behind = [entries[0] | {'noise_behind': True}, entries[1]]
    assert np.array_equal(analogue(m, made(entries))[1], analogue(m, made(behind))[1])
    signal = analogue(m, made(entries[:1]))[1] + (synthesise(m, SEED, quantised=False)[1] - analogue(m)[1])
    whole = synthesise(m, SEED, made(behind), quantised=False)[1]
    assert np.max(np.abs(whole - signal * (1.0 - 50.0 * (signal / 8192.0) ** 2))) < 1e-3


def test_filter_lies_before_amplifier_and_adc():
    """Whatever the order in the list: filtered, compressed, clipped."""
    m = measured(2)
    entries = [sized('clipping', level=-48.0), sized('compression', third_order=1.0), sized('if_filter', pole=3e5)]
    signal = synthesise(m, SEED, noise=False, quantised=False)[1]
    for effect in made(entries[::-1]):
        effect.receive(signal, m.stations[1], m, None)
    assert np.array_equal(signal, synthesise(m, SEED, made(entries), noise=False, quantised=False)[1])


# --- reference ---


def references(effects, trajectory):
    """(time [s], reading [m], true distance [m]) of all reference readings of a short scenario."""
    scenario = scene(trajectory, effects=effects)
    timeline = Timeline(scenario)
    slots = timeline.slots(400)
    readings = [e.content.range for e in timeline.render(slots) if e.topic == '/reference/range']
    return slots.time, np.array(readings), slots.distance


def test_reference_shows_where_the_crane_was():
    """R(t - lag): v lag too little at even speed, nothing while it stands, also before the start."""
    drive = {'drive': {'waypoints': [50, 80], 'speed': 2.0, 'acceleration': 1.0, 'dwell': 1.0}}
    time, readings, distance = references([{'effect': 'reference_lag', 'lag': 0.3}], drive)
    even = (time > 3.3) & (time < 7.0)  # after a second's dwell and two seconds' speeding up
    assert even.sum() > 100
    assert distance[even] - readings[even] == pytest.approx(2.0 * 0.3)
    assert readings[time < 1.0] == pytest.approx(50.0)
    interpolated = np.interp(time[20:] - 0.3, time, distance)
    assert readings[20:] == pytest.approx(interpolated, abs=1e-4)  # acceleration x interval^2 / 8
    _, readings, distance = references(
        [{'effect': 'reference_lag', 'lag': 0.3}], {'standing': {'distances': [50, 80], 'sweeps': 20}}
    )
    assert np.array_equal(readings, distance)


def test_reference_is_offset_and_scaled():
    """Errors of the instrument: metres, parts of the distance, and both."""
    standing = {'standing': {'distances': [50, 1000], 'sweeps': 2}}
    offset, scale = {'effect': 'reference_offset', 'offset': -0.02}, {'effect': 'reference_scale', 'scale': 30.0}
    _, readings, distance = references([offset], standing)
    assert readings - distance == pytest.approx(-0.02)
    _, readings, distance = references([offset, scale], standing)
    assert readings - distance == pytest.approx(-0.02 + 30e-6 * distance)


# --- recordings made by another hand ---


def shape_of(phase):
    """Phase over the sweep without its parabola, weighted by a Hann window [..., samples]."""
    window = np.hanning(phase.shape[-1])
    basis = np.vander(np.linspace(-1.0, 1.0, len(window)), 3)
    coefficients, *_ = np.linalg.lstsq(basis * window[:, None], (phase * window).T, rcond=None)
    return (phase - (basis @ coefficients).T) * np.sqrt(window)


@pytest.mark.parametrize(
    ('recording', 'entries'),
    [
        (2, [sized('sweep_ripple', deviation=500.0, rate=9000.0, phase=p) for p in (0.0, math.pi / 2)]),
        (6, [sized('pll_settling', step=60e3, natural_frequency=18e3, damping=0.35)]),
    ],
)
def test_ramp_shapes_recorded_by_another_hand(recording, entries):
    """The IF phase's shape in a recording is that of the effect that the recording conceals, times one.

    24 sweeps at each of four distances, both stations; a shape is found to 1 %, mostly by how the analytic signal
    of a real record bends at its ends; within 4 %. The ripple's phase is unknown: two quadratures.
    """
    bag = pytest.importorskip('drfmcw_ros.bag.files')
    station = {2: 'master', 6: 'slave'}[recording]
    latest, sweeps = {}, {}
    with bag.BagReader(DATA / f'recording_{recording}') as reader:
        for topic, _, message in reader.messages():
            if topic.endswith('if_samples') and latest['/reference/range'].range < 200.0:
                place = 25 * round(latest['/reference/range'].range / 25)  # near enough: the ramps differ by ns
                sweeps.setdefault((message.station, place), []).append(message.samples)
            latest[topic] = message
    alphas = tuple(latest[f'/{name}/calibration'].alpha for name in ('master', 'slave'))
    rows = slice(40, 2000)
    found = []
    for (receiver, place), recorded in sweeps.items():
        if len(recorded) < 20:
            continue
        number = ('master', 'slave').index(receiver)
        m = measured(1, float(place), alphas=alphas, waveform={'iq': True})
        nominal = analogue(m)[number][0]
        sign = np.sign(np.angle(nominal[1001] / nominal[1000]))  # a real IF shows the positive line
        changed = [analogue(m, made([e | {'station': station}]))[number][0] for e in entries]
        templates = [shape_of(sign * np.unwrap(np.angle(c * np.conj(nominal))[rows])) for c in changed]
        phase = np.unwrap(np.angle(hilbert(np.array(recorded, float), axis=1)), axis=1)[:, rows]
        weights, *_ = np.linalg.lstsq(np.array(templates).T, shape_of(phase).mean(axis=0), rcond=None)
        found.append(weights)
    assert len(found) >= 4
    size = np.linalg.norm(found, axis=1) if len(entries) > 1 else np.array(found)[:, 0]
    assert np.mean(size) == pytest.approx(1.0, abs=0.04)
