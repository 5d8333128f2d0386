"""Effects of the receiver and its ramp are found in a small recording, by name, station and size."""

import json

import pytest
from scenes import record, scene

from drfmcw_diagnosis.engine import diagnose
from drfmcw_sim.effects import Effect

STANDING = {'distances': [120.0, 210.0, 320.0], 'sweeps': 12}
OTHERS = {'receiver_settling': {'level': -55.0}}


def others_than(*wanted):
    """Return all effects but some, so that a search tries these alone: one of all effects takes a minute."""
    return set(Effect.registry) - set(wanted)


@pytest.mark.parametrize(
    ('effect', 'station', 'parameter', 'true'),
    [
        ('amplitude_slope', 'slave', 'slope', 0.4),
        ('amplitude_slope', '', 'slope', 0.6),
        ('second_order_distortion', 'slave', 'second_order', 0.5),
        ('ac_coupling', 'slave', 'pole', 30e3),
        ('sweep_rate', 'slave', 'error', 1e-4),
        ('receiver_settling', 'master', 'time_constant', 1.5e-4),
        ('ramp_window', 'master', 'start', 8e-6),
        ('ramp_window', 'master', 'start', 3.5e-6),
        ('ramp_window', 'master', 'end', 0.96e-3),
    ],
)
def test_a_concealed_effect_is_found(tmp_path, effect, station, parameter, true):
    """Or listed. Its size lies within 4 standard deviations; the recording is fixed, so nothing is by chance."""
    concealed = {'effect': effect, 'station': station, parameter: true} | OTHERS.get(effect, {})
    scenario = scene({'standing': STANDING}, effects=[concealed], reference={'range_std': 0.005}, seed=12)
    found = diagnose(record(scenario, tmp_path / 'r'))
    assert found.verdict in ('explained', 'ambiguous')
    single = [e.effects[0] for e in (found.explanation, *found.alternatives) if len(e.effects) == 1]
    (finding,) = (one for one in single if (one.effect, one.station or '') == (effect, station))
    value = finding.parameters[parameter]
    assert abs(value.value - true) < 4.0 * value.std


def test_a_ramp_bent_over_the_band_is_one_effect(tmp_path):
    """Several ripples and a curvature would fit it, too. The coefficients are known up to a common factor.

    Those found lie within 5 standard deviations; the recording is fixed, so nothing is by chance.
    """
    true = [1.00004, 1.0, 0.99998, 1.00001, 1.00003]
    concealed = {'effect': 'sweep_shape', 'station': 'slave', 'relative_rate': true}
    scenario = scene({'standing': STANDING}, effects=[concealed], reference={'range_std': 0.005})
    bending = 'sweep_shape', 'sweep_ripple', 'sweep_curvature', 'sweep_rate', 'pll_settling'
    found = diagnose(record(scenario, tmp_path / 'r'), without=others_than(*bending))
    assert found.verdict == 'explained'
    (finding,) = found.explanation.effects
    assert (finding.effect, finding.station) == ('sweep_shape', 'slave')
    values = [finding.parameters[f'relative_rate[{i}]'] for i in range(len(true))]
    apart = [v.value - t for v, t in zip(values, true, strict=True)]
    assert max(apart) - min(apart) < 5.0 * max(v.std for v in values) < 1e-5


def test_a_slow_modulation_shows_beside_a_distortion(tmp_path):
    """The recording is fixed, so nothing is by chance; which synthesiser hums, the data need not show."""
    effects = [
        {'effect': 'second_order_distortion', 'station': 'slave', 'second_order': 0.5},
        {'effect': 'frequency_modulation', 'station': 'slave', 'deviation': 400.0, 'rate': 1700.0},
    ]
    scenario = scene({'standing': STANDING}, effects=effects, reference={'range_std': 0.005}, seed=12)
    rivals = 'phase_noise', 'compression', 'clipping', 'spur', 'sweep_ripple'
    searched = *rivals, *(effect['effect'] for effect in effects)
    found = diagnose(record(scenario, tmp_path / 'r'), without=others_than(*searched))
    named = {finding.effect: finding for finding in found.explanation.effects}
    assert set(named) == {'second_order_distortion', 'frequency_modulation'}
    hum = named['frequency_modulation'].parameters
    assert abs(hum['rate'].value - 1700.0) < 4.0 * hum['rate'].std
    assert abs(hum['deviation'].value - 400.0) < 4.0 * hum['deviation'].std


def test_two_processes_find_the_same_as_one(tmp_path):
    """To the last bit, where a distortion is simulated with other effects."""
    effects = [
        {'effect': 'second_order_distortion', 'station': 'slave', 'second_order': 0.5},
        {'effect': 'sweep_rate', 'station': 'master', 'error': 1e-4},
    ]
    path = record(scene({'standing': STANDING}, effects=effects, reference={'range_std': 0.005}), tmp_path / 'r')
    searched = others_than('second_order_distortion', 'sweep_rate', 'spur')
    alone, both = (diagnose(path, without=searched, jobs=jobs).as_object() for jobs in (1, 2))
    assert alone['effects'] and json.dumps(alone) == json.dumps(both)


def test_a_clock_beside_a_limiter_may_be_either_stations(tmp_path):
    """Only the difference of the clocks shows. The limiter acts on the sum, so neither clock can simply be added to it.

    The recording is fixed, so nothing is by chance.
    """
    effects = [
        {'effect': 'clipping', 'station': 'master', 'level': -37.0},
        {'effect': 'reference_clock_drift', 'station': 'master', 'warmup': -0.8, 'time_constant': 8.0},
    ]
    scenario = scene({'standing': STANDING}, effects=effects, reference={'range_std': 0.005}, seed=12)
    searched = 'clipping', 'reference_clock_drift', 'reference_clock_offset', 'sample_clock_offset'
    found = diagnose(record(scenario, tmp_path / 'r'), without=others_than(*searched))
    assert found.verdict == 'ambiguous'
    named = [
        {(e.effect, e.station) for e in explanation.effects} for explanation in (found.explanation, *found.alternatives)
    ]
    for station in ('master', 'slave'):
        assert {('clipping', 'master'), ('reference_clock_drift', station)} in named
