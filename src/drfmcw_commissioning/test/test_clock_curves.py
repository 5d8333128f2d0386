"""Curves of clocks over board temperature, from readings of a counter."""

import numpy as np
import pytest

from drfmcw_commissioning.indoors.curve import fit
from drfmcw_commissioning.indoors.readings import Reading, deviations, read_csv, typed
from drfmcw_physics.settings import ConfigurationError

AT_CUT = np.array([37e-6, -0.25e-6, 2e-9, 1.05e-10])
"""An AT-cut crystal 37 ppm off at 25 degC: -0.25 ppm/K there, turning points 55 K apart."""

BOARD = np.linspace(-10.0, 45.0, 12)


def truth(temperature, coefficients=AT_CUT):
    return sum(c * (np.asarray(temperature) - 25.0) ** i for i, c in enumerate(coefficients))


def test_cubic_is_found_and_its_standard_deviation_holds():
    """200 fits: mean square of error over standard deviation within 30 %; it scatters by 10 %, so 3 sigma: 0.3 %."""
    random = np.random.default_rng(3)
    std, probe = 0.02e-6, np.linspace(-10.0, 45.0, 5)
    squares = []
    for _ in range(200):
        time_base = 0.01e-6 * random.standard_normal()
        y = truth(BOARD) + time_base + std * random.standard_normal(len(BOARD))
        curve = fit(y, BOARD, np.full(len(BOARD), std), 0.01e-6)
        assert curve.shape == 'cubic'
        squares.append(((curve.at(probe) - truth(probe)) / curve.std(probe)) ** 2)
    assert np.mean(squares, axis=0) == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize(
    ('coefficients', 'shape'), [((1e-5, 0, 0, 0), 'constant'), ((1e-5, 1e-7, 0, 0), 'linear'), (AT_CUT, 'cubic')]
)
def test_data_choose_the_shape(coefficients, shape):
    """A shape too many costs 3 in chi-square ten times less often than the tenth of seeds that this one is not of."""
    noise = 0.02e-6 * np.random.default_rng(5).standard_normal(len(BOARD))
    curve = fit(truth(BOARD, coefficients) + noise, BOARD, np.full(len(BOARD), 0.02e-6), 0.0)
    assert curve.shape == shape
    assert curve.widened == 1.0


def test_readings_that_scatter_more_than_the_counter_widen_the_standard_deviation():
    noise = 0.2e-6 * np.random.default_rng(6).standard_normal(len(BOARD))
    curve = fit(truth(BOARD) + noise, BOARD, np.full(len(BOARD), 0.02e-6), 0.0, shape='cubic')
    assert 5.0 < curve.widened < 15.0


def test_one_temperature_gives_a_constant_and_its_counter():
    curve = fit([2e-6], [31.0], [3e-8], 4e-8)
    assert (curve.shape, curve.temperature, float(curve.at(31.0))) == ('constant', 31.0, 2e-6)
    assert curve.largest_std == pytest.approx(5e-8)


def test_too_few_temperatures_for_a_shape_are_refused():
    with pytest.raises(ConfigurationError, match='cubic curve needs readings at 6 board temperatures'):
        fit([0.0] * 5, [0.0, 10.0, 20.0, 30.0, 30.1], [1e-8] * 5, 0.0, shape='cubic')


def test_typed_and_csv_readings_are_the_same(tmp_path):
    path = tmp_path / 'readings.csv'
    path.write_text('# bench 3\nclock,frequency,temperature,std\nreference,100003700,25,2\nadc,2048018.4,-10,\n')
    read = read_csv(path)
    assert read[0] == Reading('reference', 100003700.0, 25.0, 2.0)
    assert (read[1].clock, read[1].frequency, read[1].temperature) == ('adc', 2048018.4, -10.0)
    assert typed('reference:100003700@25', 20.0).temperature == 25.0
    assert typed('adc:2.0480184e6', 20.0).temperature == 20.0
    values, board, stds = deviations(read, 'reference', 1e8)
    assert (values, board, stds) == ([pytest.approx(37e-6)], [25.0], [pytest.approx(2e-8)])


@pytest.mark.parametrize(
    ('content', 'reason'),
    [
        ('clock,frequency\nreference,1e8\n', "column 'temperature' is missing"),
        ('clock,frequency,temperatur\n', "unknown column 'temperatur'"),
        ('clock,frequency,temperature\nref,1e8,25\n', "reading 1: unknown clock 'ref'"),
        ('clock,frequency,temperature\nreference,1e8,warm\n', "reading 1: temperature 'warm' is no number"),
        ('clock,frequency,temperature\n', 'holds no reading'),
    ],
)
def test_wrong_files_are_named(tmp_path, content, reason):
    path = tmp_path / 'readings.csv'
    path.write_text(content)
    with pytest.raises(ConfigurationError, match=reason):
        read_csv(path)


def test_reading_of_another_clock_is_refused():
    with pytest.raises(ConfigurationError, match='--adc-nominal sets the nominal frequency'):
        deviations([Reading('adc', 1e8, 25.0)], 'adc', 2.048e6)
