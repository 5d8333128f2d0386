"""Where the crane stands: its phase from sweep to sweep, and reflections beside what moves it."""

import numpy as np
import pytest
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.compare.kinds.path import unwrapped
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.bank import Candidate
from drfmcw_diagnosis.search.search import Search
from drfmcw_sim.effects import Effect


@pytest.mark.parametrize('rate', [-2.8, -0.3, 0.0, 1.7, 2.8])
def test_a_phase_is_counted_over_missing_sweeps(rate):
    """Between neighbours it turns by less than half a turn, in the gaps by more."""
    number = np.array([0, 1, 2, 4, 5, 6, 9, 10, 11, 12])
    time = 3.0 + 0.02 * number
    phase = 0.4 + rate * number + 0.1 * np.sin(number)
    found = unwrapped(np.angle(np.exp(1j * phase)), time)
    assert found - found[0] == pytest.approx(phase - phase[0], abs=1e-9)


def test_a_reflection_is_sought_where_a_sway_has_the_crane():
    """Its fringes follow the true distance to a part of the wavelength, here 0.3 m from what the reference says."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    sway = {'amplitude': 0.3, 'frequency': 0.11, 'phase': 0.4}
    ground = {'coefficient': -0.05, 'height_product': 93.6}
    both = [Effect.registry['sway'](**sway), Effect.registry['ground_reflection'](**ground)]
    comparison.residual = comparison.template(both)
    search = Search(comparison)
    recipe = Effect.registry['sway'].recipes[0]
    known = search.fit([(Candidate('sway', '', recipe, sway), sway)], 0)
    found = search.best_addition(known)[0].effects[-1]
    assert found.key == ('ground_reflection', '')
    assert found.values['height_product'] == pytest.approx(ground['height_product'], abs=0.05)
    assert found.values['coefficient'] == pytest.approx(ground['coefficient'], rel=0.05)
