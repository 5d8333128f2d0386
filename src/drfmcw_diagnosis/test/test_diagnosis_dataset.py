"""A recording as the diagnosis sees it: arrays, nominal model, what lacks; and the scenario that makes it again."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
import yaml
from checkout import DATA
from scenes import mapping, record, scene

from drfmcw_diagnosis.finding.refined import scenario_mapping, write_scenario
from drfmcw_diagnosis.recording.dataset import Dataset, read_dataset
from drfmcw_diagnosis.recording.limits import GROUPS
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode, beat_frequency
from drfmcw_ros.bag.files import BagReader, BagWriter, typestore
from drfmcw_ros.commands.cli import guarded
from drfmcw_sim.recording import write_recording
from drfmcw_sim.scenario import Scenario, read_scenario, scenario_from_mapping
from drfmcw_sim.timeline import Timeline
from drfmcw_sim.trajectory import Recorded

EXACT_WEATHER = {'temperature_std': 0.0, 'pressure_std': 0.0, 'humidity_std': 0.0, 'interval': 0.5}
STANDING = {'standing': {'distances': [60.0, 750.0], 'sweeps': 12, 'move_time': 5.0}}
OWN_ECHO = {'stations': {'radar': {'delay': 5e-9}}, 'mode': {'start_delay_short': 0.0, 'start_delay_long': 0.0}}


def own_echo(distances: list[float], **sections) -> dict:
    """Return what a scenario file of a station that hears itself holds."""
    pair = {'first': 'radar', 'second': 'radar', 'standing': {'distances': distances, 'sweeps': 8}}
    return OWN_ECHO | {'pairs': [pair], 'reference': {'range_std': 0.0}} | sections


def changed(source: Path, target: Path, drop: tuple[str, ...] = (), change=None) -> Path:
    """Copy a recording without some topics; `change` acts on each message and may return False to leave it out."""
    store = typestore()
    with BagReader(source) as bag, BagWriter(target) as copy:
        for topic, time, kind, raw in bag.raw_messages():
            if topic in drop:
                continue
            message = store.deserialize_cdr(raw, kind)
            if change is None or change(topic, message) is not False:
                copy.write(topic, kind, time, message)
    return target


def group_means(values: np.ndarray, dataset: Dataset) -> np.ndarray:
    """Return the mean over each group along the last axis, (..., groups)."""
    groups = range(dataset.group[-1] + 1)
    return np.stack([np.mean(values[..., dataset.group == g], axis=-1) for g in groups], axis=-1)


def true_distances(scenario: Scenario) -> np.ndarray:
    """Return the distances of all sweeps of a scenario of one pair."""
    timeline = Timeline(scenario)
    found = []
    while not timeline.finished:
        timeline.due_mode_changes()
        slots = timeline.slots(1000)
        found.append(slots.distance)
        timeline.advance(len(slots))
    return np.concatenate(found)


def read_dataset_again(dataset: Dataset, folder: Path, effects=(), name: str = 'again') -> Dataset:
    """Simulate what the dataset and the effects say, and read it."""
    write_scenario(folder / f'{name}.yaml', dataset, effects)
    write_recording(read_scenario(folder / f'{name}.yaml'), folder / name)
    return read_dataset(folder / name)


@pytest.fixture(scope='module')
def practice() -> Dataset:
    """A recording of another hand, nothing concealed."""
    return read_dataset(DATA / 'recording_0')


@pytest.fixture(scope='module')
def standing(tmp_path_factory) -> Path:
    """A recording of a crane that stands at two distances, in one mode each."""
    return record(scene(STANDING, timing={'sweep_interval': 0.02}), tmp_path_factory.mktemp('standing') / 'r')


def test_recording_of_another_hand(practice):
    """Everything is there, in order; groups are the distances; the chain's own results lie on the nominal model."""
    assert practice.stations == ('master', 'slave')
    assert practice.missing == ()
    assert [s.shape for s in practice.samples] == [(336, 2048)] * 2
    assert {s.dtype for s in practice.samples} == {np.dtype(np.int16)}
    assert np.all(np.diff(practice.stamp) > 0)
    assert np.array_equal(np.bincount(practice.group), [24] * 14)
    assert [(s[0].mode, s[0].start_delay) for s in practice.sweeps] == [(0, 3.41e-6), (1, 0.6e-6)]
    assert np.isfinite(practice.board_temperature).all()
    assert np.array_equal(practice.distance, practice.reference)
    # 336 sweeps with 0.2 dB of scatter and 0.1 dB of noise in each density: bounds of 9 and 6 standard deviations
    assert np.abs(np.mean(practice.lines.power - practice.received_power, axis=1)).max() < 0.1
    assert np.abs(np.mean(practice.lines.noise_density, axis=1) + 140.0).max() < 0.1
    error = (practice.lines.range - practice.reference) / np.hypot(practice.lines.range_std, practice.reference_std)
    assert scipy.stats.chi2.sf(np.sum(error**2), len(error)) > 1e-6
    assert np.abs(practice.velocity / practice.velocity_std).max() < 5.0  # 14 slopes: chance of 1e-5


def test_moving_crane_is_one_group_each():
    """Settings whose reference moves by up to 0.75 m within half a second stay together and show their speed."""
    moving = read_dataset(DATA / 'recording_5')
    assert np.array_equal(np.bincount(moving.group), [24] * 14)
    assert np.sum(np.abs(moving.velocity[::24]) > 10 * moving.velocity_std[::24]) > 10
    assert np.abs(moving.velocity).max() < 3.0


@pytest.mark.parametrize(
    'sections',
    [
        mapping(STANDING, alphas=(1.000006, 0.999991)),
        mapping(STANDING | {'frequency_offset': 2e3}, waveform={'iq': True}),
        mapping({'standing': {'distances': [300.0], 'sweeps': 5}}, waveform={'bandwidth': -150e6}),
        own_echo([20.0, 90.0]),
        own_echo([45.0], waveform={'iq': True}),
    ],
    ids=['pair', 'quadrature', 'falling', 'own echo', 'own echo in quadrature'],
)
def test_nominal_model_is_the_simulators(sections, tmp_path):
    """Where nothing is hidden and sensors are exact, a recording's nominal model is what the simulator started from."""
    boards = {'times': [0.0, 8.0], 'values': [10.0, 50.0]}
    stations = {name: s | {'board_temperature': boards} for name, s in sections['stations'].items()}
    weather = EXACT_WEATHER | {'temperature': 27.0, 'humidity': 0.9}
    timing = {'status_interval': 0.005}
    scenario = scenario_from_mapping(sections | {'stations': stations, 'weather': weather, 'timing': timing}, 'test')
    dataset = read_dataset(record(scenario, tmp_path / 'r'))
    assert dataset.missing == ()
    timeline = Timeline(scenario)
    done = 0
    while not timeline.finished:
        timeline.due_mode_changes()
        slots = timeline.slots(1000)
        truth = timeline.measurements(slots, 0)
        nominal = dataset.nominal(slice(done, done + len(slots)))
        for name in ('range', 'velocity', 'start_delay', 'initial_phase', 'refractive_index', 'sweep_id'):
            np.testing.assert_allclose(getattr(nominal, name), getattr(truth, name), rtol=1e-12, err_msg=name)
        np.testing.assert_allclose(nominal.time, truth.time, atol=2e-9)
        np.testing.assert_allclose(nominal.paths[0].delay, truth.paths[0].delay, rtol=1e-12)
        for own, true in zip(nominal.stations, truth.stations, strict=True):
            for name in ('alpha', 'sample_clock', 'received_power', 'noise_density', 'full_scale', 'iq', 'phase_noise'):
                assert np.array_equal(getattr(own, name), getattr(true, name)), name
            # reported every 5 ms while it rises by 5 K/s
            np.testing.assert_allclose(own.temperature, true.temperature, atol=0.026)
        done += len(slots)
        timeline.advance(len(slots))
    assert done == len(dataset)


def test_rows_of_several_settings_are_refused(practice):
    """The model holds for one set of sweep settings."""
    assert len(practice.nominal(practice.setting == 1)) == 120
    with pytest.raises(ValueError, match='one setting'):
        practice.nominal(slice(None))


@pytest.mark.parametrize(
    ('drop', 'words'),
    [
        (('/slave/if_samples',), ['/slave/if_samples is missing', 'T_off']),
        (('/master/if_samples', '/reference/range'), ['/master/if_samples is missing', '/reference/range is missing']),
        (('/slave/sweep_config',), ["follow those of 'master'"]),
        (('/master/calibration',), ['/master/calibration is missing']),
        (('/reference/range',), ['/reference/range is missing']),
        (('/site/humidity', '/site/pressure'), ['/site/pressure, /site/humidity missing']),
        (('/slave/status',), ['/slave/status is missing']),
    ],
)
def test_what_is_missing_is_said(standing, tmp_path, drop, words):
    """A topic that is missing is named, and the rest is still as it was."""
    whole, dataset = read_dataset(standing), read_dataset(changed(standing, tmp_path / 'r', drop))
    said = '\n'.join(dataset.missing)
    assert all(word in said for word in words), said
    assert np.array_equal(np.bincount(dataset.group), [12, 12])
    assert np.abs(dataset.stamp - whole.stamp).max() <= 1
    for i, station in enumerate(dataset.stations):
        assert (dataset.samples[i] is None) == (f'/{station}/if_samples' in drop)
        assert np.isnan(dataset.board_temperature[i]).all() == (f'/{station}/status' in drop)
        assert np.isfinite(dataset.nominal(slice(0, 12)).stations[i].temperature).all()
        for own, all_there in zip(dataset.sweeps, whole.sweeps, strict=True):
            assert dataclasses.replace(own[i], frame_id='') == dataclasses.replace(all_there[i], frame_id='')
    # T_off scatters by 2 ns, 0.6 m of range for one station alone; both together measure centimetres
    one_alone = any(s is None for s in dataset.samples)
    hardware = 3.6 if '/master/calibration' in drop else 0.0
    tolerance = 5 * 0.6 if one_alone and '/reference/range' in drop else 0.1
    assert np.abs(dataset.distance - whole.distance - hardware * ('/reference/range' in drop)).max() < tolerance


def test_a_recording_that_lacks_what_is_needed(standing, tmp_path, capsys):
    """One line that names it, exit status 2."""
    cases = {
        'samples': (('/master/if_samples', '/slave/if_samples'), None, '/<station>/if_samples'),
        'settings': (('/master/sweep_config', '/slave/sweep_config'), None, "'/master/sweep_config'"),
        'pair': ((), 'master/tower', "unknown pair 'master/tower'"),
    }
    for name, (drop, pair, words) in cases.items():
        path = changed(standing, tmp_path / name, drop)
        assert guarded('test', lambda path=path, pair=pair: read_dataset(path, pair) and None) == 2
        line = capsys.readouterr().err
        assert words in line
        assert line.count('\n') == 1

    def shorten(topic, message):
        if topic.endswith('if_samples'):
            message.samples = message.samples[:-1]

    with pytest.raises(ConfigurationError, match='no usable sweep'):
        read_dataset(changed(standing, tmp_path / 'short', change=shorten))


def test_sweeps_that_do_not_belong_are_left_out_and_counted(standing, tmp_path):
    """A lost record of one station takes its partner with it; one of a wrong length, too."""
    lost = {('/slave/if_samples', 3), ('/master/if_samples', 17)}

    def lose(topic, message):
        if topic.endswith('if_samples'):
            if message.sweep_id == 5:
                message.samples = message.samples[:100]
            return (topic, message.sweep_id) not in lost
        return None

    dataset = read_dataset(changed(standing, tmp_path / 'r', change=lose))
    assert sorted(set(range(24)) - set(dataset.sweep_id)) == [3, 5, 17]
    assert len(dataset.group) == 21
    assert any('2 sweeps of which only one' in m for m in dataset.missing)
    assert sum('100 samples' in m for m in dataset.missing) == 2
    assert len(read_dataset_again(dataset, tmp_path)) == 21


def test_pair_is_chosen(tmp_path):
    """Of several pairs the one asked for, else the one with most sweeps, and it is said."""
    pairs = [
        {'first': 'master', 'second': 'slave', 'standing': {'distances': [100.0], 'sweeps': 4}},
        {'first': 'master', 'second': 'tower', 'standing': {'distances': [200.0, 210.0], 'sweeps': 4}},
    ]
    stations = {name: {} for name in ('master', 'slave', 'tower')}
    scenario = scenario_from_mapping({'stations': stations, 'pairs': pairs, 'reference': {'range_std': 0.0}}, 'test')

    def shorten(topic, message):  # both pairs are measured until the last one is done
        return (
            not topic.endswith('if_samples') or 'slave' not in (message.station, message.peer) or message.sweep_id < 8
        )

    path = changed(record(scenario, tmp_path / 'whole'), tmp_path / 'r', change=shorten)
    default, chosen = read_dataset(path), read_dataset(path, 'slave/master')
    assert default.stations == ('master', 'tower')
    assert (len(default), len(chosen)) == (8, 4)
    assert any('only the pair master/tower' in m and 'master/slave' in m for m in default.missing)
    assert chosen.stations == ('master', 'slave')
    assert set(chosen.distance) == {100.0}


def test_drive_is_cut_into_groups(tmp_path):
    """A driving crane's groups are short, its velocity is the reference's slope; the simulation again follows it."""
    drive = {'drive': {'waypoints': [100.0, 106.0], 'speed': 2.0, 'acceleration': 1.0, 'dwell': 0.5}}
    scenario = scene(drive, timing={'sweep_interval': 0.05}, reference={'range_std': 0.002})
    dataset = read_dataset(record(scenario, tmp_path / 'r'))
    assert np.bincount(dataset.group).max() <= GROUPS.most
    assert dataset.group[-1] >= 4
    assert np.all(np.diff(dataset.group) >= 0)
    distance, true, _ = scenario.pairs[0].trajectory.state(None, dataset.time)
    for g in range(dataset.group[-1] + 1):
        rows = dataset.group == g
        # the slope weighs a changing velocity a little differently: 0.05 m/s; some 10 groups: chance 6e-6
        assert abs(dataset.velocity[rows][0] - np.mean(true[rows])) < 0.05 + 5 * dataset.velocity_std[rows][0]
    again = scenario_from_mapping(scenario_mapping(dataset), 'test')
    # 5 deviations of a reading; an acceleration begins anywhere in a group of 0.3 s or more: 0.5 m/s^2 (0.15 s)^2
    assert np.abs(true_distances(again) - distance).max() < 5 * 0.002 + 0.012


def test_unknown_levels_are_taken_from_the_sweeps(tmp_path):
    """A radar that states neither EIRP nor full scale nor noise: the power stands in dBFS, the noise as measured."""
    unknown = ('tx_eirp', 'rx_antenna_gain', 'full_scale_power', 'noise_floor', 'phase_noise_level')
    quiet = own_echo([40.0], waveform={'iq': True}, reference={'enabled': False})
    quiet['stations'] = {'radar': {'delay': 0.0, 'phase_noise_level': float('nan'), 'noise_floor': -120.0}}

    def forget(topic, message):
        for name in unknown:
            if hasattr(message, name):
                setattr(message, name, float('nan'))

    path = record(scenario_from_mapping(quiet, 'test'), tmp_path / 'r')
    known, dataset = read_dataset(path), read_dataset(changed(path, tmp_path / 'forgot', change=forget))
    assert dataset.stations == ('radar',)
    assert dataset.iq
    assert dataset.samples[0].shape == (8, 4096)
    np.testing.assert_allclose(dataset.received_power[0], np.mean(known.lines.power) + 20.0, atol=1e-6)
    # the noise over 8 sweeps of 2048 bins: 0.5 dB is more than 5 standard deviations
    assert abs(dataset.calibration[0].noise_floor + 100.0) < 0.5
    assert len(dataset.missing) == 3
    again = read_dataset_again(dataset, tmp_path)
    assert again.samples[0].shape == (8, 4096)
    assert abs(np.mean(again.lines.power) - np.mean(dataset.lines.power)) < 0.6  # 0.3 dB of scatter, 8 sweeps: 4 std
    np.testing.assert_allclose(np.mean(again.lines.range), np.mean(dataset.lines.range), atol=0.05)


def test_refined_scenario_reproduces_a_recording(practice, tmp_path):
    """Same sweeps, settings, conditions; distances, powers, noise and beat sums the same but for chance."""
    again = read_dataset_again(practice, tmp_path)
    assert again.sweeps == practice.sweeps
    assert np.array_equal(again.setting, practice.setting)
    assert np.array_equal(again.group, practice.group)
    assert np.abs(again.stamp - practice.stamp).max() < 2000  # [ns]; the recording's are of that resolution
    for one, other in zip(again.calibration, practice.calibration, strict=True):
        assert dataclasses.replace(one, stamp=0, frame_id='') == dataclasses.replace(other, stamp=0, frame_id='')
    np.testing.assert_allclose(again.board_temperature, practice.board_temperature, atol=1e-6)
    # reported with 0.2 K of noise in 15 readings each; a linear change half a pause wide would show as kelvins
    assert np.abs(again.temperature - practice.temperature).max() < 1.0
    shift = group_means(again.distance - practice.distance, practice)
    assert np.abs(shift).max() < 5 * 0.005 / np.sqrt(24)  # 14 means of 24 readings: chance 8e-6
    # 336 sweeps: 0.015 dB of standard deviation in the difference of powers, 0.03 dB in that of densities
    assert np.abs(np.mean(again.lines.power - practice.lines.power, axis=1)).max() < 0.1
    assert np.abs(np.mean(again.lines.noise_density - practice.lines.noise_density, axis=1)).max() < 0.2
    # beat sums as ranges: means of 24 sweeps, the reference's noise in the distance, humidity known to 1 % (1 ppm)
    difference = group_means(again.lines.range - practice.lines.range, practice)
    variance = group_means(again.lines.range_std**2 + practice.lines.range_std**2 + 0.005**2, practice) / 24
    variance += (1.5e-6 * group_means(practice.distance, practice)) ** 2
    assert scipy.stats.chi2.sf(np.sum(difference**2 / variance), len(difference)) > 1e-5
    scatter = [
        np.sum((d.lines.range - group_means(d.lines.range, d)[d.group]) ** 2 / d.lines.range_std**2)
        for d in (again, practice)
    ]
    assert 1e-5 < scipy.stats.f.cdf(scatter[0] / scatter[1], 322, 322) < 1 - 1e-5
    # single lines scatter with T_off (2 ns) and amplitude (0.2 dB): 322 degrees of freedom each, 4.4 deviations
    for name in ('frequency', 'power'):
        spread = [
            getattr(d.lines, name) - group_means(getattr(d.lines, name), d)[:, d.group] for d in (again, practice)
        ]
        ratio = np.sum(spread[0] ** 2, axis=1) / np.sum(spread[1] ** 2, axis=1)
        assert np.all((ratio > 0.6) & (ratio < 1.6)), name


def test_refined_scenario_moves_as_recorded(tmp_path):
    """A moving crane's reference moves on in the simulation, and its speed is the effect's."""
    moving = read_dataset(DATA / 'recording_5')
    velocities = moving.velocity[::24].tolist()
    again = read_dataset_again(moving, tmp_path, [('target_motion', None, {'velocity': velocities})])
    np.testing.assert_allclose(again.velocity, moving.velocity, atol=6 * np.sqrt(2) * 0.0074)
    # both show the Doppler shift, up to 62 mm for 1.6 m/s: the chain corrects it by the same velocity once it tracks
    errors = [group_means(d.lines.range - d.reference, d) for d in (again, moving)]
    assert np.abs(errors[0] - errors[1]).max() < 0.015


STOPS = {
    'distances': [80.0, 80.0, 700.0],
    'steps': [0.0, 0.01, 0.0],
    'sweeps': [8, 10, 6],
    'pauses': [0.0, 4.0, 3.0],
    'modes': [0, 0, 1],
    'start_delays': [3.41e-6, 2.5e-6, 0.6e-6],
}


@pytest.mark.parametrize(
    'effects',
    [
        [],
        [('reference_offset', None, {'offset': 0.7})],
        [('reference_scale', None, {'scale': 500.0}), ('reference_lag', None, {'lag': 0.3})],
        [('delay_offset', None, {'delay': 3.0}), ('reference_clock_offset', 'slave', {'deviation': 4.0})],
    ],
    ids=['none', 'offset', 'scale and lag', 'no error of the reference'],
)
def test_effects_on_the_reference_are_taken_out_of_the_distance(tmp_path, effects):
    """The scenario made of a recording has the true distances, modes and T_off, if the effects are the true ones."""
    listed = [{'effect': e} | ({'station': s} if s else {}) | p for e, s, p in effects]
    timing = {'sweep_interval': 0.1}
    scenario = scene({'recorded': STOPS}, effects=listed, timing=timing, weather=EXACT_WEATHER)
    dataset = read_dataset(record(scenario, tmp_path / 'r'))
    assert [(s[0].mode, s[0].start_delay) for s in dataset.sweeps] == [(0, 3.41e-6), (0, 2.5e-6), (1, 0.6e-6)]
    made = scenario_mapping(dataset, effects)
    again = scenario_from_mapping(made, 'test')
    assert isinstance(again.pairs[0].trajectory, Recorded)
    trajectory = again.pairs[0].trajectory
    assert {f: getattr(trajectory, f) for f in ('sweeps', 'modes', 'start_delays')} == {
        f: STOPS[f] for f in ('sweeps', 'modes', 'start_delays')
    }
    np.testing.assert_allclose(true_distances(again), true_distances(scenario), atol=2e-6)
    assert [e['effect'] for e in made['effects']] == [e for e, _, _ in effects]
    assert yaml.safe_load(yaml.safe_dump(made)) == made


def test_what_no_scenario_can_express_is_refused(standing, tmp_path):
    """One line says what: another bandwidth half-way, an effect or a value that the simulator does not know."""

    def widen(topic, message):
        if topic.endswith('sweep_config') and message.mode == Mode.LONG_DISTANCE:
            message.bandwidth = 100e6

    dataset = read_dataset(changed(standing, tmp_path / 'r', change=widen))
    with pytest.raises(ConfigurationError, match='bandwidth of'):
        scenario_mapping(dataset)
    dataset = read_dataset(standing)
    for effect, words in ((('ecko', None, {}), "'echo'"), (('spur', 'master', {'level': -60.0}), 'frequency')):
        with pytest.raises(ConfigurationError, match=words):
            write_scenario(tmp_path / 'f.yaml', dataset, [effect])
    assert not (tmp_path / 'f.yaml').exists()


def test_one_line_states_the_delay(practice):
    """The distance of one station alone is where its nominal line would be (eqs. 1-4), in both modes and roles."""
    for i in range(2):
        alone = dataclasses.replace(
            practice, samples=tuple(s if j == i else None for j, s in enumerate(practice.samples))
        )
        delay = practice.nominal(practice.setting == 0).paths[0].delay[0]
        sweep = practice.sweeps[0][i]
        expected = beat_frequency(sweep, delay, 1.0, 1.0)
        assert abs(expected - alone.lines.frequency[i, 0]) < 5 * 2e-9 * sweep.chirp_rate  # scatter of T_off
        # 336 sweeps of which T_off scatters by 2 ns: 0.6 m
        assert np.abs(alone.lines.range - practice.reference).max() < 5 * 0.6
        assert abs(np.mean(alone.lines.range - practice.reference)) < 5 * 0.6 / np.sqrt(336)
