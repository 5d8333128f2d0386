"""Second paths without a name: which are set aside, and which effects of an explanation they put in doubt."""

import numpy as np
import pytest
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.judging.paths import LIMITS, Unnamed, beyond_paths, left
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.search import Search
from drfmcw_sim.effects import Effect

SIZE = 20.0  # of what is looked for, over the amplitude with which it is simulated: -34 dB


@pytest.fixture(scope='module')
def search():
    return Search(Comparison(read_dataset(DATA / 'recording_0')))


def with_residual(search, residual):
    """Return the search with what the recording leaves of the model replaced."""
    search.comparison.residual = residual
    search.set_aside = np.zeros((0, len(residual)))
    search.trust(None)
    return search


def of_path(search, groups=None, **law):
    """Return what a path adds, free of noise, in all groups or in some (n,)."""
    template = SIZE * search.comparison.template([Unnamed(**law)])
    return template if groups is None else np.where(np.isin(search.comparison.entries.group, groups), template, 0.0)


def set_aside(search):
    """Return what is set aside beside no explanation."""
    return left(search, None, search.whitening_of(None, with_unknown=False))


def explained(directions, residual):
    """Return the share of a residual that directions of any sizes follow."""
    sizes = np.linalg.lstsq(directions.T, residual, rcond=1e-9)[0]
    return 1.0 - float(np.sum((residual - sizes @ directions) ** 2) / (residual @ residual))


def test_what_a_mast_behind_the_crane_throws_back_is_set_aside(search):
    """Its excess length falls by twice the distance."""
    place = float(search.comparison.recorded.distance.max()) + 20.0
    residual = of_path(search, offset=2.0 * place, slope=-2.0)
    found = set_aside(with_residual(search, residual))
    over_sweep = search.comparison.entries.where(kind='ramp')
    assert len(found)
    assert explained(found[:, over_sweep], residual[over_sweep]) > 0.9


def test_a_path_along_a_part_of_the_track_is_set_aside(search):
    """Something beside the rail reflects while the crane passes it."""
    order = np.argsort(search.comparison.recorded.distance)
    passed = order[: len(order) // 2]
    residual = of_path(search, passed, offset=12.0)
    found = set_aside(with_residual(search, residual))
    over_sweep = search.comparison.entries.where(kind='ramp')
    assert len(found)
    assert explained(found[:, over_sweep], residual[over_sweep]) > 0.9
    elsewhere = ~np.isin(search.comparison.entries.group, passed)
    assert not np.any(found[:, elsewhere])


@pytest.mark.parametrize('length', [6.0, 25.0])
def test_a_path_along_the_whole_track_is_an_echo(search, length):
    """An effect of the registry explains it, so the search shall find that."""
    echo = Effect.registry['echo'](excess_range=length, relative_power=-50.0)
    assert not len(set_aside(with_residual(search, search.comparison.template([echo]))))


def test_noise_is_no_path(search):
    """Of 10 draws of white noise none holds a path: false in one of 100 000 at a chance of 1e-6 each."""
    random = np.random.default_rng(81)
    used = search.comparison.template([Unnamed(offset=10.0)])
    for _ in range(10):
        noise = np.where(search.comparison.entries.where(kind='ramp'), random.normal(size=len(used)), 0.0)
        assert not len(set_aside(with_residual(search, noise)))


def test_an_echo_at_one_distance_is_in_doubt_and_one_at_all_is_not(search):
    """An echo that two distances alone show is as well anything else that reflects there."""
    everywhere = search.comparison.template([Effect.registry['echo'](excess_range=12.0, relative_power=-45.0)])
    nearest = search.comparison.entries.group == int(np.argmin(search.comparison.recorded.distance))
    for residual, doubtful in ((everywhere, False), (np.where(nearest, everywhere, 0.0), True)):
        with_residual(search, residual)
        found = search.best_addition(None)
        echo = next(f for f in found if f.effects[0].candidate.effect == 'echo')
        search.trust(echo)
        assert (beyond_paths(search, search.again(echo))[0] < LIMITS.beaten) == doubtful


def test_at_one_distance_a_path_is_an_echo():
    """Nothing separates them there."""
    data = read_dataset(DATA / 'recording_0')
    search = Search(Comparison(data, np.flatnonzero(data.group == data.group[0])))
    assert not len(set_aside(with_residual(search, of_path(search, offset=12.0))))
