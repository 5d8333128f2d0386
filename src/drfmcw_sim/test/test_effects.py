"""One contract for every effect of the registry: what it declares, changes, and leaves alone."""

import dataclasses
import inspect
import itertools
import math
import re

import numpy as np
import pytest
import yaml
from checkout import ROOT
from effect_scenes import SEED, analogue, made, measured, observed, reading, sized
from scenes import scene

from drfmcw_physics.settings import ConfigurationError, declared_parameters
from drfmcw_sim.effects import Effect, Of
from drfmcw_sim.synthesis.signal_model import synthesise

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


def flags(name):
    """Names of the parameters of an effect that are true or false."""
    return {f.name for f in dataclasses.fields(Effect.registry[name]) if f.type in (bool, 'bool')}


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
