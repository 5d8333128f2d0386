"""A station that hears itself: what contradicts a straight ramp is said, ranges are searched, ramps combined."""

import numpy as np
import pytest
from scenes import STANDARD_STATION, record

from drfmcw_fusion.offline import replay_recording
from drfmcw_fusion.pipeline import Flag
from drfmcw_fusion.replay import main, search_range
from drfmcw_fusion.replayed.report import mismatch
from drfmcw_fusion.replayed.up_and_down import up_and_down
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.settings import ConfigurationError
from drfmcw_sim.scenario import scenario_from_mapping

BENT = {'effect': 'sweep_shape', 'station': 'radar', 'relative_rate': [1.1, 0.92, 1.05, 0.97, 1.08, 0.9, 1.0]}


def own(path, effects=(), distances=(60.0, 150.0), name='radar', bandwidth=150e6, sweeps=20):
    """A recording of a station that hears itself, without the noise of its oscillator."""
    scenario = {
        'stations': {name: STANDARD_STATION | {'delay': 12e-9}},
        'pairs': [{'first': name, 'second': name, 'standing': {'distances': list(distances), 'sweeps': sweeps}}],
        'waveform': {'bandwidth': bandwidth},
        'effects': list(effects),
        'seed': 11,
    }
    return record(scenario_from_mapping(scenario, 'test'), path)


def test_a_bent_ramp_is_flagged_and_its_standard_deviation_covers_the_error(tmp_path):
    """The window's 5 % is not seen by a straight line's noise, but by how the line varies."""
    effects = [BENT, {'effect': 'sweep_rate', 'station': 'radar', 'error': 3.0}]
    replay = replay_recording(str(own(tmp_path / 'r', effects)), EstimatorSettings(estimator='ml'))
    assert all(r.flags & Flag.MODEL_MISMATCH and not r.flags & Flag.SIGNAL_QUALITY for r in replay.results)
    for result in replay.results:
        truth = replay.reference.ranges[np.argmin(np.abs(replay.reference.stamps - result.stamp))]
        assert abs(result.range - truth) < 3.0 * result.range_std
        assert result.range_std > 0.01 * truth
    assert 'In 40 of 40 sweeps' in mismatch(replay.results)


def test_a_straight_ramp_is_not_doubted(tmp_path):
    """Noise, phase noise and scatter of the power alone; 200 sweeps at a false alarm below 1e-5 each."""
    replay = replay_recording(str(own(tmp_path / 'r', sweeps=100)), EstimatorSettings(estimator='ml'))
    assert len(replay.results) == 200
    assert not any(r.flags & Flag.MODEL_MISMATCH for r in replay.results)
    assert mismatch(replay.results) == ''


def test_a_search_range_passes_over_a_stronger_line(tmp_path):
    echo = {'effect': 'echo', 'excess_range': 40.0, 'relative_power': -6.0}
    path = str(own(tmp_path / 'r', [echo], (60.0,)))
    near, far = (
        replay_recording(path, EstimatorSettings(estimator='ml', **search_range(text))).results
        for text in (None, '80:200')
    )
    assert abs(np.median([r.range for r in near]) - 60.0) < 0.5
    assert abs(np.median([r.range for r in far]) - 100.0) < 0.5


def test_a_search_range_must_be_one(tmp_path, capsys):
    with pytest.raises(ConfigurationError, match='expected MIN:MAX'):
        search_range('5-40')
    with pytest.raises(ConfigurationError, match='not below'):
        EstimatorSettings(**search_range('40:5'))
    assert main([str(own(tmp_path / 'r', (), (60.0,), sweeps=2)), '--pair', 'up/down']) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_rising_and_falling_ramps_give_range_and_velocity(tmp_path):
    """A drive of 2 m/s: Doppler moves either range by f_c v / k, 8 cm, their mean not at all."""
    motion = {'effect': 'target_motion', 'velocity': [2.0]}
    results = []
    for name, bandwidth in (('up', 150e6), ('down', -150e6)):
        path = own(tmp_path / name, [motion], (60.0,), name, bandwidth)
        results += replay_recording(str(path), EstimatorSettings(estimator='ml')).results
    scale = 5.8e9 / 150e9
    combined = up_and_down(results, 'up/down', scale)
    assert len(combined) == 20
    assert abs(np.median([r.velocity for r in combined]) - 2.0) < 0.2
    assert abs(np.median([r.range for r in combined]) - 60.0) < 0.02
    assert combined[0].second_station == 'down'
