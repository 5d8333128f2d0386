"""Events without a name within the sweep: which curves over it are events, and which are not."""

import numpy as np
import pytest
import scipy.fft
from checkout import DATA
from scipy import special

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.compare.over_sweep import over_sweep
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.events import beyond_events, left
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.limits import EVENTS
from drfmcw_diagnosis.search.starts.bank import of_coefficients
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_sim.effects import Effect


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


@pytest.mark.parametrize(('channel', 'shifted', 'unshifted'), [(2, 'beat', 'range'), (3, 'range', 'beat')])
def test_a_jump_of_the_phases_shifts_the_lines_that_hold_it(data, channel, shifted, unshifted):
    """The sum of the phases shifts what the beat frequencies have in common, the difference shifts the range.

    A straight line through a jump of the phase in mid-sweep has a slope of 3/2 of it over the sweep (least squares).
    """
    comparison = Comparison(data)
    kinds = {k.name: k for k in comparison.kinds}
    rate, count = abs(data.sweeps[0][0].chirp_rate), comparison.std['ramp'].shape[2]
    step = np.where(np.arange(count) >= 0.5 * count, 0.3, 0.0)
    trend = np.polynomial.Polynomial.fit(np.arange(count), step, 1)
    jump = scipy.fft.dct(step - trend(np.arange(count)), norm='ortho')
    comparison.residual = np.zeros(len(comparison.residual))
    comparison.residual[comparison.rows(kinds['ramp'], channel)] = np.ravel(jump / comparison.std['ramp'][:, channel])
    duration = count * float(comparison.time[1] - comparison.time[0])
    hertz = 1.5 * 0.3 / (2.0 * np.pi * duration) * np.sqrt(2.0)  # of both lines together, as each phase is over sqrt(2)
    shifts = {'beat': hertz, 'range': hertz * SPEED_OF_LIGHT / (4.0 * rate)}
    for name, shift in shifts.items():
        comparison.residual[comparison.rows(kinds[name])] = shift / comparison.std[name].ravel()
    fitting = Fitting(comparison)
    plain = fitting.whitening_of(None, with_unknown=False)
    found = plain.beside(left(fitting, None, plain))
    before, after = (
        {name: float(np.sum(w(comparison.residual)[comparison.rows(kinds[name])] ** 2)) for name in shifts}
        for w in (plain, found)
    )
    assert after[shifted] < 0.7 * before[shifted]
    assert after[unshifted] == pytest.approx(before[unshifted], rel=0.05)


@pytest.mark.parametrize('width', [1.4, 3.0])
def test_a_bent_ramp_is_separated_from_an_event(data, width):
    """Twelve coefficients follow much of a glitch of the ramp, and all of what is bent smoothly; free of noise."""
    comparison = Comparison(data)
    many = max(of_coefficients(data.stations), key=lambda c: len(c.free))
    block = np.arange(comparison.std['ramp'].shape[2])
    glitch = special.ndtr((block - 0.3 * len(block)) / width)
    bent = 1.0 + 2e-5 * np.cos(np.linspace(0.0, 2.0 * np.pi, len(many.free)))
    jumped = over_sweep(comparison, glitch, np.ones(len(comparison.members)), {2: 1.0})
    smooth = comparison.template([Effect.registry[many.effect](station=many.station, relative_rate=tuple(bent))])
    beyond = []
    for residual in (jumped, smooth):
        comparison.residual = residual
        fitting = Fitting(comparison)
        beyond += beyond_events(fitting, fitting.fit([(many, many.values)], exact=True))
    assert beyond[0] < EVENTS.beaten
    assert beyond[1] > 0.0
