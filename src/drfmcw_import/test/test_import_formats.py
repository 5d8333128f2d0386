"""Codes come back exactly from every format, and real files give the recordings that were made from them."""

import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile
import yaml

from drfmcw_import.convert.settings import RadarSettings
from drfmcw_import.formats.base import known_formats
from drfmcw_import.importing import main
from drfmcw_import.look.sweeps import read_sweeps
from drfmcw_physics.settings import from_mapping
from drfmcw_ros.bag.files import BagReader

sys.path.insert(0, str(Path(__file__).parent))
import import_cases as cases

ROOT = Path(__file__).parents[3]
SHARED = next((p for p in (ROOT / '../shared', ROOT / '../../shared') if p.exists()), Path('nowhere'))
REAL = SHARED / 'recordings/real'


def imported(tmp_path, paths, settings, *more):
    """Return the exit status of an import into tmp_path / 'out'."""
    written = settings if isinstance(settings, Path) else cases.settings_file(tmp_path, settings)
    return main([*map(str, paths), '--settings', str(written), '--out', str(tmp_path / 'out'), *more])


@pytest.mark.parametrize('case', cases.CASES, ids=lambda c: c.name)
def test_codes_come_back_exactly(case, tmp_path):
    paths, settings, expected = case.write(tmp_path)
    assert imported(tmp_path, paths, settings) == 0
    (data,) = read_sweeps(tmp_path / 'out')
    assert data.sweep.hears_itself
    np.testing.assert_array_equal(data.samples, expected)
    assert (np.diff(data.stamps) > 0).all() and data.sweep.sample_count == expected.shape[1]


def test_every_format_is_tried():
    tried = {c.write for c in cases.CASES}
    names = ' '.join(sorted(w.__name__ for w in tried))
    shorts = {'numpy': 'npy', 'text': 'csv'}
    for name in known_formats():
        assert shorts.get(name, name) in names, name


def test_blocks_do_not_change_the_codes(tmp_path, monkeypatch):
    """A file read in pieces of one chirp is the file."""
    monkeypatch.setattr('drfmcw_import.convert.layout._AT_ONCE', 1)
    paths, settings, expected = cases.hdf5_receivers_averaged(tmp_path)
    assert imported(tmp_path, paths, settings) == 0
    np.testing.assert_array_equal(read_sweeps(tmp_path / 'out')[0].samples, expected)


@pytest.mark.parametrize('axis', [False, True], ids=['one ramp behind the other', 'axis ramp'])
def test_triangle_gives_a_station_for_each_ramp(axis, tmp_path):
    own = cases.codes()
    stored = own[:, 0, :, 0].reshape(cases.SWEEPS, 2, -1)
    np.save(tmp_path / 'a.npy', stored if axis else stored.reshape(cases.SWEEPS, -1))
    layout = {'axes': ['chirp', 'ramp', 'sample'] if axis else ['chirp', 'sample']}
    settings = {'radar': cases.RADAR | {'ramp': 'triangle'}, 'layout': layout, 'samples': {'bits': 12}}
    assert imported(tmp_path, [tmp_path / 'a.npy'], settings) == 0
    down, up = read_sweeps(tmp_path / 'out')
    assert (up.sweep.station, down.sweep.station) == ('up', 'down')
    np.testing.assert_array_equal(up.samples[..., 0], stored[:, 0])
    np.testing.assert_array_equal(down.samples[..., 0], stored[:, 1])
    # the falling ramp begins where the rising one ends, and in time one ramp later
    assert down.sweep.bandwidth == -up.sweep.bandwidth
    assert down.sweep.start_frequency == up.sweep.start_frequency + up.sweep.bandwidth
    assert (down.stamps - up.stamps == 1_000_000).all()


def test_a_later_first_sample_moves_the_start_and_not_the_rate():
    values = {'start_frequency': 77e9, 'rate': 30e12, 'ramp_duration': 27e-6, 'sample_rate': 20e6, 'first_sample': 2e-6}
    (sweep,) = from_mapping(RadarSettings, values, 'test').sweeps(500)
    assert sweep.start_frequency == pytest.approx(77e9 + 60e6)
    assert sweep.ramp_duration == pytest.approx(25e-6)
    assert sweep.chirp_rate == pytest.approx(30e12)


def test_wav_reports_jitter_below_a_sample(tmp_path, capsys):
    """Edges at instants between samples: a band-limited edge crosses its middle there."""
    import soundfile

    rng = np.random.default_rng(3)
    instants = 50.0 + 120.0 * np.arange(200) + rng.normal(0.0, 0.3, 200)
    t = np.arange(120 * 201 + 50)
    sync = np.full(len(t), -1.0)
    for begin in instants:  # an edge that takes four samples
        near = slice(int(begin) - 10, int(begin) + 60)
        sync[near] = np.clip((t[near] - begin) / 2.0, -1.0, 1.0) * np.where(t[near] > begin + 40, -1.0, 1.0)
    track = np.stack([np.zeros(len(t)), 0.8 * sync], axis=1)
    track[:, 0] = 0.5 * np.sin(0.7 * t)
    soundfile.write(tmp_path / 'a.wav', track, 48000, subtype='PCM_24')
    radar = {k: v for k, v in cases.RADAR.items() if k != 'sample_rate'}
    settings = {'radar': radar, 'options': {'sweep_duration': 64 / 48000}}
    assert imported(tmp_path, [tmp_path / 'a.wav'], settings) == 0
    said = capsys.readouterr().out
    assert '200 rising edges' in said and 'channel 1 switches' in said
    jitter = float(said.split('they jitter by ')[1].split(' samples')[0])
    assert 0.24 < jitter < 0.36  # 0.3 with 200 draws: 4 standard deviations, false in 1 of 15 000; the seed is fixed
    stamps = read_sweeps(tmp_path / 'out')[0].stamps
    assert np.abs((stamps - stamps[0]) * 48e-6 - (instants - instants[0])).max() < 0.02  # stamps keep the fractions


def test_a_channel_that_holds_no_sync_is_refused(tmp_path, capsys):
    paths, settings, _ = cases.wav_with_sync(tmp_path)
    track, rate = soundfile.read(str(paths[0]), dtype='int16')
    for n, turns in enumerate((3.1, 5.2, 7.3, 9.4, 11.5, 13.6)):  # the IF of a target that moves
        track[37 + 100 * n :][:100, 0] = 9000 * np.sin(2 * np.pi * turns * np.arange(100) / 100)
    soundfile.write(str(paths[0]), track, rate, subtype='PCM_16')
    settings['options'] |= {'sync_channel': 0}
    assert imported(tmp_path, paths, settings) == 2
    said = capsys.readouterr().err
    assert 'it is no sync channel; channel 1 switches between two levels' in said and said.count('\n') == 1
    assert not (tmp_path / 'out').exists()


def test_axes_that_contradict_the_file_are_said(tmp_path, capsys):
    """The JSON file states three receivers; the axes make them two."""
    paths, settings, _ = cases.infineon(tmp_path)
    np.save(paths[0], np.load(paths[0])[:, :, :2])  # two chirps of three receivers
    settings['layout'] = {'axes': ['frame', 'chirp', 'receiver', 'sample']}
    assert imported(tmp_path, paths, settings) == 0
    said = capsys.readouterr().out
    assert 'its axes have 2 receivers, but the settings beside it state 3 receivers' in said


@pytest.mark.parametrize('kind', ['i2', 'i1'])
def test_unsigned_numbers_read_as_signed_are_named(kind, tmp_path, capsys):
    own = cases.codes(bits=8 * int(kind[1]), count=24)[:, 0, :, 0]
    unsigned = own.astype(int) + 2 ** (8 * int(kind[1]) - 1)
    (tmp_path / 'a.bin').write_bytes(unsigned.astype(f'<u{kind[1]}').tobytes())
    name = np.dtype(kind).name
    settings = {'radar': cases.RADAR, 'options': {'type': name}, 'samples': {'coding': 'offset_binary'}}
    settings['layout'] = {'axes': ['chirp', 'sample'], 'shape': [-1, cases.SAMPLES]}
    assert imported(tmp_path, [tmp_path / 'a.bin'], settings) == 2
    assert f'set options: type: u{name}' in capsys.readouterr().err
    settings['samples'] = {'coding': 'signed'}
    assert imported(tmp_path, [tmp_path / 'a.bin'], settings) == 0
    assert f'set options: type: u{name}' in capsys.readouterr().out


REAL_ORDERS = {  # wrong layouts of real files: settings, file, changes, what is said
    'receivers before samples': ('awr1243', 'awr1243_interferer.bin', 'receiver, sample, iq], shape: [-1, 4, 512, 2]',
                                 '4 sources alternate'),
    'no receivers': ('awr1243', 'awr1243_interferer.bin', 'sample, iq], shape: [-1, 512, 2]', '4 sources alternate'),
    'half a sweep': ('awr1243', 'awr1243_interferer.bin', 'sample, receiver, iq], shape: [-1, 256, 4, 2]',
                     '2 sweeps of 256 samples seem to be one'),
    'four blocks as one': ('position2go', 'p2g_saturated.txt', 'sample], shape: [-1, 256]', 'hold 4 blocks'),
    'four blocks as I and Q': ('position2go', 'p2g_saturated.txt', 'iq, sample], shape: [-1, 2, 128]', 'hold 2 blocks'),
}  # fmt: skip


@pytest.mark.skipif(not REAL.exists(), reason='no real recordings here')
@pytest.mark.parametrize('name', REAL_ORDERS)
def test_a_wrong_order_of_real_samples_is_said(name, tmp_path, capsys):
    settings, file, order, expected = REAL_ORDERS[name]
    written = yaml.safe_load((ROOT / f'config/import/{settings}.yaml').read_text())
    written['layout'] = yaml.safe_load(f'{{axes: [chirp, {order}}}')
    assert imported(tmp_path, [REAL / 'raw' / file], written) == 0
    assert any(expected in text for text in capsys.readouterr().out.splitlines() if 'warning' in text)


@pytest.mark.skipif(not REAL.exists(), reason='no real recordings here')
@pytest.mark.parametrize(
    'settings, files, bag',
    [
        ('gmr_230_255', ['cableCorto_230_255.mat'], 'gmr_cableCorto_230_255'),
        ('gmr_226_260', ['cableCorto_226_260.mat'], 'gmr_cableCorto_226_260'),
        ('openradar_awr', ['presense_simple_frame_1.npy'], 'presense_awr'),
        ('awr1243', ['awr1243_interferer.bin'], 'awr1243_interferer'),
        ('position2go', ['p2g_saturated.txt'], 'p2g_saturated'),
        ('bgt60', ['bgt60_radar.npy', 'bgt60_config.json'], None),
        ('coffeecan', ['coffeecan_single_target.wav'], None),
    ],
)
def test_real_files_give_their_recordings(settings, files, bag, tmp_path, capsys):
    path = ROOT / 'config/import' / f'{settings}.yaml'
    assert imported(tmp_path, [REAL / 'raw' / f for f in files], path) == 0
    said = capsys.readouterr().out
    warnings = [line for line in said.splitlines() if 'warning' in line]
    # saturation in two of them, a lowest bit that mostly sticks in one, wrong settings in none
    assert all('rails' in w or 'lowest bit' in w for w in warnings), warnings
    (mine,) = read_sweeps(tmp_path / 'out')
    if bag is None:
        return
    (theirs,) = read_sweeps(REAL / bag)
    np.testing.assert_array_equal(mine.samples, theirs.samples)
    assert (mine.full_scale, mine.iq) == (theirs.full_scale, theirs.iq)
    for key in ('start_frequency', 'bandwidth', 'ramp_duration', 'sample_rate', 'sample_count', 'mode', 'role'):
        assert getattr(mine.sweep, key) == pytest.approx(getattr(theirs.sweep, key), rel=1e-4), key
    with BagReader(tmp_path / 'out') as bag_of_mine, BagReader(REAL / bag) as bag_of_theirs:
        assert bag_of_mine.topics == bag_of_theirs.topics


def broken(**changes):
    """Return the settings of npy_real with sections changed."""
    base = {'radar': dict(cases.RADAR), 'samples': {'bits': 12}, 'layout': {'axes': ['chirp', 'sample']}}
    for section, values in changes.items():
        base[section] = {**base.get(section, {}), **values} if isinstance(values, dict) else values
    return base


@pytest.mark.parametrize(
    'settings, said',
    [
        (broken(radar={'bandwith': 1e6}), "radar: unknown key 'bandwith'; did you mean 'bandwidth'?"),
        (broken(radio={}), "unknown key 'radio'; did you mean 'radar'?"),
        (broken(radar={'rate': 1e12}), 'one of bandwidth and rate is needed, both are given'),
        (broken(radar={'start_time': 'noon'}), "start_time 'noon' is no time like"),
        (broken(layout={'axes': ['chrip', 'sample']}), "axes[0]: 'chrip' is not valid; did you mean 'chirp'?"),
        (broken(layout={'axes': ['frame', 'chirp', 'sample']}), 'is an array of 6x64, which needs 2 axes'),
        (broken(layout={'axes': ['chirp', 'sample'], 'shape': [-1, 50]}), 'no multiple of 50'),
        (broken(layout={'sample_count': 100}), 'sweeps have 64 samples'),
        (broken(layout={'receiver': 1}), 'receiver = 1, but the file has 1'),
        (broken(samples={'bits': 8}), 'set bits: 12'),
        (broken(samples={'coding': 'offset_binary'}), 'set coding: signed'),
        (broken(samples={'coding': 'signd'}), "coding: 'signd' is not valid; did you mean 'signed'?"),
        (broken(options={'arry': 'x'}), "options: unknown key 'arry'; did you mean 'array'?"),
        (broken(format='nunpy'), "format: 'nunpy' is not valid; did you mean 'numpy'?"),
        (broken(format='infineon'), 'needs one .json file'),
        (broken(format='hdf5', layout={}), 'no HDF5 file'),
        (broken(format='apres'), 'no burst header'),
        (broken(format='wav'), 'no WAV file'),
        (broken(format='matlab'), 'no MATLAB file'),
        (broken(format='zarr'), 'no zarr store'),
        (broken(format='sigmf'), 'No such file'),
    ],
    ids=lambda v: v[:40] if isinstance(v, str) else '',
)
def test_wrong_settings_get_one_line_and_leave_nothing(settings, said, tmp_path, capsys):
    paths, _, _ = cases.npy_real(tmp_path)
    assert imported(tmp_path, paths, settings) == 2
    error = capsys.readouterr().err
    assert said in error and error.count('\n') == 1 and error.startswith('drfmcw import: ')
    assert sorted(p.name for p in tmp_path.iterdir()) == ['a.npy', 'settings.yaml']


def test_a_truncated_file_leaves_nothing(tmp_path, capsys):
    paths, settings, _ = cases.apres(tmp_path)
    paths[0].write_bytes(paths[0].read_bytes()[:-10])
    assert imported(tmp_path, paths, settings) == 2
    assert 'truncated in burst 1' in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()
