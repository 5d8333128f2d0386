"""Stretches over which the received power is another one, which a loss everywhere imitates."""

import numpy as np
import pytest
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.judging.stretches import LIMITS, beyond_stretches
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.starts.bank import Candidate
from drfmcw_sim.effects import Effect


@pytest.fixture(scope='module')
def comparison():
    return Comparison(read_dataset(DATA / 'recording_0'))


def beyond(comparison, loss, stretch):
    """Return by how much a loss gains more than a stretch, where half of the distances lose more [dB]."""
    kind = next(k for k in comparison.kinds if k.name == 'amplitude')
    far = comparison.recorded.distance > np.median(comparison.recorded.distance)
    comparison.residual = comparison.template([Effect.registry['amplitude_loss'](loss=loss)])
    comparison.residual[comparison.rows(kind)] -= np.ravel(stretch * far[:, None] / comparison.std['amplitude'])
    fitting = Fitting(comparison)
    recipe = next(r for r in Effect.registry['amplitude_loss'].recipes if r.size == 'loss')
    candidate = Candidate('amplitude_loss', '', recipe, {'loss': 0.3})
    (found,) = beyond_stretches(fitting, fitting.fit([(candidate, candidate.values)]))
    return found


def test_a_loss_everywhere_is_separated_from_one_along_a_stretch(comparison):
    """Free of noise: a loss is none of a stretch, half of a stretch's is no loss, and both may be there at once."""
    assert beyond(comparison, loss=0.6, stretch=0.0) > 0.0
    assert beyond(comparison, loss=0.0, stretch=0.8) < LIMITS.beaten
    assert beyond(comparison, loss=0.6, stretch=0.8) > 0.0
