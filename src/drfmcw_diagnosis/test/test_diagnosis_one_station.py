"""Diagnosis of one station's samples: its peer's are missing, or it hears itself, in real or in I/Q samples."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from checkout import DATA
from scenes import STANDARD_STATION, mapping, record, without

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.diagnose import main
from drfmcw_diagnosis.engine import diagnose
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_node.estimators.blocks import SingleEstimator
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.estimators.maximum_likelihood import MaximumLikelihoodEstimator
from drfmcw_physics.settings import ConfigurationError
from drfmcw_sim.effects import Effect
from drfmcw_sim.scenario import scenario_from_mapping

IQ = {'waveform': {'iq': True}}
IN_THE_IF = (
    'ramp',
    'flutter',
    'lines',
    'mean',
    'baseline',
    'transient',
    'onset',
    'ends',
    'harmonic',
    'burst',
)  # what samples alone show


def recorded(path, **sections):
    """A recording of master and slave, 5 distances x 12 sweeps."""
    standing = {'standing': {'distances': [40.0, 120.0, 300.0, 600.0, 900.0], 'sweeps': 12, 'move_time': 5.0}}
    sections = {'reference': {'range_std': 0.005}} | sections
    return record(scenario_from_mapping(mapping(standing, **sections), 'test'), path)


def own_echo(path, distances=(20.0, 45.0, 90.0, 140.0, 200.0), sweeps=12, station=None, **sections):
    """A recording of a station that hears itself."""
    scenario = {
        'stations': {'radar': STANDARD_STATION | {'delay': 12e-9} | (station or {})},
        'pairs': [{'first': 'radar', 'second': 'radar', 'standing': {'distances': list(distances), 'sweeps': sweeps}}],
        'reference': {'range_std': 0.005},
        'seed': 5,
    }
    return record(scenario_from_mapping(scenario | sections, 'test'), path)


def alone(data, station):
    """A dataset of two stations of which one's samples are missing."""
    return dataclasses.replace(data, samples=tuple(x if i == station else None for i, x in enumerate(data.samples)))


def chi_squares(comparison):
    """Mean squared whitened residual of each kind of number that is compared, and how many there are."""
    found = {}
    for kind in dict.fromkeys(comparison.entries.kind):
        z = comparison.residual[comparison.entries.where(kind=kind)]
        if np.any(z):
            found[str(kind)] = float(np.mean(z[z != 0.0] ** 2)), int(np.count_nonzero(z))
    return found


def assert_noise(comparison, *kinds):
    """Chi-squares lie within 5 standard deviations of so many normal numbers, and what limits of the model allow.

    Of the limits only a smaller chi-square can come. False failure: below 1e-5 for each number.
    """
    found = chi_squares(comparison)
    assert found.pop('piled', (0.0, 0))[0] < 4.0  # of the few sweeps that have samples piled up, if any
    assert set(kinds) == set(found)
    for kind, (value, count) in found.items():
        spread = 5.0 * math.sqrt(2.0 / count)
        assert value < 1.05 + spread, kind  # ramps' and means' deviations are from scatter, heavier in the tails
        if kind in ('ramp', 'lines'):
            assert value > 0.95 - spread, kind


@pytest.fixture(scope='module')
def by_others():
    return read_dataset(DATA / 'recording_0')


@pytest.mark.parametrize('station', [0, 1])
def test_one_stations_residuals_are_noise(by_others, station):
    """Nothing is concealed in recording_0, whichever station's samples are left; T_off is in the range alone."""
    comparison = Comparison(alone(by_others, station))
    assert comparison.receivers == (by_others.stations[station],)
    assert_noise(comparison, *IN_THE_IF, 'noise', 'amplitude', 'range', 'velocity')


@pytest.mark.parametrize('station', [0, 1])
def test_t_off_stands_in_the_range_of_one_line(by_others, station):
    """One nanosecond of T_off is a foot of range, which both lines together are free of."""
    jitter = Comparison(by_others).std.range, Comparison(alone(by_others, station)).std.range
    assert np.all(jitter[1] > 10.0 * jitter[0])


@pytest.mark.parametrize('sections', [{}, IQ], ids=['real', 'quadrature'])
def test_own_echos_residuals_are_noise(tmp_path, sections):
    """The phase of its line determines movement; of I/Q samples both parts have a mean."""
    data = read_dataset(own_echo(tmp_path / 'r', **sections))
    comparison = Comparison(data)
    assert comparison.measured.mean.shape == (5, 1, 2 if data.iq else 1)
    shown = [kind for kind in IN_THE_IF if kind not in ('ends', 'onset', 'transient')]
    assert_noise(comparison, *shown, 'noise', 'amplitude', 'range', 'velocity', 'movement')
    assert np.all(comparison.std.movement < 1e-4)


def test_a_single_sweep_is_compared_with_white_noise(tmp_path):
    """Without phase noise that is all there is; 111 cosine terms of amplitude and of phase."""
    quiet = {'phase_noise_level': float('nan')}
    comparison = Comparison(read_dataset(own_echo(tmp_path / 'r', (60.0,), 1, quiet)))
    assert comparison.known.undetermined()[-1].startswith('Fewer than 3 sweeps')
    assert_noise(comparison, 'ramp', 'lines', 'mean', 'range')


@pytest.mark.parametrize('iq', [False, True], ids=['real', 'quadrature'])
def test_a_line_in_blocks_is_the_maximum_likelihood_line(tmp_path, iq):
    """What blocks lose, the few samples that none covers, is a tenth of the noise; the recording is fixed."""
    data = read_dataset(own_echo(tmp_path / 'r', **(IQ if iq else {})))
    (sweep,), (calibration,), (samples,) = data.sweeps[0], data.calibration, data.samples
    settings = EstimatorSettings(estimator='pair')
    (found,), basebands = SingleEstimator(sweep, settings, iq, calibration).with_basebands((samples,), 8192.0)
    expected = MaximumLikelihoodEstimator(sweep, settings, iq, calibration)(samples, 8192.0)
    assert np.sqrt(np.mean(((found.frequency - expected.frequency) / expected.frequency_std) ** 2)) < 0.1
    assert np.all(np.abs(np.angle(np.exp(1j * (found.phase - expected.phase)))) < 5e-3)
    level = 20.0 * np.log10(np.abs(basebands.lines[0]).mean(axis=1) * (1.0 if iq else 2.0) / 8192.0)
    np.testing.assert_allclose(level + sweep.full_scale_power, expected.power, atol=0.05)


def test_effects_at_the_station_without_samples_act_on_its_peers_chirps(by_others):
    """A ripple of the slave's ramp reaches the master's IF, what its receiver does cannot."""
    comparison = Comparison(alone(by_others, 0), np.arange(72))
    ripple = Effect.registry['sweep_ripple'](deviation=500.0, rate=9000.0, station='slave')
    filtered = Effect.registry['if_filter'](pole=1e6, station='slave')
    assert np.linalg.norm(comparison.template([ripple])) > 10.0
    assert np.linalg.norm(comparison.template([filtered])) < 1e-6


@pytest.mark.parametrize(
    ('topics', 'compared', 'missing'),
    [
        (['/reference'], {*IN_THE_IF, 'noise', 'coherence', 'beat', 'amplitude', 'movement'}, '/reference/range'),
        (['/calibration'], {*IN_THE_IF, 'beat', 'amplitude', 'velocity', 'movement'}, '/slave/calib'),
        (['/slave/if', '/reference'], {*IN_THE_IF, 'noise'}, '/slave/if_samples'),
        (['/slave/sweep_config', '/status', '/site'], None, '/site/temperature'),
        (['/slave/if', '/slave/sweep', '/reference', '/calib', '/status', '/site'], {*IN_THE_IF}, '/site'),
    ],
    ids=['reference', 'calibration', 'slave and reference', 'conditions', 'all but one'],
)
def test_what_is_missing_is_said_and_not_compared(tmp_path, topics, compared, missing):
    """Nothing is concealed: what is left is noise. Without weather the range is trusted to what air may do."""
    data = read_dataset(without(recorded(tmp_path / 'r'), tmp_path / 'less', *topics))
    comparison = Comparison(data)
    everything = {*IN_THE_IF, 'noise', 'coherence', 'beat', 'amplitude', 'range', 'velocity', 'movement'}
    assert_noise(comparison, *(compared or everything))
    assert any(missing in sentence for sentence in data.missing)
    if '/site' in topics and compared is None:
        assert np.all(comparison.std.range > 2e-5 * comparison.data.distance[[m[0] for m in comparison.members]])


def test_a_line_next_to_zero_is_refused_in_one_line(tmp_path, capsys):
    path = own_echo(tmp_path / 'r', (3.0,))
    with pytest.raises(ConfigurationError, match='too near 0 Hz'):
        Comparison(read_dataset(path))
    assert main([str(path)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.slow
def test_a_ripple_is_named_by_one_station(tmp_path):
    """Station and size from the master's samples alone: at the slave it would shift with the distance."""
    truth = {'deviation': 900.0, 'rate': 9000.0}
    path = recorded(tmp_path / 'r', effects=[{'effect': 'sweep_ripple', 'station': 'master'} | truth])
    found = diagnose(without(path, tmp_path / 'master', '/slave/if_samples'))
    assert found.verdict in ('explained', 'ambiguous')
    named = [e for x in (found.explanation, *found.alternatives) for e in x.effects]
    (ripple,) = [e for e in named if (e.effect, e.station) == ('sweep_ripple', 'master')]
    for name, value in truth.items():
        estimate = ripple.parameters[name]
        assert abs(abs(estimate.value) - value) < 4.0 * estimate.std
    assert 0.9 < found.fit.held_out.after < 1.1 < found.fit.held_out.before
    assert any('/slave/if_samples is missing' in sentence for sentence in found.not_testable)


@pytest.mark.slow
def test_an_echo_is_named_by_a_station_that_hears_itself(tmp_path):
    """In I/Q samples; the refined model is a scenario of the same station."""
    echo = {'effect': 'echo', 'excess_range': 9.0, 'relative_power': -26.0}
    path = own_echo(tmp_path / 'r', **IQ, effects=[echo])
    alike = {'echo', 'ground_reflection', 'sweep_ripple', 'amplitude_loss', 'if_filter', 'spur', 'delay_offset'}
    found = diagnose(path, out=tmp_path, without=set(Effect.registry) - alike)
    assert found.verdict == 'explained'
    (effect,) = found.explanation.effects
    assert effect.effect == 'echo'
    for name in ('excess_range', 'relative_power'):
        assert abs(effect.parameters[name].value - echo[name]) < 4.0 * effect.parameters[name].std
    assert 'second: radar' in Path(found.refined_config).read_text(encoding='utf-8')
    assert any('Negative frequencies' in sentence for sentence in found.not_testable)
