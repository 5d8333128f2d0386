"""Replay and info from the command line: accuracy on recordings made by another hand, and answers to bad input."""

import csv
import dataclasses
import json
import math
import re
import shutil
import struct
import subprocess
import sys

import numpy as np
import pytest
from checkout import DATA, SHARED

from drfmcw_fusion import offline, replay
from drfmcw_fusion.offline import replay_recording
from drfmcw_fusion.pipeline import RangeResult
from drfmcw_fusion.replayed.statistics import reference_at, setting_statistics
from drfmcw_fusion.replayed.verification import compare, recorded_ranges
from drfmcw_fusion.settings import FusionSettings
from drfmcw_ros.bag.files import BagReader, BagWriter
from drfmcw_sim.recording import to_rosbags

STANDING = DATA / 'recording_0'
MOVING = DATA / 'recording_5'
REAL = SHARED / 'real'
RANGE = 'drfmcw_msgs/msg/RangeEstimate'
MODULES = {'replay': 'drfmcw_fusion.replay', 'info': 'drfmcw_ros.bag.info'}


def run(name, *arguments):
    """Run a subcommand; return (exit status, stdout, stderr)."""
    command = [sys.executable, '-m', MODULES[name], *map(str, arguments)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=100)
    return ended.returncode, ended.stdout, ended.stderr


def refused(module, *arguments):
    """Run a command line with wrong input: status 2, nothing printed but one line on stderr, which is returned."""
    status, out, err = run(module, *arguments)
    assert status == 2, err
    assert out == ''
    assert re.fullmatch(rf'drfmcw {module}: [^\n]+\n', err), err
    return err.strip()


@pytest.fixture
def refused_here(capfd):
    """As `refused` for replay, within this process, which spares starting another."""

    def call(*arguments):
        try:
            status = replay.main([str(a) for a in arguments])
        except SystemExit as ended:
            status = ended.code
        out, err = capfd.readouterr()
        assert status == 2, err
        assert 'note: ' in out or out == ''
        assert re.fullmatch(r'drfmcw replay: [^\n]+\n', err), err
        return err.strip()

    return call


def copy(source, path, storage='mcap', leave_out=lambda topic: False):
    """Copy a recording without some topics."""
    with BagReader(source) as bag, BagWriter(path, storage) as writer:
        for topic, time, kind, raw in bag.raw_messages():
            if not leave_out(topic):
                writer.write(topic, kind, time, raw)
    return path


@pytest.fixture(scope='module')
def standing():
    return replay_recording(str(STANDING))


@pytest.fixture(scope='module')
def outputs(tmp_path_factory):
    """All files that one call of replay writes."""
    place = tmp_path_factory.mktemp('replay')
    kinds = ('json', 'csv', 'results', 'plot')
    files = {kind: place / f'{kind}.{"png" if kind == "plot" else "out"}' for kind in kinds}
    status, out, err = run('replay', STANDING, *(a for kind in kinds for a in (f'--{kind}', files[kind])))
    assert (status, err) == (0, '')
    return out, files


# --- the numbers promised ---


def test_every_distance_is_right(outputs):
    """Bias at most 1 mm + 3 std/sqrt(n) everywhere, 15 mm rms beyond 900 m; a fixed recording, so nothing is random."""
    _, files = outputs
    rows = json.loads(files['json'].read_text())
    assert len(rows) == 14
    assert all(row['n'] == 24 and row['excluded'] == 0 for row in rows)
    assert [row['mode'] for row in rows] == ['SD' if row['reference'] < 640 else 'LD' for row in rows]
    assert {row['mode'] for row in rows} == {'SD', 'LD'}
    for row in rows:
        assert abs(row['bias']) <= 1e-3 + 3 * row['std'] / math.sqrt(row['n']), row
    far = [row['std'] ** 2 for row in rows if row['reference'] > 900]
    assert math.sqrt(np.mean(far)) <= 15e-3


def test_reported_standard_deviation_is_true(standing):
    """Errors, relative to what range and reference say of themselves, scatter by one."""
    truth = reference_at(standing.reference, np.array([r.stamp for r in standing.results]))
    errors = np.array([r.range for r in standing.results]) - truth
    stds = np.hypot([r.range_std for r in standing.results], 5e-3)
    assert len(errors) == 336
    # 336 errors: the reduced chi-square scatters by sqrt(2/336) = 0.077
    assert np.mean((errors / stds) ** 2) == pytest.approx(1.0, abs=4 * 0.077)


def test_movement_is_corrected():
    """The Doppler shift of a moving crane costs centimetres; tracked, it is gone."""
    bias = {}
    for velocity in ('tracked', 'standing'):
        found = replay_recording(str(MOVING), fusion=FusionSettings(velocity=velocity))
        rows = setting_statistics(found.results, found.reference)
        assert [row.n for row in rows] == [24] * 14
        bias[velocity] = np.abs([row.bias for row in rows])
    assert bias['standing'].max() > 0.05
    assert np.sqrt(np.mean(bias['tracked'] ** 2)) < np.sqrt(np.mean(bias['standing'] ** 2)) / 5
    assert bias['tracked'].max() < 0.01


@pytest.mark.skipif(not REAL.exists(), reason='real recordings are not in the repository')
@pytest.mark.parametrize('name', ['gmr_cableCorto_226_260', 'gmr_cableCorto_230_255'])
def test_real_radar_on_a_cable_of_100_ns(name):
    """One station that hears itself, without reference or weather: the report states the delay and what is missing."""
    status, out, err = run('replay', REAL / name, '--json', '-')
    assert status == 0
    assert [row['delay'] for row in json.loads(out)] == [pytest.approx(100e-9, abs=1e-9)]
    assert json.loads(out)[0]['bias'] is None
    assert 'note: /reference/range is missing: no error against a reference is known' in err
    status, out, err = run('replay', REAL / name)
    assert (status, err) == (0, '')
    assert '/reference/range is missing' in out
    assert 'path delay' in out
    assert 'no reference to compare with' in out


# --- what is written ---


def test_outputs_agree_with_each_other(outputs, standing):
    """Table, JSON, CSV and single ranges are the same numbers, to the last bit where they are files."""
    out, files = outputs
    rows = json.loads(files['json'].read_text())
    with files['csv'].open(newline='') as file:
        table = list(csv.DictReader(file))
    assert list(table[0]) == list(rows[0])
    for row, line in zip(rows, table, strict=True):
        assert {k: float(line[k]) for k in ('reference', 'n', 'bias', 'std', 'range', 'range_std')} == {
            k: row[k] for k in ('reference', 'n', 'bias', 'std', 'range', 'range_std')
        }
        assert (line['mode'], line['pair']) == (row['mode'], 'master/slave')
        shown = f'{row["mode"]} {row["reference"]:.3f} 24 {row["bias"] * 1e3:+.2f} {row["std"] * 1e3:.2f}'
        assert shown in ' '.join(out.split())
    with files['results'].open(newline='') as file:
        ranges = list(csv.DictReader(file))
    assert list(ranges[0]) == [f.name for f in dataclasses.fields(RangeResult)]
    assert [(int(r['sweep_id']), float(r['range'])) for r in ranges] == [
        (r.sweep_id, r.range) for r in standing.results
    ]


def test_plot_is_a_picture(outputs, tmp_path):
    _, files = outputs
    data = files['plot'].read_bytes()
    assert data[:8] == b'\x89PNG\r\n\x1a\n'
    width, height = struct.unpack('>II', data[16:24])
    assert width > 500
    assert height > 400
    status, _, _ = run('replay', MOVING, '--plot', tmp_path / 'plot.svg')
    assert status == 0
    assert '<svg' in (tmp_path / 'plot.svg').read_text()


@pytest.mark.parametrize('option', ['--json', '--csv', '--results'])
def test_data_on_stdout_is_alone_there(option):
    status, out, err = run('replay', MOVING, option, '-')
    assert status == 0
    assert 'rms error' in err, 'table and summary stand aside'
    if option == '--json':
        assert len(json.loads(out)) == 14
    else:
        lines = out.splitlines()
        assert len(lines) == 1 + (14 if option == '--csv' else 336)
        assert {line.count(',') for line in lines} == {lines[0].count(',')}


def test_range_is_the_sum_of_what_is_listed(standing):
    """The corrections listed with each range lead from the uncorrected range to it."""
    for r in standing.results:
        corrections = r.alpha_correction + r.atmosphere_correction + r.delay_correction + r.velocity_correction
        assert r.range == pytest.approx(r.uncorrected_range + corrections, abs=1e-9)


# --- same samples, same bits ---


@pytest.mark.parametrize('chunk', [1, 7])
def test_ranges_do_not_depend_on_the_batch(standing, monkeypatch, chunk):
    monkeypatch.setattr(offline, '_CHUNK', chunk)
    assert sorted(map(repr, replay_recording(str(STANDING)).results)) == sorted(map(repr, standing.results))


def test_sqlite3_recording_gives_the_same_ranges(tmp_path, standing):
    found = replay_recording(str(copy(STANDING, tmp_path / 'run', 'sqlite3')))
    assert list(map(repr, found.results)) == list(map(repr, standing.results))


def test_single_file_is_a_recording(standing, tmp_path):
    shutil.copy(STANDING / 'recording_0.mcap', tmp_path / 'lone.mcap')
    found = replay_recording(str(tmp_path / 'lone.mcap'))
    assert list(map(repr, found.results)) == list(map(repr, standing.results))


def test_verify_finds_a_single_bit(standing, tmp_path):
    """Recorded ranges that equal the recomputed ones give status 0; one that differs in its last bit gives 1."""
    for name, changed in (('same', None), ('other', 17)):
        with BagReader(STANDING) as bag, BagWriter(tmp_path / name) as writer:
            for topic, time, kind, raw in bag.raw_messages():
                writer.write(topic, kind, time, raw)
            for i, result in enumerate(standing.results):
                if i == changed:
                    result = dataclasses.replace(result, range=math.nextafter(result.range, math.inf))
                writer.write('/master/slave/range', RANGE, result.stamp + 1, to_rosbags(result, RANGE))
    with BagReader(tmp_path / 'other') as bag:
        found = compare(recorded_ranges(bag), standing.results)
    assert (found.identical, found.different, found.only_recorded, found.only_recomputed) == (335, 1, 0, 0)
    assert 0 < found.largest_difference < 1e-12
    status, out, _ = run('replay', tmp_path / 'same', '--verify')
    assert status == 0
    assert '336 identical bit by bit, 0 different, 0 only in the recording, 0 only recomputed' in ' '.join(out.split())
    status, out, _ = run('replay', tmp_path / 'other', '--verify')
    assert status == 1
    assert '335 identical bit by bit, 1 different' in ' '.join(out.split())


# --- recordings that lack something ---


@pytest.mark.parametrize(
    ('topic', 'loss'),
    [('/reference/range', math.inf), ('/site/temperature', 0.05), ('/site/humidity', 0.05), ('/slave/calibration', 5)],
)
def test_what_is_missing_is_said(tmp_path, topic, loss):
    """Without an optional topic the ranges still come, with a note, and within what is then unknown [m]."""
    path = copy(MOVING, tmp_path / 'run', leave_out=lambda t: t == topic)
    found = replay_recording(str(path))
    assert [line for line in found.missing if line.startswith(f'{topic} is missing: ')] == found.missing
    assert len(found.missing) == 1
    assert len(found.results) == 336
    rows = setting_statistics(found.results, found.reference)
    assert all(abs(row.bias or 0.0) < loss for row in rows)
    assert (rows[0].bias is None) == (topic == '/reference/range')
    status, out, err = run('info', path)
    assert (status, err) == (0, '')
    assert f'note: {topic} is missing' in out


def test_one_station_alone_gives_no_range(refused_here):
    assert 'no range could be computed from 336 sweeps' in refused_here(STANDING, '--station', 'master')


def test_info_lists_what_is_there():
    status, out, err = run('info', STANDING, '--json')
    assert (status, err) == (0, '')
    found = json.loads(out)
    assert found['stations'] == ['master', 'slave']
    assert found['messages'] == 1084
    assert found['topics']['/master/if_samples'] == {'type': 'drfmcw_msgs/msg/IfSamples', 'messages': 336}
    assert found['missing'] == []
    assert [(s['station'], s['mode']) for s in found['sweep_configs']] == [
        ('master', 0), ('slave', 0), ('master', 1), ('slave', 1),
    ]  # fmt: skip
    assert {c['station']: c['delay'] for c in found['calibrations']} == {'master': 12e-9, 'slave': 15e-9}
    status, out, err = run('info', STANDING)
    assert (status, err) == (0, '')
    assert '/master/if_samples' in out


# --- bad input ---


def test_recording_cut_off_is_read_as_far_as_it_is_whole(tmp_path):
    """How much that is stands on stderr; the ranges are those of the whole recording up to there."""
    shutil.copytree(STANDING, tmp_path / 'cut')
    with open(tmp_path / 'cut' / 'recording_0.mcap', 'r+b') as file:
        file.truncate(2_500_000)
    whole = replay_recording(str(STANDING)).results
    cut = replay_recording(str(tmp_path / 'cut')).results
    assert 0.5 * len(whole) < len(cut) < len(whole)
    assert cut == whole[: len(cut)]
    for module in ('replay', 'info'):
        status, _, err = run(module, tmp_path / 'cut')
        assert status == 0
        assert 'of 2500000 bytes are whole' in err


@pytest.mark.parametrize('module', ['replay', 'info'])
def test_unreadable_recording(module, tmp_path):
    assert refused(module, tmp_path / 'none').endswith('none: no such recording')
    assert 'no rosbag2 recording' in refused(module, tmp_path)
    (tmp_path / 'notes.mcap').write_text('no recording')
    assert 'notes.mcap' in refused(module, tmp_path / 'notes.mcap')
    refused(module)


@pytest.mark.parametrize(
    ('ending', 'said'),
    [('/if_samples', "holds no '/<station>/if_samples'"), ('/sweep_config', "topic '/master/sweep_config' is missing")],
)
def test_recording_without_what_is_needed(tmp_path, ending, said):
    path = copy(STANDING, tmp_path / 'run', leave_out=lambda topic: topic.endswith(ending))
    assert said in refused('replay', path)
    if ending == '/if_samples':
        assert said in refused('replay', path, '--publish')


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (('--station', 'mastr'), "unknown station 'mastr'; did you mean 'master'?"),
        (('--bin', '0'), '--bin = 0 m must be above zero'),
        (('--bin', 'nan'), '--bin = nan m must be above zero'),
        (('--bin', 'wide'), "argument --bin: invalid float value: 'wide'"),
        (('--window', 'han'), "window: 'han' is not valid; did you mean 'hann'?"),
        (('--atmosphere', 'thick'), "argument --atmosphere: invalid choice: 'thick'"),
        (('--config', '/nowhere.yaml'), '/nowhere.yaml: No such file or directory'),
        (('--publish', '--rate', '-1'), '--rate -1'),
        (('--publish', '--rate', 'nan'), '--rate nan'),
        (('--publish', '--loop', '-1'), '--loop -1'),
        (('--jsn', 'x'), 'unrecognized arguments: --jsn x'),
    ],
)
def test_wrong_option(refused_here, options, said):
    assert said in refused_here(STANDING, *options)


@pytest.mark.parametrize('option', ['--json', '--csv', '--results', '--plot'])
def test_output_that_cannot_be_written(option):
    status, _, err = run('replay', STANDING, option, '/nowhere/file')
    assert (status, err) == (2, 'drfmcw replay: /nowhere/file: No such file or directory\n')


def test_recording_without_ranges_cannot_be_verified():
    status, _, err = run('replay', STANDING, '--verify')
    assert (status, err) == (2, f'drfmcw replay: {STANDING}: holds no RangeEstimate topic to compare with\n')


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('estimator: {windw: hann}', "estimator: unknown key 'windw'; did you mean 'window'?"),
        ('fusion: {velocty: tracked}', "fusion: unknown key 'velocty'; did you mean 'velocity'?"),
        ('fuson: {}', "unknown key 'fuson'; did you mean 'fusion'?"),
        ('1: {}', "unknown key '1'"),
        ('{1: {}, fuson: {}}', 'unknown key'),
        ('estimator: {weak_threshold: .nan}', 'weak_threshold must be a number, not NaN'),
        ('estimator: {weak_threshold: .inf}', 'weak_threshold = inf dB is outside 0 ... 100 dB'),
        ('estimator: {weak_threshold: many}', "weak_threshold must be a number, not 'many'"),
        ('estimator: {zoom_points: 5.5}', 'zoom_points must be a whole number'),
        ('estimator: {minimum_frequency: 1e6, maximum_frequency: 1e3}', 'minimum_frequency = 1e+06 Hz is not below'),
        ('estimator: 3', 'expected a mapping of settings, not 3'),
        ('fusion: [1, 2]', 'expected a mapping of settings, not [1, 2]'),
        ('fusion: {default_pressure: 5}', 'default_pressure = 5 Pa is outside 30000 ... 120000 Pa'),
        ('fusion: {velocity: sometimes}', "velocity: 'sometimes' is not valid"),
        ('fusion: {velocity: tracked}\nfusion: {}', "key 'fusion' is given twice"),
        ('fusion: {velocity', 'line 1'),
        ('- fusion', 'expected a mapping'),
        ('', 'expected a mapping'),
    ],
)
def test_wrong_configuration_file(refused_here, tmp_path, text, said):
    """Key or value, the file it stands in, and the nearest valid key."""
    path = tmp_path / 'site.yaml'
    path.write_text(text)
    line = refused_here(STANDING, '--config', path)
    assert str(path) in line
    assert said in line


def test_configuration_file_takes_effect(tmp_path):
    """Settings of both sections arrive; vacuum is longer than air by 0.3 m in 1000 m."""
    (tmp_path / 'site.yaml').write_text('estimator: {window: blackman}\nfusion: {atmosphere: vacuum}')
    status, out, _ = run('replay', STANDING, '--config', tmp_path / 'site.yaml', '--json', '-')
    assert status == 0
    last = json.loads(out)[-1]
    assert last['bias'] == pytest.approx(0.29, abs=0.03)
    assert last['range_std'] > 13.5e-3, 'a wider window costs accuracy'
