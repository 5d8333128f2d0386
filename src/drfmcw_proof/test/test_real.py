"""The proof on real recordings: what is added is found, nothing else; skipped where no real recording lies."""

import numpy as np
import pytest
from checkout import DATA, SHARED

from drfmcw_diagnosis.engine import diagnose, diagnose_dataset
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.scene.judge import examine, own_ramp, shared_ramps
from drfmcw_diagnosis.scene.ramps.shared import carried_over
from drfmcw_physics.settings import ConfigurationError
from drfmcw_proof.prove import main
from drfmcw_proof.real.concealing import concealments, swapped
from drfmcw_proof.real.running import recordings

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
    trials = concealments(data, 1)
    right = sum(set(effects(examine(t.data, 0.01))) == {t.effect} for t in trials)
    assert right >= 0.9 * len(trials)
    data = read_dataset(REAL / 'awr1243_interferer')
    sides = [(examine(x, 0.01).scene or {}).get('mirrored', False) for x in (data, swapped(data))]
    assert sides[0] != sides[1]
