"""Fits of explanations: their course must not depend on which process did a part of the work."""

import pickle

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
