"""Events without a name within the sweep: which curves over it are events, and which are not."""

import numpy as np
import pytest
import scipy.fft
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.events import left
from drfmcw_diagnosis.search.fitting import Fitting


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
