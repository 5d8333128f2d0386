"""Cells of which far more is left than an effect adds say nothing of its size; those that lack it do."""

import numpy as np
import pytest
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.judging.standing import standings
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.search import Search
from drfmcw_sim.effects import Effect


@pytest.fixture
def search():
    return Search(Comparison(read_dataset(DATA / 'recording_0')), without=set(Effect.registry) - {'amplitude_slope'})


def standing_of(search, slope):
    """Return how well a slope of the master's amplitude stands, as it fits best."""
    candidate = next(c for c in search.bank if (c.effect, c.station) == ('amplitude_slope', 'master'))
    (standing,) = standings(search, search.trusted(search.fit([(candidate, {'slope': slope})])))
    return standing


def test_where_something_else_dominates_no_size_is_taken(search):
    """A slope also changes the mean power, and so does a gain that switches by 20 dB where the crane is near."""
    c = search.comparison
    c.residual = c.template([Effect.registry['amplitude_slope'](slope=0.8, station='master')])
    kind = next(k for k in c.kinds if k.name == 'amplitude')
    near = c.recorded.distance < np.median(c.recorded.distance)
    c.residual[c.rows(kind, 0)] -= 20.0 * near / c.std['amplitude'][:, 0]
    assert standing_of(search, 0.8).stands


def test_what_a_group_lacks_counts_against_an_effect(search):
    """A slope in half of the distances leaves as much in the others as it adds there: nothing else dominates these."""
    c = search.comparison
    c.residual = c.template([Effect.registry['amplitude_slope'](slope=0.8, station='master')])
    c.residual[c.entries.group < len(c.members) // 2] = 0.0
    standing = standing_of(search, 0.4)
    assert not standing.stands and standing.over_groups > 0.5
