"""Export gives the samples back; the page shows what is there, for pairs and for one station that hears itself."""

import csv
import html
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from drfmcw_import.exporting import main as export
from drfmcw_import.importing import main as run_import
from drfmcw_import.look import measures
from drfmcw_import.look.sweeps import read_sweeps
from drfmcw_import.viewing import main as view

sys.path.insert(0, str(Path(__file__).parent))
import import_cases as cases

PAIR = Path(__file__).parents[3] / 'test/data/recording_0'


def recording(tmp_path, case):
    paths, settings, expected = case(tmp_path)
    written = cases.settings_file(tmp_path, settings)
    assert run_import([*map(str, paths), '--settings', str(written), '--out', str(tmp_path / 'bag')]) == 0
    return str(tmp_path / 'bag'), expected


@pytest.mark.parametrize('case', [cases.npy_real, cases.hdf5_flat], ids=['real', 'iq'])
def test_export_round_trip(case, tmp_path):
    bag, expected = recording(tmp_path, case)
    assert export([bag, '--out', str(tmp_path / 'x.npz')]) == 0
    with np.load(tmp_path / 'x.npz') as content:
        np.testing.assert_array_equal(content['radar_samples'].reshape(expected.shape), expected)
        assert (content['radar_full_scale'] == 2048).all() and (content['radar_sweep_id'] == np.arange(6)).all()
        assert (content['radar_stamp'] == read_sweeps(bag)[0].stamps).all()
    assert export([bag, '--out', str(tmp_path / 'x.csv')]) == 0
    with open(tmp_path / 'x.csv', newline='') as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_array_equal([int(r['i']) for r in rows], expected[..., 0].ravel())
    if expected.shape[2] == 2:
        np.testing.assert_array_equal([int(r['q']) for r in rows], expected[..., 1].ravel())


def test_export_to_parquet_or_one_line_without_pyarrow(tmp_path, capsys):
    bag, expected = recording(tmp_path, cases.npy_real)
    capsys.readouterr()
    status = export([bag, '--out', str(tmp_path / 'x.parquet')])
    try:
        import pyarrow.parquet
    except ImportError:
        assert status == 2 and 'pyarrow, which is not installed' in capsys.readouterr().err
        assert not list(tmp_path.glob('*.parquet*'))
        return
    table = pyarrow.parquet.read_table(tmp_path / 'x.parquet').to_pydict()
    np.testing.assert_array_equal(table['samples'], expected[..., 0])


@pytest.mark.parametrize(
    'arguments, said',
    [
        (['--out', 'x.txt'], "'.txt' is no format of export"),
        (['--out', 'x.npz', '--station', 'rader'], "unknown station 'rader'; did you mean 'radar'?"),
        (['--out', 'missing/x.npz'], 'No such file or directory'),
    ],
)
def test_export_refuses_in_one_line(arguments, said, tmp_path, capsys, monkeypatch):
    bag, _ = recording(tmp_path, cases.npy_real)
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    before = sorted(tmp_path.iterdir())
    assert export([bag, *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count('\n') == 1
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize('case', [cases.npy_real, cases.hdf5_flat], ids=['real', 'iq'])
def test_page_holds_every_picture_and_nothing_from_outside(case, tmp_path):
    bag, _ = recording(tmp_path, case)
    page = tmp_path / 'page.html'
    assert view([bag, '--out', str(page)]) == 0
    text = page.read_text()
    assert not re.search(r'(src|href)="(?!data:image/png;base64,)', text) and '<script' not in text
    titles = [html.unescape(t) for t in re.findall(r'<h3>(.*?)</h3>', text)]
    for title in ('IF over ramp time and sweep', 'Spectrogram', 'Averaged spectrum', 'Beat frequency over ramp time'):
        assert title in titles
    assert 'Codes of the ADC' in titles and 'Power over sweeps' in titles and any('Range' in t for t in titles)
    assert 'nan' not in re.sub(r'base64,[^"]*', '', text).lower()


@pytest.mark.slow
@pytest.mark.skipif(not PAIR.exists(), reason='no recording of a pair here')
def test_page_of_a_pair_shows_both_stations_and_their_range(tmp_path):
    page = tmp_path / 'page.html'
    assert view([str(PAIR), '--out', str(page)]) == 0
    text = page.read_text()
    assert 'Station master' in text and 'Station slave' in text and 'Range over time: master/slave' in text


def test_page_of_nothing_is_one_line(tmp_path, capsys):
    assert view([str(tmp_path / 'none'), '--out', str(tmp_path / 'page.html')]) == 2
    assert capsys.readouterr().err.count('\n') == 1
    assert not (tmp_path / 'page.html').exists()


@pytest.mark.parametrize('case', [cases.npy_real, cases.hdf5_flat], ids=['real', 'iq'])
def test_the_line_is_measured_where_it_is(case, tmp_path):
    """0.11 of the sampling rate, noise 36 dB below it: a resolution cell is 1 / 64 of the rate."""
    bag, _ = recording(tmp_path, case)
    (data,) = read_sweeps(bag)
    run = measures.still_run(data)
    assert run == slice(0, 6)
    spectrum = measures.averaged(data, run)
    assert spectrum.line / data.sweep.sample_rate == pytest.approx(0.11, abs=0.001)
    assert spectrum.level == pytest.approx(20 * np.log10(0.6), abs=0.6)  # scalloping of padded bins below 0.1 dB
    assert {m.name for m in measures.marks(spectrum, data.sweep, data.iq)} >= {'0 Hz', 'Nyquist', 'line', '2×', '3×'}


def test_the_course_follows_a_bent_ramp(tmp_path):
    """A line whose frequency rises by 10 % along the sweep is seen rising by 10 %."""
    count, rate = 2000, 2e6
    t = np.arange(count) / rate
    phase = 2 * np.pi * (100e3 * t + 0.5 * 10e3 / 1e-3 * t**2)
    rng = np.random.default_rng(1)
    np.save(tmp_path / 'a.npy', np.rint(1000 * np.cos(phase + rng.uniform(0, 6, (8, 1)))).astype(np.int16))
    radar = cases.RADAR | {'sample_rate': rate}
    written = cases.settings_file(tmp_path, {'radar': radar, 'samples': {'bits': 12}})
    assert run_import([str(tmp_path / 'a.npy'), '--settings', str(written), '--out', str(tmp_path / 'bag')]) == 0
    (data,) = read_sweeps(tmp_path / 'bag')
    course = measures.ramp_course(data, slice(0, 8), 105e3)
    np.testing.assert_allclose(course.frequency, 100e3 + 1e7 * course.time, rtol=0.002)


def test_harmonics_fold_at_nyquist():
    assert measures.fold(60.0, 100.0, iq=False) == pytest.approx(40.0)
    assert measures.fold(60.0, 100.0, iq=True) == pytest.approx(-40.0)
    assert measures.fold(130.0, 100.0, iq=False) == pytest.approx(30.0)
