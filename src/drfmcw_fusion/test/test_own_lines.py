"""A station that hears itself: what contradicts a straight ramp is said, ranges are searched, ramps combined."""

import dataclasses
import io

import numpy as np
import pytest
from rich.console import Console
from scenes import STANDARD_STATION, record

from drfmcw_fusion.combination import Station, own_path
from drfmcw_fusion.integrity.checks import Decision, Test
from drfmcw_fusion.integrity.continuity import Limits, Measured
from drfmcw_fusion.integrity.own_line import OwnLine
from drfmcw_fusion.offline import Reference, replay_recording
from drfmcw_fusion.pipeline import Flag
from drfmcw_fusion.replay import main, search_range
from drfmcw_fusion.replayed.report import mismatch, spread, table, unknown_velocity
from drfmcw_fusion.replayed.statistics import reference_at, setting_statistics
from drfmcw_fusion.replayed.up_and_down import up_and_down
from drfmcw_fusion.settings import FusionSettings
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.processing.records import Beat
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import SweepSettings
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


@pytest.fixture(scope='module')
def drive(tmp_path_factory):
    """A target that recedes from 60 m to 66 m at 3 m/s, a sweep every 10 ms."""
    scenario = {
        'stations': {'radar': STANDARD_STATION | {'delay': 12e-9}},
        'pairs': [{
            'first': 'radar', 'second': 'radar',
            'drive': {'waypoints': [60.0, 66.0], 'speed': 3.0, 'acceleration': 100.0, 'dwell': 0.0},
        }],
        'timing': {'sweep_interval': 0.01},
        'waveform': {'bandwidth': 500e6},
        'seed': 11,
    }  # fmt: skip
    return str(record(scenario_from_mapping(scenario, 'test'), tmp_path_factory.mktemp('drive') / 'r'))


def replayed(path, **settings):
    return replay_recording(path, EstimatorSettings(estimator='ml'), FusionSettings(**settings))


def test_motion_is_no_mismatch_and_its_error_is_stated(drive):
    """One ramp is off by f_c v / k and the way within it, 37 mm, far more than noise makes."""
    replay = replayed(drive)
    assert not any(r.flags & Flag.MODEL_MISMATCH for r in replay.results)
    middle = [r for r in replay.results if 62.0 < r.range < 64.5]
    truth = reference_at(replay.reference, np.array([r.stamp for r in middle]))
    error = np.array([r.range for r in middle]) - truth
    stated = np.array([r.range_std for r in middle])
    assert abs(np.mean(error) - 0.037) < 0.005 and np.all(error < 2.0 * stated) and np.all(stated < 0.08)
    rows = setting_statistics(replay.results, replay.reference)
    said = unknown_velocity(rows, {'radar': 6e9 / 500e9}, 10.0)
    assert 'a path that changes by 1 m/s moves the range by 12 mm' in said


def test_a_target_that_stands_by_declaration_has_no_doppler_error(drive):
    replay = replayed(drive, velocity='standing')
    assert all(r.doppler_std == 0.0 and r.range_std < 0.01 for r in replay.results)
    assert unknown_velocity(setting_statistics(replay.results, replay.reference), {'radar': 0.012}, 10.0) == ''


def hop(results, to, every):
    """Results of which every so many belong to another line."""
    return [dataclasses.replace(r, range=to if i % every == every - 1 else r.range) for i, r in enumerate(results)]


def hopping_own_line(distances, std=0.003):
    """The verdicts on ranges of a station that hears itself, every millisecond."""
    path = own_path(
        Station(
            Beat('radar', 'radar', 0, 0, 1e5, 10.0, 0.0, -60.0, 40.0, 0),
            SweepSettings('radar', 'radar'),
            Calibration('radar'),
        )
    )
    line = OwnLine(Limits(10.0, 0.3))
    return [
        line.follow(Measured((i + 1) * 1_000_000, path, d, std, 1.0, 0.04, (0, 0.0)))[0]
        for i, d in enumerate(distances)
    ]


def test_ranges_that_hop_between_lines_are_doubted():
    """After the first hop nothing that differs passes, and the standard deviation covers the other line."""
    rng = np.random.default_rng(3)
    at = np.where(rng.random(200) < 0.4, 3.97, 2.07) + rng.normal(0.0, 0.003, 200)
    verdicts = hopping_own_line(at)
    passed = at[[v.decision == Decision.VALID for v in verdicts]]
    assert np.ptp(passed) < 0.05
    assert all(v.failed == Test.CONTINUITY and 0.5 < v.std < 2.0 for v in verdicts if v.decision != Decision.VALID)


def test_one_outlier_is_doubted_and_no_other_range():
    """200 ranges, the chance of a false alarm is below 1e-3; one of them is 2 m off."""
    at = 5.0 + np.random.default_rng(4).normal(0.0, 0.003, 200)
    at[100] += 2.0
    assert [i for i, v in enumerate(hopping_own_line(at)) if v.decision != Decision.VALID] == [100]


def test_a_target_that_drives_does_not_hop():
    assert all(v.decision == Decision.VALID for v in hopping_own_line(5.0 + 0.009 * np.arange(200)))


NOWHERE = Reference(np.empty(0, np.int64), *np.empty((2, 0)), np.empty(0, str))


def test_settings_of_one_unmoved_target_are_compared(tmp_path):
    """A ramp that is 3 % off in one of two bands: the ranges differ, and the table has both bands."""
    wrong = {'effect': 'sweep_rate', 'station': 'radar', 'error': 3.0}
    results = []
    for name, bandwidth, effects in (('a', 150e6, ()), ('b', 120e6, (wrong,))):
        path = str(own(tmp_path / name, effects, (60.0,), bandwidth=bandwidth))
        later = 3600_000_000_000 * len(results)  # one after the other
        some = replayed(path, velocity='standing').results
        results += [dataclasses.replace(r, stamp=r.stamp + later) for r in some]
    rows = setting_statistics(results, NOWHERE)
    assert [row.bandwidth for row in rows] == [150e6, 120e6]
    (said,) = spread(rows)
    assert 'between the 2 settings of the sweep the range differs by' in said and 'a ramp is not as its' in said
    shown = Console(width=200, file=io.StringIO())
    shown.print(table(rows, 'test'))
    assert '5.725 GHz +150 MHz' in shown.file.getvalue()


def test_a_scatter_beyond_what_is_reported_is_stated(tmp_path):
    results = replayed(str(own(tmp_path / 'r', distances=(60.0,))), velocity='standing').results
    assert spread(setting_statistics(results, NOWHERE)) == []
    (said,) = spread(setting_statistics(hop(results, 60.5, 3), NOWHERE))
    assert 'scatter by' in said and 'times what is reported' in said


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
    assert all(r.doppler_std == 0.0 and r.range_std < 0.01 for r in combined)  # free of the Doppler shift
    rows = setting_statistics(combined, NOWHERE)
    shown = Console(width=200, file=io.StringIO())
    shown.print(table(rows, 'test', velocity=True))
    assert f'{rows[0].velocity:.3f}' in shown.file.getvalue() and abs(rows[0].velocity - 2.0) < 0.1


def test_that_nothing_counts_is_refused_with_the_reason(tmp_path, capsys):
    """The receiver hears noise alone: every sweep is left out, and the last line says so."""
    path = own(tmp_path / 'r', [{'effect': 'amplitude_loss', 'loss': 90.0}], (60.0,))
    assert main([str(path), '--estimator', 'ml']) == 2
    said = capsys.readouterr()
    assert 'whose line does not stand clear of the noise' in ' '.join(said.out.split()) and 'nan' not in said.out
    assert 'none of 20 sweeps gave a range that counts' in said.err
