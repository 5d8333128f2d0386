"""Events without a name within the sweep: which curves over it are events, and which are not."""

import numpy as np
import pytest
import scipy.fft
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.events import left
from drfmcw_diagnosis.search.fits.fitting import Fitting


@pytest.fixture(scope='module')
def data():
    return read_dataset(DATA / 'recording_0')


def events_of(data, curve):
    """Return the events that are left where a station's log amplitude follows a curve over the sweep, free of noise."""
    comparison = Comparison(data)
    kind = next(k for k in comparison.kinds if k.name == 'ramp')
    std = comparison.std['ramp'][:, 0]
    place = np.linspace(-1.0, 1.0, std.shape[1])
    shown = scipy.fft.dct(curve(place) - curve(place).mean(), norm='ortho')
    comparison.residual = np.zeros(len(comparison.residual))
    comparison.residual[comparison.rows(kind, 0)] = np.ravel(0.05 * shown / std)
    fitting = Fitting(comparison)
    return len(left(fitting, None, fitting.whitening_of(None, with_unknown=False)))


@pytest.mark.parametrize('at', [-0.5, 0.1, 0.6])
def test_a_step_is_an_event(data, at):
    """The receiver's gain jumps within each sweep."""
    assert events_of(data, lambda place: np.where(place > at, 1.0, 0.0)) > 0


@pytest.mark.parametrize('bend', [0.0, 0.5, -1.0])
def test_a_slope_is_no_event(data, bend):
    """A step explains three quarters of it, a straight line all: set aside, it would hide what bends it."""
    assert events_of(data, lambda place: place + bend * place**2) == 0


@pytest.mark.parametrize('lost', [1, 3])
def test_lost_samples_shift_the_range_with_the_turns_of_the_line(data, lost):
    """The phase shows by how many turns the line is ahead from then on but for whole ones, and so does the range."""
    comparison = Comparison(data)
    recorded = comparison.recorded
    kind = {k.name: k for k in comparison.kinds}
    sweep = data.sweeps[0][0]
    lines = np.array([sweeps.line[:, 0].mean() for sweeps in recorded.sweeps])
    ahead = lost * lines / sweep.sample_rate
    ahead -= np.rint(ahead)
    count = comparison.std['ramp'].shape[2]
    block = np.arange(count)
    step = np.where(block >= 0.4 * count, 1.0, 0.0)
    trend = np.polynomial.Polynomial.fit(block, step, 1)
    shown = 2.0 * np.pi * scipy.fft.dct(step - trend(block), norm='ortho')
    comparison.residual = np.zeros(len(comparison.residual))
    for channel in (2, 3):
        shares = ahead[:, None] * shown / comparison.std['ramp'][:, channel]
        comparison.residual[comparison.rows(kind['ramp'], channel)] = shares.ravel()
    rows = comparison.rows(kind['range'])
    comparison.residual[rows] = ahead / comparison.std['range'].ravel()
    fitting = Fitting(comparison)
    plain = fitting.whitening_of(None, with_unknown=False)
    found = left(fitting, None, plain)
    before, after = (np.sum(w(comparison.residual)[rows] ** 2) for w in (plain, plain.beside(found)))
    assert after < 0.01 * before
