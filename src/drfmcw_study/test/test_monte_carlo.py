"""Monte Carlo: the same bits whoever does the work, honest statistics, and one line where something is wrong."""

import dataclasses
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from checkout import CONFIG
from dask_clusters import dask_cluster
from hypothesis import given
from hypothesis import strategies as st
from scenes import mapping, record, scene

from drfmcw_fusion.offline import replay_recording
from drfmcw_fusion.settings import FusionSettings
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode
from drfmcw_study.measurement import measure
from drfmcw_study.monte_carlo import main
from drfmcw_study.points import grid, try_point, values_of
from drfmcw_study.summary import summarise
from drfmcw_study.trials.moments import Moments
from drfmcw_study.trials.results import ResultDirectory
from drfmcw_study.trials.running import run
from drfmcw_study.trials.study import Study, StudyStopped, point_seed

EXACT_WEATHER = {'temperature_std': 0.0, 'pressure_std': 0.0, 'humidity_std': 0.0}
SCENARIO = mapping({'standing': {'distances': [60.0, 700.0]}}, alphas=(1.000006, 0.999991))


def small_study(trials=70, batch=16):
    return Study(tuple(grid(SCENARIO, [], [], 5)), trials, batch)


def done(study, directory, task=try_point, **how):
    """Run a study and return the bytes of all its files."""
    with ResultDirectory(directory, study) as results:
        run(results, task, **how)
    return files(directory)


def files(directory):
    return {str(p.relative_to(directory)): p.read_bytes() for p in Path(directory).glob('*/*.npz')}


def slow_numbers(point, sweeps):
    """Trials that take their time."""
    time.sleep(point.get('pause', 0.05))
    return {'value': np.random.default_rng(point['seed']).standard_normal(sweeps.stop)[sweeps.start :]}


def deadly(point, sweeps):
    """The third batch ends its process as the kernel does when memory runs out."""
    if sweeps.start == 20:
        os.kill(os.getpid(), signal.SIGKILL)
    return slow_numbers(point, sweeps)


def broken(point, sweeps):
    raise ZeroDivisionError('by nothing')


def refusing(point, sweeps):
    raise ConfigurationError('not these settings')


# --- the same bits ---


@pytest.fixture(scope='module')
def cluster(tmp_path_factory):
    with dask_cluster(tmp_path_factory.mktemp('dask')) as started:
        yield started


def test_one_process_two_processes_and_a_cluster_give_the_same_bits(tmp_path, cluster):
    study = small_study()
    address, _ = cluster
    one = done(study, tmp_path / 'one')
    assert len(one) == 2 * 5
    assert done(study, tmp_path / 'two', jobs=2) == one
    assert done(study, tmp_path / 'cluster', scheduler=address) == one


def test_worker_of_a_cluster_that_dies_is_reported_and_replaced(tmp_path, cluster):
    study = Study(({'seed': 1, 'pause': 0.2},), 100, 5)
    address, workers = cluster
    expected = done(dataclasses.replace(study, points=({'seed': 1, 'pause': 0.0},)), tmp_path / 'one', slow_numbers)
    notes = []

    def kill_one(count):
        if count >= 20:
            workers[0].kill()

    found = done(study, tmp_path / 'cluster', slow_numbers, scheduler=address, progress=kill_one, note=notes.append)
    assert found == expected
    assert len(notes) == 1 and 'is gone' in notes[0]


def test_no_scheduler_is_one_line(tmp_path, capfd):
    for address, why in (('localhost', 'expected'), ('tcp://nowhere.invalid:1', 'no Dask scheduler')):
        with pytest.raises(ConfigurationError, match=why):
            done(small_study(), tmp_path / 'x', scheduler=address)
    assert capfd.readouterr().err == ''


def test_interrupted_study_ends_as_if_it_had_not_been(tmp_path):
    """Ctrl-C of a real process and its workers, kill -9, and then to the end."""
    scenario = CONFIG / 'gantry.yaml'
    words = [str(scenario), '--vary', 'distance=50,800', '--trials', '500', '--batch', '10', '--jobs', '2']
    command = [sys.executable, '-m', 'drfmcw_study.monte_carlo', *words, '--out', str(tmp_path / 'stopped')]
    for stop in (signal.SIGINT, signal.SIGKILL):
        before = len(files(tmp_path / 'stopped'))
        # in a group of its own, all of which a terminal's Ctrl-C reaches
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
        while len(files(tmp_path / 'stopped')) < before + 3 and process.poll() is None:
            time.sleep(0.01)
        assert process.poll() is None, process.stderr.read()
        os.killpg(process.pid, stop) if stop == signal.SIGINT else process.kill()
        _, errors = process.communicate(timeout=30)
        if stop == signal.SIGINT:
            assert process.returncode == 130
            assert errors.count('\n') == 1 and 'the same command does the rest' in errors
    assert 6 <= len(files(tmp_path / 'stopped')) < 100
    assert main([*words, '--out', str(tmp_path / 'stopped'), '--json', str(tmp_path / 'stopped.json')]) == 0
    assert main([*words, '--out', str(tmp_path / 'whole'), '--json', str(tmp_path / 'whole.json')]) == 0
    assert files(tmp_path / 'stopped') == files(tmp_path / 'whole')
    assert (tmp_path / 'stopped.json').read_bytes() == (tmp_path / 'whole.json').read_bytes()


def test_damaged_result_is_computed_again(tmp_path):
    study = small_study()
    whole = done(study, tmp_path / 'x')
    name = sorted(whole)[3]
    for content in (b'', whole[name][: len(whole[name]) // 2], b'x' + whole[name][1:]):
        (tmp_path / 'x' / name).write_bytes(content)
        assert done(study, tmp_path / 'x') == whole


def test_trial_does_not_depend_on_the_batch_around_it():
    scenario = scene({'standing': {'distances': [300.0]}}, alphas=(1.000006, 0.999991))
    whole = measure(scenario, range(3, 40), mode=Mode.SHORT_DISTANCE)
    part = measure(scenario, range(20, 23), mode=Mode.SHORT_DISTANCE)
    assert np.array_equal(part.range, whole.range[17:20]) and np.array_equal(part.range_std, whole.range_std[17:20])
    assert np.array_equal(part.stations[1].phase, whole.stations[1].phase[17:20])


# --- what stops ---


@pytest.mark.parametrize('jobs', [1, 2])
def test_failing_task_stops_with_its_reason(tmp_path, jobs):
    study = Study(({'seed': 1},), 40, 10)
    with pytest.raises(StudyStopped, match='ZeroDivisionError: by nothing'):
        done(study, tmp_path / 'x', broken, jobs=jobs)
    with pytest.raises(ConfigurationError, match='not these settings'):
        done(study, tmp_path / 'x', refusing, jobs=jobs)


def test_killed_worker_is_reported_and_its_work_can_be_taken_up(tmp_path):
    study = Study(({'seed': 1, 'pause': 0.0},), 100, 10)
    with pytest.raises(StudyStopped, match='SIGKILL'):
        done(study, tmp_path / 'x', deadly, jobs=2)
    assert done(study, tmp_path / 'x', slow_numbers, jobs=2) == done(study, tmp_path / 'y', slow_numbers)


def test_changed_study_is_refused(tmp_path, capsys):
    """Results of different settings must not be mixed."""
    words = ['gantry', '--set', 'distance=60', '--trials', '4', '--batch', '2', '--jobs', '1']
    words += ['--out', str(tmp_path / 'x')]
    assert main(words) == 0
    before = files(tmp_path / 'x')
    changes = (
        (['--trials', '6'], 'trials is 4 there, 6 here'),
        (['--seed', '9'], 'seed'),
        (['--vary', 'weather.humidity=0.1,0.2'], '1 points there, 2 here'),
        (['--set', 'stations.master.alpha=1.00001'], 'alpha is 1.000006 there, 1.00001 here'),
        (['--estimator', 'hann'], 'estimator'),
    )
    for change, why in changes:
        capsys.readouterr()
        assert main(words + change) == 2
        error = capsys.readouterr().err
        assert error.count('\n') == 1 and 'holds another study' in error and why in error
    assert files(tmp_path / 'x') == before


@pytest.mark.parametrize(
    ('words', 'why'),
    [
        (['--vary', 'distance=1:2:0'], 'distance=1:2:0'),
        (['--vary', 'distance'], 'expected KEY='),
        (['--vary', 'distance=5:1:1'], 'does not lead'),
        (['--vary', 'distance=5', '--vary', 'distance=6'], 'twice'),
        (['--vary', 'seed=1,2'], '--seed'),
        (['--vary', 'wether.humidity=0.5'], "did you mean 'weather'"),
        (['--vary', 'weather.humidity=0.5,1.5'], 'weather.humidity=1.5'),
        (['--set', 'stations.master.alpha=2'], 'outside'),
        (['--estimator', 'papr'], 'papr'),
        (['--trials', '0'], 'trials'),
        (['--jobs', '0'], '--jobs'),
    ],
)
def test_wrong_input_is_one_line_and_nothing_written(tmp_path, capsys, words, why):
    assert main(['gantry', '--out', str(tmp_path / 'x'), *words]) == 2
    error = capsys.readouterr().err
    assert error.count('\n') == 1 and why in error
    assert not (tmp_path / 'x').exists()


def test_directory_of_something_else_or_in_use_is_refused(tmp_path):
    (tmp_path / 'letter').write_text('mine')
    with pytest.raises(ConfigurationError, match='not empty'):
        done(small_study(), tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ['letter']
    with ResultDirectory(tmp_path / 'x', small_study()):
        with pytest.raises(ConfigurationError, match='another run'):
            done(small_study(), tmp_path / 'x')


# --- statistics ---


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60),
    st.lists(st.integers(0, 60), max_size=6),
    st.floats(-1e4, 1e4),
)
def test_merged_moments_are_those_of_all_values(values, cuts, offset):
    values = np.array(values) + offset
    merged = Moments()
    for part in np.split(values, sorted(min(c, len(values)) for c in cuts)):
        merged = merged.merge(Moments.of(part))
    assert merged.n == len(values)
    assert merged.mean == pytest.approx(values.mean(), rel=1e-12, abs=1e-12)
    if len(values) > 1:
        # rounding of the values themselves: 60 x 1e4 x 1e-16
        assert merged.std == pytest.approx(values.std(ddof=1), rel=1e-9, abs=1e-10)
        assert merged.standard_error == pytest.approx(merged.std / math.sqrt(len(values)))


def test_statistics_are_those_of_all_trials_at_once(tmp_path):
    study = small_study()
    with ResultDirectory(tmp_path / 'x', study) as results:
        run(results, try_point)
        rows = summarise(results)
    for row, point in zip(rows, study.points, strict=True):
        all_trials = try_point(point, range(study.trials))
        error = all_trials['range'] - all_trials['true_range']
        assert row.n == study.trials and row.outliers == 0 and row.flagged == np.count_nonzero(all_trials['flags'])
        assert row.bias == pytest.approx(error.mean(), rel=1e-9)
        assert row.std == pytest.approx(error.std(ddof=1), rel=1e-9)
        assert row.bias_error == pytest.approx(error.std(ddof=1) / math.sqrt(study.trials), rel=1e-9)
        assert row.predicted_std == pytest.approx(math.sqrt(np.mean(all_trials['range_std'] ** 2)), rel=1e-9)
        assert row.chi_square == pytest.approx(np.mean((error / all_trials['range_std']) ** 2), rel=1e-9)


def test_bias_and_standard_deviation_are_honest(tmp_path):
    """At 200 m: no bias beyond 4 standard errors, chi-square per trial 1 within 5 % and 4 of its standard errors.

    Seed 5; each fails falsely with a probability of 6e-5.
    """
    points = grid(mapping({'standing': {'distances': [200.0]}}, alphas=(1.000006, 0.999991)), [], [], 5)
    study = Study(tuple(points), 2000, 500)
    with ResultDirectory(tmp_path / 'x', study) as results:
        run(results, try_point, jobs=2)
        (row,) = summarise(results)
    assert row.n == study.trials
    assert abs(row.bias) < 4.0 * row.bias_error
    assert abs(row.chi_square - 1.0) < 0.05 + 4.0 * math.sqrt(2.0 / study.trials)


def test_systematic_error_is_bias_and_a_wrong_line_an_outlier(tmp_path):
    """10 ns of unknown delay are 3 m in every trial; at -40 dB of signal other bins win."""
    late = mapping({'standing': {'distances': [60.0]}}) | {'effects': [{'effect': 'delay_offset', 'delay': 10.0}]}
    points = grid(late, [], [], 1) + grid(SCENARIO, [('distance', ['60'])], ['pairs.0.path_loss=135'], 1)
    study = Study(tuple(points), 60, 20)
    with ResultDirectory(tmp_path / 'x', study) as results:
        run(results, try_point)
        shifted, lost = summarise(results)
    assert shifted.outliers == 0 and shifted.bias == pytest.approx(10e-9 * SPEED_OF_LIGHT, rel=1e-2)
    assert lost.outliers > 50 and lost.flagged > 50 and lost.outliers + lost.n == study.trials


# --- what is simulated ---


@pytest.mark.parametrize('distance', [80.0, 900.0])
def test_a_trial_is_what_a_recording_of_the_scenario_gives(tmp_path, distance):
    """The same samples through the replay of a recording: the same ranges to the last bit."""
    scenario = scene({'standing': {'distances': [distance], 'sweeps': 30}}, (1.000006, 0.999991), weather=EXACT_WEATHER)
    fusion = FusionSettings(velocity='standing')
    replay = replay_recording(str(record(scenario, tmp_path / 'bag')), fusion=fusion)
    mode = Mode.LONG_DISTANCE if distance > 650.0 else Mode.SHORT_DISTANCE
    trials = measure(scenario, range(30), mode=mode, fusion=fusion)
    assert [r.range for r in replay.results] == trials.range.tolist()
    assert [r.range_std for r in replay.results] == trials.range_std.tolist()
    assert [r.flags for r in replay.results] == trials.flags.tolist()
    assert [r.carrier_phase for r in replay.results] == trials.carrier_phase.tolist()


@pytest.mark.parametrize(
    ('distance', 'full_scale', 'mode'), [(150.0, -50.0, Mode.SHORT_DISTANCE), (900.0, -65.0, Mode.LONG_DISTANCE)]
)
@pytest.mark.parametrize('bandwidth', [150e6, -150e6])
def test_synchronised_station_knows_the_range_when_nothing_disturbs_it(distance, full_scale, mode, bandwidth):
    """Different clocks, an offset of the start frequencies and jitter of T_off are known to it."""
    quiet = {'noise_floor': -250.0, 'phase_noise_level': math.nan, 'delay': 10e-9, 'full_scale_power': full_scale}
    scenario = scene(
        {'standing': {'distances': [distance]}, 'frequency_offset': 2e3},
        waveform={'bandwidth': bandwidth},
        stations={'master': quiet | {'alpha': 1.000004}, 'slave': quiet | {'alpha': 1.0000035}},
    )
    trials = measure(scenario, range(8), mode=mode, synchronised=True)
    assert np.abs(trials.synchronised_range - trials.true_range).max() < 1e-3
    assert np.abs(trials.error).max() < 1e-3


def test_synchronised_station_scatters_with_the_whole_phase_noise():
    """Seed of the scene; 300 trials, 4 standard errors of a standard deviation: falsely in 6e-5 of cases."""
    scenario = scene({'standing': {'distances': [15.0]}})
    trials = measure(scenario, range(300), mode=Mode.SHORT_DISTANCE, synchronised=True)
    found = np.std(trials.synchronised_range, ddof=1)
    expected = trials.stations[1].frequency_std.mean() / 150e9 * SPEED_OF_LIGHT
    assert found == pytest.approx(expected, rel=0.03 + 4.0 / math.sqrt(2 * 300))
    assert found > 5.0 * np.std(trials.range)


# --- points ---


def test_grid_varies_everything():
    points = grid(
        SCENARIO,
        [('distance', ['50', '100']), ('weather.humidity', ['0.1', '0.9']), ('estimator.estimator', ['paper', 'hann'])],
        ['stations.slave.alpha=1.00001'],
        3,
    )
    assert len(points) == 8
    assert points[5]['varied'] == {'distance': '100', 'weather.humidity': '0.1', 'estimator.estimator': 'hann'}
    assert points[5]['scenario']['pairs'][0]['standing'] == {'distances': [100]}
    assert all(p['scenario']['stations']['slave']['alpha'] == 1.00001 for p in points)
    assert SCENARIO['stations']['slave']['alpha'] == 0.999991  # what was read stays as it is
    # estimators are compared on the same samples, scenarios are independent
    assert points[0]['seed'] == points[1]['seed'] and len({p['seed'] for p in points}) == 4
    assert {p['seed'] for p in points}.isdisjoint(p['seed'] for p in grid(SCENARIO, [], [], 4))


def test_scenario_with_several_distances_is_tried_at_each():
    assert [p['varied']['distance'] for p in grid(SCENARIO, [], [], 3)] == ['60.0', '700.0']


@given(st.integers(-50, 50), st.integers(1, 40), st.sampled_from([0.1, 0.25, 1.0, 1e-6, -2.5]))
def test_steps_include_both_ends(first, count, step):
    last = first + count * step
    key, values = values_of(f'a.b={first}:{last!r}:{step}')
    assert key == 'a.b' and len(values) == count + 1
    assert [float(v) for v in values] == pytest.approx([first + i * step for i in range(count + 1)], abs=1e-9)


def test_seed_of_a_point_depends_on_all_of_it():
    assert point_seed(1, {'a': 1, 'b': 2}) == point_seed(1, {'b': 2, 'a': 1})
    assert len({point_seed(1, {'a': 1}), point_seed(2, {'a': 1}), point_seed(1, {'a': 2})}) == 3


def test_settings_of_the_estimator_reach_it():
    """A rectangular window instead of Hann: a smaller reported standard deviation."""
    scenario = scene({'standing': {'distances': [500.0]}})
    hann, boxcar = (
        measure(scenario, range(5), mode=Mode.SHORT_DISTANCE, estimator=EstimatorSettings(window=w)).range_std.mean()
        for w in ('hann', 'boxcar')
    )
    assert boxcar < 0.8 * hann
