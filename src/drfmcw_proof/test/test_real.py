"""The proof on real recordings: what is added is found, nothing else; skipped where no real recording lies."""

import math

import numpy as np
import pytest
from checkout import DATA, SHARED
from scenes import STANDARD_STATION, record
from scipy.signal import hilbert

from drfmcw_diagnosis.engine import diagnose, diagnose_dataset
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.scene.judge import examine, own_ramp, shared_ramps
from drfmcw_diagnosis.scene.ramps.shared import carried_over
from drfmcw_physics.settings import ConfigurationError
from drfmcw_proof.prove import main
from drfmcw_proof.real.concealing import concealments, first_sweeps, swapped, unchanged
from drfmcw_proof.real.running import recordings
from drfmcw_sim.scenario import scenario_from_mapping

REAL = SHARED / 'real'
real = pytest.mark.skipif(not REAL.exists(), reason='real recordings are not in the repository')


def effects(diagnosis):
    return {e.effect: e.parameters for e in diagnosis.explanation.effects} if diagnosis.explanation else {}


def test_recordings_are_found_below_a_directory():
    assert DATA / 'recording_0' in recordings([DATA])
    with pytest.raises(ConfigurationError, match='no such directory'):
        recordings([DATA / 'none'])


def test_a_directory_without_recordings_is_refused_in_one_line(tmp_path, capsys):
    assert main(['--real', str(tmp_path), '--out', str(tmp_path / 'out')]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not (tmp_path / 'out').exists()


@pytest.fixture(scope='module')
def cable(tmp_path_factory):
    """20 sweeps of a station with 60 m of cable, without the noise of its oscillator."""
    scenario = {
        'stations': {'radar': STANDARD_STATION | {'delay': 12e-9, 'phase_noise_level': math.nan}},
        'pairs': [{'first': 'radar', 'second': 'radar', 'standing': {'distances': [60.0], 'sweeps': 20}}],
        'reference': {'enabled': False},
        'seed': 3,
    }
    return read_dataset(record(scenario_from_mapping(scenario, 'test'), tmp_path_factory.mktemp('cable') / 'r'))


def analytic(data):
    signal = data.samples_of(0).astype(float)
    return hilbert(signal - signal.mean(axis=1, keepdims=True), axis=1)


def test_an_added_ripple_turns_the_line_by_its_delay(cable):
    """2 pi tau deviation sin(2 pi rate t + 0.7), to 5 % of its peak off the ends."""
    added = [c for c in concealments(cable, 1) if c.effect == 'sweep_ripple'][-1]
    (sweep,) = cable.sweeps[0]
    time = np.arange(sweep.sample_count) / sweep.sample_rate
    turned = np.angle(np.mean(analytic(added.data) * analytic(cable).conj(), axis=0))
    delay = 60.0 * 1.0003 / 299792458.0 + 12e-9
    expected = 2 * np.pi * delay * added.size['deviation'] * np.sin(2 * np.pi * added.size['rate'] * time + 0.7)
    inside = slice(len(time) // 10, -len(time) // 10)
    assert np.abs(turned - expected)[inside].max() < 0.05 * np.abs(expected).max()


def test_an_added_echo_is_a_line_of_its_delay_and_level(cable):
    added = next(c for c in concealments(cable, 1) if c.effect == 'echo')
    (sweep,) = cable.sweeps[0]
    copy = analytic(added.data) - analytic(cable)
    ratio = np.mean(copy * analytic(cable).conj(), axis=0)
    turns = np.polyfit(np.arange(len(ratio))[50:-50], np.unwrap(np.angle(ratio))[50:-50], 1)[0] / (2 * np.pi)
    delay = turns * sweep.sample_rate / sweep.chirp_rate
    assert abs(delay * 299792458.0 / added.size['path'] - 1.0) < 0.01
    level = np.sum(np.abs(copy) ** 2) / np.sum(np.abs(analytic(cable)) ** 2)
    assert abs(10.0 * np.log10(level) - added.size['level']) < 0.3


def test_controls_are_the_sweeps_as_they_were(cable):
    assert unchanged(cable) == []  # too few to be divided
    short = first_sweeps(cable, 7)
    assert len(short) == 7 and np.array_equal(short.samples_of(0), cable.samples_of(0)[:7])
    assert short.stamp.shape == (7,) and short.full_scale.shape == (1, 7)


@real
@pytest.mark.parametrize(
    ('name', 'named'),
    [
        ('awr1243_interferer', {'interference_burst'}),
        ('p2g_saturated', {'clipping'}),
        ('apres_greenland', {'clipping', 'ac_coupling'}),
        ('presense_awr', set()),
    ],
)
def test_what_a_real_radar_does_is_named_and_nothing_else(name, named):
    found = effects(diagnose(REAL / name))
    assert set(found) == named
    if 'interference_burst' in named:
        assert abs(found['interference_burst']['probability'].value - 0.52) < 0.1


@real
def test_a_bent_ramp_carries_over_to_another_setting():
    """Misfit of the blocks held out at most 20 mV rms, delays within 0.3 %; 3.3 V are 4096 codes."""
    datasets = [read_dataset(REAL / f'gmr_cableCorto_{band}') for band in ('230_255', '226_260')]
    ramps = [own_ramp(data) for data in datasets]
    for data, ramp in zip(datasets, ramps, strict=True):
        found = effects(diagnose_dataset(data))
        assert {'ramp_window', 'sweep_shape'} <= set(found)
        assert abs(found['ramp_window']['end'].value - 0.95e-3) < 4e-6
        assert ramp.held_out * 3300.0 / 4096.0 < 20.0 < 0.1 * ramp.nominal * 3300.0 / 4096.0
        assert 0.04 < np.std(ramp.rate()) < 0.09
    both = [r.shape.delay[0] for r in shared_ramps(datasets)]
    assert abs(both[1] / both[0] - 1.0) < 0.003
    for one, other in (ramps, ramps[::-1]):
        assert abs(carried_over(one.shape, other).shape.delay[0] / one.shape.delay[0] - 1.0) < 0.003


@real
def test_effects_added_to_real_samples_come_out():
    """At least nine of ten; one seed."""
    data = read_dataset(REAL / 'presense_awr')
    wanted = 'clipping', 'interference_burst', 'iq_imbalance'
    trials = [t for t in concealments(data, 1) if t.effect in wanted][::3]
    assert {t.effect for t in trials} == set(wanted)
    right = sum(set(effects(examine(t.data, 0.01))) == {t.effect} for t in trials)
    assert right >= 0.9 * len(trials)
    data = read_dataset(REAL / 'awr1243_interferer')
    sides = [(examine(x, 0.01).scene or {}).get('mirrored', False) for x in (data, swapped(data))]
    assert sides[0] != sides[1]
