"""Which effect is added first: what only looks like another one must not hide it."""

import math

import pytest
from checkout import DATA
from scenes import record, scene

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.search import Search
from drfmcw_diagnosis.search.starts.bank import Candidate
from drfmcw_sim.effects import Effect


def test_a_limit_that_makes_noise_uneven_comes_before_bursts(tmp_path):
    """At a quarter of the sampling rate the phase of a sweep decides how much of its noise a limit holds.

    What is uneven so is most of the mismatch, and bursts explain it better than the limit does. The recording is fixed.
    """
    standing = {'standing': {'distances': [30.0, 60.0, 90.0], 'sweeps': 12}}
    quarter = {'start_delay_short': 3.5403e-6}
    free = Comparison(read_dataset(record(scene(standing, mode=quarter), tmp_path / 'free')))
    level = float(free.measured.amplitude[0, 1]) - 20.0 * math.log10(free.data.full_scale[1].max()) - 9.0
    limiter = {'effect': 'clipping', 'station': 'slave', 'level': level}
    comparison = Comparison(read_dataset(record(scene(standing, mode=quarter, effects=[limiter]), tmp_path / 'r')))
    uneven = comparison.residual[comparison.entries.where(kind='burst', station=1)]
    assert uneven @ uneven > 0.5 * (comparison.residual @ comparison.residual)
    tried = 'clipping', 'compression', 'interference_burst'
    best = Search(comparison, without=set(Effect.registry) - set(tried)).best_addition(None)[0]
    assert [(e.candidate.effect, e.candidate.station) for e in best.effects] == [('clipping', 'slave')]


def test_a_reflection_is_sought_where_slant_geometry_has_the_antenna():
    """A third of a metre more where the crane is nearest turns its fringes by half a wave; data without noise."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    slant = Effect.registry['slant_geometry'](height_difference=5.0)
    ground = Effect.registry['ground_reflection'](height_product=80.0, coefficient=0.02)
    comparison.residual = comparison.template([slant, ground])
    search = Search(comparison, without=set(Effect.registry) - {'slant_geometry', 'ground_reflection', 'echo'})
    values = {'height_difference': 5.0}
    known = search.fit([(Candidate('slant_geometry', '', type(slant).recipes[0], values), values)])
    found = search.best_addition(known)[0]
    assert found.effects[-1].key == ('ground_reflection', '')
    assert found.effects[-1].values['height_product'] == pytest.approx(80.0, abs=0.01)
    assert found.misfit < 1.0
