"""Which effects a search ends with, where what is found first only resembles them."""

import numpy as np
import pytest
from checkout import DATA
from scenes import record, scene

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.search import Search
from drfmcw_diagnosis.search.selection import pruned, searched
from drfmcw_diagnosis.search.starts.bank import Candidate
from drfmcw_sim.effects import Effect


def test_one_strong_settling_does_not_stand_for_a_late_ramp_and_a_settling(tmp_path):
    """A line far off its frequency at the begin looks like none; what is left then makes a settling of the other one.

    Chance adds an effect to one recording of a thousand. This one is fixed.
    """
    settling = {'effect': 'pll_settling', 'step': 36640.0, 'natural_frequency': 23659.0, 'damping': 0.4948}
    effects = [{**each, 'station': 'master'} for each in ({'effect': 'ramp_window', 'start': 2.31e-5}, settling)]
    standing = {'standing': {'distances': [40.0, 80.0, 120.0], 'sweeps': 10}}
    comparison = Comparison(read_dataset(record(scene(standing, effects=effects), tmp_path / 'r')))
    search = Search(comparison, without=set(Effect.registry) - {'ramp_window', 'pll_settling'})
    found = searched(search, 0.01).explanation
    assert found.keys == (('pll_settling', 'master'), ('ramp_window', 'master'))
    late = next(e for e in found.effects if e.key[0] == 'ramp_window')
    assert abs(late.values['start'] - 2.31e-5) < 5.0 * late.stds['start']


@pytest.mark.parametrize('loss', [0.02, -0.02])
def test_what_is_left_of_an_explanation_has_the_slopes_of_its_own(loss):
    """Nothing of the effect that is dropped stays behind in them, even where no other one moves."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    values = {'delay_offset': {'delay': 0.1}, 'amplitude_loss': {'loss': loss}}
    begun = [(Candidate(name, '', Effect.registry[name].recipes[0], own), own) for name, own in values.items()]
    comparison.residual = comparison.template([candidate.build(own) for candidate, own in begun])
    search = Search(comparison, without=set(Effect.registry) - {'delay_offset'})
    both = search.fit(begun, exact=True)
    found = pruned(search, both, 0.01)
    assert len(both.effects) == 2 and found.keys == (('delay_offset', ''),)
    np.testing.assert_allclose(search.slopes(found), Fitting(comparison).slopes(found), rtol=1e-6, atol=1e-6)
