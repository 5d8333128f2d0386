"""Curves and steps without a name: which effects they cast doubt on, and which of them are set aside."""

import itertools

import numpy as np
import pytest
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.judging.curves import bent, beyond_steps, conditions, left
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.search import Search
from drfmcw_diagnosis.search.starts.bank import Candidate
from drfmcw_sim.effects import Effect


@pytest.fixture(scope='module')
def data():
    return read_dataset(DATA / 'recording_0')


def range_errors(comparison, errors):
    """Return errors of the range of each group [m] as a residual: nothing else is left, and nothing by chance."""
    kind = next(k for k in comparison.kinds if k.name == 'range')
    rows = comparison.rows(kind)
    residual = np.zeros(len(comparison.residual))
    residual[rows] = errors[comparison.entries.group[rows]] / np.asarray(comparison.std['range']).ravel()
    return residual


def fit(fitting, effect, station, **start):
    recipe = Effect.registry[effect].recipes[0]
    return fitting.fit([(Candidate(effect, station, recipe, start), start)])


def judged(fitting, found):
    """Return what a freer curve explains beside the effect, and by how much its gain exceeds that of a step."""
    slopes = fitting.whitening(fitting.slopes(found))
    rest = fitting.whitening(fitting.comparison.residual - found.template)
    as_it_is = fitting.whitening_of(found, with_unknown=False)
    return bent(fitting, found, slopes, rest, as_it_is)[0], beyond_steps(fitting, found)[0]


def test_a_bent_rail_is_no_air(data):
    """Fitted to a curve over the distance, an error of the air leaves the bend; fitted to itself, nothing."""
    comparison = Comparison(data)
    distance = comparison.recorded.distance
    bend = -0.05 * np.sin(np.pi * (distance - distance.min()) / np.ptp(distance)) - 1e-4 * distance
    comparison.residual = range_errors(comparison, bend)
    fitting = Fitting(comparison)
    curve, _ = judged(fitting, fit(fitting, 'air_refractivity', '', offset=50.0))
    assert curve > 25.0
    comparison.residual = comparison.template([Effect.registry['air_refractivity'](offset=200.0)])
    fitting = Fitting(comparison)
    curve, step = judged(fitting, fit(fitting, 'air_refractivity', '', offset=150.0))
    assert curve == 0.0 and step > 25.0


@pytest.mark.parametrize(('late', 'aside'), [(True, False), (True, True), (False, False), (False, True)])
def test_what_follows_a_temperature_late_is_no_temperature_slope(data, late, aside):
    """A cable has the board's temperature a minute later, also where a curve is set aside for the rest.

    Nothing is by chance.
    """
    comparison = Comparison(data)
    board = np.asarray(data.board_temperature[0], float)
    course = board.copy()
    if late:
        for before, n in itertools.pairwise(np.argsort(data.time)):
            course[n] = board[n] + (course[before] - board[n]) * np.exp((data.time[before] - data.time[n]) / 60.0)
    warmer = np.array([course[m].mean() for m in comparison.members]) - data.calibration[0].temperature
    comparison.residual = range_errors(comparison, 0.02 * warmer)
    fitting = Fitting(comparison)
    found = fit(fitting, 'delay_temperature', 'master', slope=50.0)
    explained = fitting.misfit(0.0) - found.misfit
    if aside:
        curve = range_errors(comparison, 0.1 * np.sin(comparison.recorded.distance / 50.0))
        unnamed = 100.0 * (comparison.residual - found.template) if late else curve
        fitting.count_as_noise(found, unnamed[None], np.zeros((0, len(unnamed))))
        fitting.trust(found)
    curve, _ = judged(fitting, found)
    assert (curve > 0.02 * explained) == late


def test_a_moved_connector_is_no_drift(data):
    """From some time on the range is 8 cm longer: a step explains more than a delay that follows the temperature."""
    comparison = Comparison(data)
    time = conditions(Fitting(comparison))['time']
    comparison.residual = range_errors(comparison, 0.08 * (time > np.median(time)))
    fitting = Fitting(comparison)
    _, step = judged(fitting, fit(fitting, 'delay_temperature', 'slave', slope=5.0))
    assert step < 0.0


def test_a_curve_that_no_effect_describes_is_set_aside(data):
    """A bend of 5 cm is; an offset of the reference, which an effect describes, is not."""
    comparison = Comparison(data)
    distance = comparison.recorded.distance
    bend = 0.05 * np.sin(np.pi * (distance - distance.min()) / np.ptp(distance))
    comparison.residual = range_errors(comparison, bend)
    search = Search(comparison)
    assert len(left(search, None, search.whitening)) > 0
    comparison.residual = comparison.template([Effect.registry['reference_offset'](offset=0.05)])
    search = Search(comparison)
    assert len(left(search, None, search.whitening)) == 0


def test_a_reference_that_wanders_is_set_aside(data):
    """Multipath of a satellite receiver: its error goes up and down over minutes, whatever the distance."""
    comparison = Comparison(data)
    search = Search(comparison)
    time = conditions(search)['time']
    nothing = search.set_aside
    for waves in (0.8, 1.9, 2.6):
        wander = 0.08 * np.sin(2.0 * np.pi * waves * (time - time.min()) / np.ptp(time) + 0.5)
        comparison.residual = range_errors(comparison, wander)
        search.set_aside = nothing
        search.trust(None)
        before = search.misfit(0.0)
        search.set_aside = left(search, None, search.whitening)
        search.trust(None)
        assert search.misfit(0.0) < 0.1 * before


def test_a_clock_that_jumps_is_set_aside(data):
    """From some temperature on it is off: a step of one clock explains all, and what is left hides no other effect."""
    comparison = Comparison(data)
    offset = comparison.template([Effect.registry['reference_clock_offset'](deviation=0.3, station='slave')])
    board = conditions(Fitting(comparison))['board 1']
    comparison.residual = offset * (board > np.median(board))[comparison.entries.group]
    search = Search(comparison)
    before = search.misfit(0.0)
    search.set_aside = left(search, None, search.whitening)
    search.trust(None)
    assert search.misfit(0.0) < 0.01 * before
    comparison.residual = offset
    search = Search(comparison)
    assert len(left(search, None, search.whitening)) == 0


def test_a_clock_that_jumps_is_no_drift_beside_another(data):
    """Two effects of a clock follow a jump better than each does alone; one clock's step takes the place of both."""
    comparison = Comparison(data)
    registry = Effect.registry
    board = conditions(Fitting(comparison))['board 1']
    jump = comparison.template([registry['reference_clock_offset'](deviation=0.3, station='slave')])
    comparison.residual = jump * (board > np.median(board))[comparison.entries.group]
    fitting = Fitting(comparison)
    starts = [('reference_clock_offset', {'deviation': 0.2}), ('reference_clock_temperature', {'slope': 0.02})]
    points = [Candidate(name, 'slave', registry[name].recipes[0], start) for name, start in starts]
    found = fitting.fit([(point, point.values) for point in points])
    assert found.misfit < 0.6 * fitting.misfit(0.0)
    assert max(beyond_steps(fitting, found)) < -10.0
    comparison.residual = comparison.template([point.build({**point.values}) for point in points])
    fitting = Fitting(comparison)
    found = fitting.fit([(point, point.values) for point in points])
    assert min(beyond_steps(fitting, found)) > 25.0


def test_a_step_of_something_else_takes_no_place_of_a_clock(data):
    """The clock shows in the beat frequency. A jump of the range explains more, and beside it the clock is needed."""
    comparison = Comparison(data)
    time = conditions(Fitting(comparison))['time']
    jump = range_errors(comparison, 5.0 * (time > np.median(time)))
    registry = Effect.registry['reference_clock_temperature']
    clock = Candidate('reference_clock_temperature', 'slave', registry.recipes[0], {'slope': 0.02})
    comparison.residual = jump + comparison.template([clock.build()])
    fitting = Fitting(comparison)
    found = fitting.fit([(clock, clock.values)])
    assert fitting.misfit(0.0) < 1.1 * found.misfit  # the jump explains more
    assert min(beyond_steps(fitting, found)) > 25.0
