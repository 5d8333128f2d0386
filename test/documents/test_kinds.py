"""Kinds of numbers: adding one takes one description, as docs/extending.md shows."""

import dataclasses
import importlib.util
import re
import sys
import textwrap

import numpy as np
import pytest
from checkout import DATA, ROOT

from drfmcw_diagnosis.compare import kinds
from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.compare.kinds.kind import Of
from drfmcw_diagnosis.finding.views import locations, misfit_map, series
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.leftovers import leftovers

PAGE = ROOT / 'docs/extending.md'


def blocks(section):
    """The code of each block of a section."""
    (text,) = re.findall(
        rf'^## {section}\n(.*?)(?=^## |\Z)', PAGE.read_text(encoding='utf-8'), re.DOTALL | re.MULTILINE
    )
    return [
        textwrap.dedent(code) for _, code in re.findall(r'^( *)```\w+\n(.*?)^\1```', text, re.DOTALL | re.MULTILINE)
    ]


@pytest.fixture
def kurtosis(tmp_path, monkeypatch):
    """The page's kind of number, registered as the page says."""
    module, registered = blocks('Add a kind of number')
    path, name = tmp_path / 'kurtosis.py', f'{kinds.__name__}.kurtosis'
    path.write_text(module, encoding='utf-8')
    spec = importlib.util.spec_from_file_location(name, path)
    monkeypatch.setitem(sys.modules, name, importlib.util.module_from_spec(spec))
    spec.loader.exec_module(sys.modules[name])
    before = list(kinds.KINDS)
    exec(registered, {'KINDS': kinds.KINDS, 'KURTOSIS': sys.modules[name].KURTOSIS})
    yield sys.modules[name].KURTOSIS
    kinds.KINDS[:] = before


@pytest.fixture(scope='module')
def data():
    """A recording without mismatch: the simulator's nominal sweeps."""
    return read_dataset(DATA / 'recording_0')


def test_a_new_kind_follows_its_noise_law(kurtosis, data):
    """The recording is fixed, so nothing is by chance; of n numbers the mean square lies within 4 of its spreads."""
    comparison = Comparison(data)
    z = comparison.residual[comparison.entries.where(kind='kurtosis')]
    assert len(z) == len(comparison.members) * len(comparison.receivers)
    assert np.mean(z**2) < 1.0 + 4.0 * np.sqrt(2.0 / len(z))
    (found, _) = (left for left in leftovers(Fitting(comparison), None) if left.kind == 'kurtosis')
    assert found.probability > 0.01


def test_a_new_kind_reaches_leftovers_and_finding(kurtosis, data):
    """A prediction off by 0.1 is a misfit of this kind alone, at both stations and at all distances."""

    class Wrong(type(kurtosis)):
        def predicted(self, expected):
            return super().predicted(expected) + 0.1

    kinds.KINDS[-1] = Wrong(**{f.name: getattr(kurtosis, f.name) for f in dataclasses.fields(kurtosis)})
    comparison = Comparison(data)
    left = [x for x in leftovers(Fitting(comparison), None) if x.probability < 1e-6]
    assert {(x.kind, x.station) for x in left} == {('kurtosis', 0), ('kurtosis', 1)}
    found = locations(comparison)
    assert {(x.level, x.axis, x.station) for x in found} == {('if_samples', 'range', s) for s in comparison.receivers}
    assert sum(x.share for x in found) == pytest.approx(1.0, abs=0.02)
    labels = [f'kurtosis of the samples, {station}' for station in comparison.receivers]
    assert set(labels) < set(misfit_map(comparison, None).rows)
    shown = [x for x in series(comparison, None) if x.label in labels]
    assert len(shown) == 2
    for x in shown:
        np.testing.assert_allclose(x.residual, -0.1, atol=0.05)


def test_a_comparison_knows_only_registered_kinds(data):
    """Without the page's kind a vector holds none of its numbers."""
    comparison = Comparison(data)
    assert not comparison.entries.where(kind='kurtosis').any()
    assert set(comparison.entries.kind) == {kind.name for kind in kinds.KINDS}


@pytest.mark.parametrize('name', ['amplitude', 'harmonic', 'piled', 'beat', 'range'])
def test_a_misfit_of_one_group_lies_at_its_distance(data, name):
    """However many numbers of a kind a group has, they count at the distance of the group."""
    comparison = Comparison(data)
    (kind,) = (k for k in kinds.KINDS if k.name == name)
    rows = comparison.rows(kind, 0 if kind.of is Of.STATION else -1)
    group = comparison.entries.group[rows]
    for wrong, distance in enumerate(comparison.recorded.distance):
        z = np.where(group == wrong, 3.0, 0.0)
        x, squares = kind.profile(comparison.recorded, z, comparison.entries.position[rows])
        assert squares.shape == x.shape
        assert x[squares > 0.0] == [distance]
        assert squares.sum() == pytest.approx(9.0 * np.count_nonzero(group == wrong))


def test_uneven_power_lies_at_all_distances(data):
    """All sweeps together show bursts, which stand at no distance."""
    comparison = Comparison(data)
    (kind,) = (k for k in kinds.KINDS if k.name == 'burst')
    rows = comparison.rows(kind, 0)
    z = comparison.residual[rows]
    assert set(comparison.entries.group[rows][z != 0.0]) == {0}
    x, squares = kind.profile(comparison.recorded, z, comparison.entries.position[rows])
    np.testing.assert_array_equal(x, comparison.recorded.distance)
    np.testing.assert_allclose(squares, np.sum(z**2) / len(x))
