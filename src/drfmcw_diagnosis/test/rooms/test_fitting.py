"""Fits of explanations: their course must not depend on which process did a part of the work."""

import pickle

import numpy as np
import pytest
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.bank import Candidate
from drfmcw_diagnosis.search.fitting import Fitting
from drfmcw_sim.effects import Effect


def start(effect, station, **values):
    return Candidate(effect, station, Effect.registry[effect].recipes[0], values), values


def test_a_start_from_another_process_is_fitted_alike():
    """What comes back from a worker is a copy: a distortion beside it must still count as the same one."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    effects = [('clipping', {'level': -20.0, 'station': 'master'}), ('delay_offset', {'delay': 0.1})]
    comparison.residual = comparison.template([Effect.registry[name](**values) for name, values in effects])
    fitting = Fitting(comparison)
    found = fitting.fit([start('clipping', 'master', level=-20.2), start('delay_offset', '', delay=0.05)])
    linearised = fitting.linearised(found, fitting.slopes(found))
    begun = [*found.start[:1], start('reference_offset', '', offset=-0.01)]
    here = fitting.fit(begun, linearised=linearised)
    there = fitting.fit(pickle.loads(pickle.dumps(begun)), linearised=linearised)
    assert here.linearised is not None and there.linearised is not None
    assert there.misfit == pytest.approx(here.misfit, rel=1e-12)
    assert [e.values for e in there.effects] == [e.values for e in here.effects]


@pytest.mark.parametrize('settled', [True, False])
def test_a_filter_may_have_settled_before_the_first_sample(settled):
    """Whether its answer to the begin of the signal is there, nobody knows: either way nothing is left of it."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    template = comparison.template([Effect.registry['if_filter'](station='slave', pole=1e4)])
    begin = comparison.entries.where(kind='transient', station=1)
    assert np.abs(template[begin]).max() > 10.0  # it would show
    comparison.residual = np.where(begin & settled, 0.0, template)
    fitting = Fitting(comparison)
    found = fitting.fit([start('if_filter', 'slave', pole=1.1e4)])
    for _ in range(4):
        fitting.trust(found)
        found = fitting.fit(found.start)
    assert found.effects[0].values['pole'] == pytest.approx(1e4, rel=0.01)
    left = fitting.whitening(comparison.residual - found.template)[begin]
    assert np.sum(left**2) < np.count_nonzero(template[begin])
