"""Odd recordings: importing, viewing, replaying and diagnosing end with a result or with one line, never a traceback.

Noise is drawn with a fixed seed; no assertion depends on its values.
"""

import re

import numpy as np
import pytest
import yaml

from drfmcw_diagnosis.diagnose import main as diagnose
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.recording.thinning import shortened
from drfmcw_fusion.replay import main as replay
from drfmcw_import.importing import main as run_import
from drfmcw_import.viewing import main as view

LIGHT = 299792458.0
BANDWIDTH, DURATION, START, COUNT = 500e6, 1e-3, 24e9, 400


def line(sweeps, amplitude=500.0, count=COUNT, distance=40.0):
    """Return a line as a straight ramp gives it, with white noise of one LSB (sweeps, count)."""
    rng = np.random.default_rng(4)
    delay, time = distance / LIGHT, np.arange(count) * DURATION / count
    turns = START * delay + BANDWIDTH / DURATION * (delay * time - delay**2 / 2.0)
    return np.rint(amplitude * np.cos(2.0 * np.pi * turns) + rng.normal(size=(sweeps, count)))


def impulse(sweeps):
    codes = np.zeros((sweeps, COUNT), np.int16)
    codes[:, 123] = 900
    return codes


def with_zero_sweep():
    codes = line(20)
    codes[7] = 0.0
    return codes.astype(np.int16)


def with_nan():
    codes = line(6)
    codes[2, 3] = np.nan
    return codes


full_range = np.random.default_rng(8).integers(0, 1 << 16, (6, COUNT)).astype(np.uint16)

ODD = {  # name: numbers of the file, bits (None: the type's)
    'all zero': (np.zeros((6, COUNT), np.int16), 12),
    'constant': (np.full((6, COUNT), 77, np.int16), 12),
    'one sweep': (line(1).astype(np.int16), 12),
    'two sweeps': (line(2).astype(np.int16), 12),
    'three sweeps': (line(3).astype(np.int16), 12),
    '8 bits': (line(6, 100.0).astype(np.int8), None),
    '8 bits unsigned': ((line(6, 100.0) + 128).astype(np.uint8), None),
    'unsigned over the full range': (full_range, None),
    'single impulse': (impulse(6), 12),
    'single impulse in one sweep': (impulse(1), 12),
    'one zero sweep among 20': (with_zero_sweep(), 12),
    'copies of one sweep': (np.repeat(line(1), 6, axis=0).astype(np.int16), 12),
    'few samples': (line(6, count=32).astype(np.int16), 12),
    'not a number': (with_nan(), 12),
    'text': (np.array(['a', 'b']), None),
    'no samples': (np.zeros((0, COUNT), np.int16), None),
}


def imported(folder, numbers, bits, radar=None):
    """Write numbers and settings, import them; return the exit status."""
    np.save(folder / 'odd.npy', numbers)
    usual = {'start_frequency': START, 'bandwidth': BANDWIDTH, 'ramp_duration': DURATION, 'repetition_time': 2e-3}
    settings = {'radar': usual | {'sample_rate': numbers.shape[-1] / DURATION} | (radar or {})}
    if bits is not None:
        settings['samples'] = {'bits': bits}
    (folder / 'odd.yaml').write_text(yaml.safe_dump(settings))
    written = ['--settings', str(folder / 'odd.yaml'), '--out', str(folder / 'bag')]
    return run_import([str(folder / 'odd.npy'), *written])


def tone(sweeps, count, frequency):
    """Return 12-bit codes of a line of constant frequency [cycles per sample] with noise (sweeps, count)."""
    noise = np.random.default_rng(6).normal(size=(sweeps, count))
    return np.rint(500.0 * np.cos(2.0 * np.pi * frequency * np.arange(count)) + noise).astype(np.int16)


def recorded(folder, numbers, radar):
    """Return the recording made of 12-bit numbers."""
    assert imported(folder, numbers, 12, radar) == 0
    return str(folder / 'bag')


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('name', ODD)
def test_an_odd_recording_gives_a_result_or_one_line(name, tmp_path, capsys):
    """Exit status 0 or 2, no traceback, no warning of NumPy, and no "nan" where a figure stands."""
    status = imported(tmp_path, *ODD[name])
    said = capsys.readouterr()
    assert status in (0, 2) and 'Traceback' not in said.err
    if status == 2:
        assert len(said.err.strip().splitlines()) == 1 and not (tmp_path / 'bag').exists()
        return
    bag, page = str(tmp_path / 'bag'), tmp_path / 'page.html'
    for command, arguments in (
        (view, [bag, '--out', str(page)]),
        (replay, [bag, '--estimator', 'ml', '--csv', str(tmp_path / 'x.csv'), '--plot', str(tmp_path / 'x.png')]),
        (diagnose, [bag, '--jobs', '1', '--out', str(tmp_path / 'out')]),
    ):
        status = command(arguments)
        said = capsys.readouterr()
        assert status in (0, 2), said.err
        assert not re.search(r'\bnan\b', said.out, re.IGNORECASE), said.out
        assert 'Traceback' not in said.err
        refusals = [text for text in said.err.splitlines() if text.startswith('drfmcw ')]
        assert len(refusals) == (status == 2), said.err
    assert not re.search(r'\bnan\b', page.read_text(), re.IGNORECASE)


@pytest.mark.parametrize('name', ['text', 'not a number', 'no samples'])
def test_a_file_without_numbers_is_refused(name, tmp_path, capsys):
    assert imported(tmp_path, *ODD[name]) == 2
    assert 'odd.npy: ' in capsys.readouterr().err


def test_a_sweep_without_a_line_is_left_out_and_said(tmp_path, capsys):
    assert imported(tmp_path, *ODD['one zero sweep among 20']) == 0
    capsys.readouterr()
    assert replay([str(tmp_path / 'bag'), '--estimator', 'ml']) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert 'Left out: 1 of 20 sweeps: 1 without any line.' in said


def test_an_echo_that_comes_after_the_sweep_is_refused(tmp_path, capsys):
    """A line that takes an echo of 240 us in a sweep of 200 us: the settings are wrong."""
    radar = {'bandwidth': 2e6, 'ramp_duration': 200e-6, 'sample_rate': 10e6}
    bag = recorded(tmp_path, tone(3, 2000, 0.24), radar)
    capsys.readouterr()
    assert diagnose([bag, '--jobs', '1']) == 2
    said = capsys.readouterr().err
    assert 'an echo after 240 us, but a sweep lasts 200 us' in said and len(said.strip().splitlines()) == 1


def test_of_long_sweeps_a_part_is_compared_and_that_is_said(tmp_path):
    radar = {'bandwidth': 200e6, 'ramp_duration': 4e-3, 'sample_rate': 10e6}
    whole = read_dataset(recorded(tmp_path, tone(2, 40_000, 0.05), radar))
    part = shortened(whole)
    assert part.samples_of(0).shape == (2, 32_768) and part.sweeps[0][0].sample_count == 32_768
    assert part.sweeps[0][0].chirp_rate == whole.sweeps[0][0].chirp_rate
    assert 'the first 32768 of 40000 samples' in part.missing[-1]
