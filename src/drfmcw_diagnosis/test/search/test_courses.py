"""Courses without a name over the sweep: what one receiver does to its own line is no ramp and no second path."""

import numpy as np
import pytest
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.compare.over_sweep import over_sweep
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search import courses
from drfmcw_diagnosis.search.events import left
from drfmcw_diagnosis.search.fits.fitted import Freedom
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.starts.bank import Candidate
from drfmcw_sim.effects import Effect


@pytest.fixture(scope='module')
def comparison():
    return Comparison(read_dataset(DATA / 'recording_0'))


def of_receiver(comparison, shape, of_phase=True):
    """Return what a curve over the sweep adds to the first station's line, of the phase in proportion to the line."""
    if not of_phase:
        return over_sweep(comparison, shape, np.ones(len(comparison.members)), {0: 1.0})
    lines = courses.by_frequency(comparison, 0)
    return over_sweep(comparison, shape, lines / np.abs(lines).mean(), {2: 1.0, 3: 1.0})


def place(comparison):
    return np.linspace(0.0, 1.0, comparison.std['ramp'].shape[2])


@pytest.mark.parametrize('of_phase', [True, False])
def test_what_one_receiver_does_to_its_line_is_set_aside(comparison, of_phase):
    """The clock of a converter that goes to and fro, an amplifier whose supply does; free of noise."""
    comparison.residual = of_receiver(comparison, 0.05 * np.sin(2.0 * np.pi * 6.3 * place(comparison)), of_phase)
    fitting = Fitting(comparison)
    plain = fitting.whitening_of(None, with_unknown=False)
    found = left(fitting, None, plain)
    before, after = (np.sum(w(comparison.residual) ** 2) for w in (plain, plain.beside(found)))
    assert before > 1000.0 and after < 1e-3 * before


@pytest.mark.parametrize(
    'effects',
    [
        (('pll_settling', {'step': 2e4, 'natural_frequency': 2e4, 'damping': 0.4, 'station': 'master'}),
         ('sweep_ripple', {'deviation': 150.0, 'rate': 7e3, 'phase': 0.3, 'station': 'slave'})),
        (('echo', {'excess_range': 12.0, 'relative_power': -50.0, 'phase': 0.4}),
         ('echo', {'excess_range': 21.0, 'relative_power': -52.0, 'phase': 2.0})),
    ],
)  # fmt: skip
def test_neither_ramps_nor_second_paths_are_courses_of_a_receiver(comparison, effects):
    """Both lines show them, in whatever number; free of noise."""
    comparison.residual = comparison.template([Effect.registry[name](**values) for name, values in effects])
    fitting = Fitting(comparison)
    plain = fitting.whitening_of(None, with_unknown=False)
    rest = plain(comparison.residual)
    assert rest @ rest > 1000.0
    assert not len(courses.left(fitting, plain, rest, Freedom(np.zeros((0, len(rest)))), 0.0))


def beyond(comparison, *residuals):
    """Return by how much a ripple of the master's ramp, as it fits the sum of residuals best, exceeds a course."""
    comparison.residual = np.sum(residuals, axis=0)
    fitting = Fitting(comparison)
    start = {'deviation': 10.0, 'rate': 6.3e3, 'phase': 0.4}
    recipe = next(iter(Effect.registry['sweep_ripple'].recipes))
    (found,) = courses.beyond_courses(
        fitting, fitting.fit([(Candidate('sweep_ripple', 'master', recipe, start), start)])
    )
    return found


def test_a_ripple_of_the_ramp_is_separated_from_one_of_a_converters_clock(comparison):
    """Either is 29 standard deviations large. A ripple beside another course is in no doubt; free of noise."""
    ripple = comparison.template(
        [Effect.registry['sweep_ripple'](deviation=40.0, rate=6e3, phase=0.5, station='master')]
    )
    pulled = of_receiver(comparison, np.sin(2.0 * np.pi * 6.3 * place(comparison)))
    pulled *= np.linalg.norm(ripple) / np.linalg.norm(pulled)
    elsewhere = of_receiver(comparison, 0.01 * np.sin(2.0 * np.pi * 19.0 * place(comparison)))
    assert beyond(comparison, pulled) < courses.LIMITS.beaten
    assert beyond(comparison, ripple) > 0.0
    assert beyond(comparison, ripple, elsewhere) > 0.0
