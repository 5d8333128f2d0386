"""Ranges with calibrations that state curves and uncertainty: what is applied, what is added, what is flagged."""

import dataclasses
import math

import numpy as np
import pytest

from drfmcw_fusion.combination import delay_on_true_clocks
from drfmcw_fusion.pipeline import Flag, RangeFusion
from drfmcw_fusion.settings import FusionSettings
from drfmcw_node.processing.records import Beat
from drfmcw_physics.air import refractive_index
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import SweepSettings

START = 1_700_000_000_000_000_000
TAU = 2e-6
CURVE = {'alpha_linear': -2e-7, 'alpha_cubic': 1e-10, 'sample_clock_linear': 3e-7, 'temperature_low': -10.0,
         'temperature_high': 45.0}  # fmt: skip


def fused(first=None, second=None, boards=(None, None), weather_std=(0.0, 0.0, 0.0), **settings):
    """Return the range of one pair of beats."""
    fusion = RangeFusion(FusionSettings(velocity='standing', **settings))
    sweeps = [SweepSettings('a', 'b', role=1, stamp=0), SweepSettings('b', 'a', role=2, stamp=0)]
    for sweep, changes, board in zip(sweeps, (first or {}, second or {}), boards, strict=True):
        fusion.add_sweep_config(sweep)
        fusion.add_calibration(Calibration(sweep.station, **changes))
        if board is not None:
            fusion.add_board_temperature(sweep.station, START - 1, board)
    for quantity, value, std in zip(
        ('temperature', 'pressure', 'humidity'), (15.0, 1e5, 0.5), weather_std, strict=True
    ):
        fusion.add_weather(quantity, START - 1, value, std)
    k = sweeps[0].chirp_rate
    late = sweeps[0].start_delay
    fusion.add_beat(Beat('a', 'b', 1, 0, k * (late + TAU), 1.0, 0.0, -60.0, 45.0, START, 'a'))
    return fusion.add_beat(Beat('b', 'a', 1, 0, k * (late - TAU), 1.0, 0.0, -60.0, 45.0, START + 3410, 'b'))


def test_curve_acts_at_the_boards_temperature():
    """A curve and the values that it has at a temperature give the same range."""
    warm = Calibration('a', **CURVE).at(40.0)
    values = {'alpha': warm.alpha, 'sample_clock_alpha': warm.sample_clock_alpha}
    assert warm.alpha == pytest.approx(1.0 - 2e-7 * 15 + 1e-10 * 15**3, abs=1e-15)
    assert fused(CURVE, boards=(40.0, None)).range == fused(values).range != fused().range


def test_delay_slope_shifts_the_range():
    slope = {'delay': 1e-8, 'delay_slope': 5e-12, 'temperature_low': 0.0, 'temperature_high': 40.0}
    shift = fused(slope, boards=(35.0, None)).range - fused({'delay': 1e-8}).range
    assert shift == pytest.approx(-5e-11 * SPEED_OF_LIGHT, rel=1e-3)


def test_beyond_the_range_the_end_of_the_curve_holds_and_the_calibration_is_stale():
    inside, beyond = fused(CURVE, boards=(45.0, None)), fused(CURVE, boards=(60.0, None))
    assert inside.range == beyond.range
    assert not inside.flags & Flag.STALE_CALIBRATION and beyond.flags & Flag.STALE_CALIBRATION


@pytest.mark.parametrize(
    ('calibration', 'board', 'flags'),
    [
        (CURVE, None, Flag.STALE_CALIBRATION),  # the curve cannot be used
        (CURVE, -9.9, Flag.VALID),
        ({}, None, Flag.VALID),
        ({}, 64.0, Flag.VALID),
        ({}, 66.0, Flag.STALE_CALIBRATION),
        ({'temperature_low': 10.0, 'temperature_high': 30.0}, 31.0, Flag.STALE_CALIBRATION),
        ({'delay_peer': 'b'}, None, Flag.VALID),
        ({'delay_peer': 'c'}, None, Flag.STALE_CALIBRATION),
    ],
)
def test_calibration_is_stale_where_it_says_nothing(calibration, board, flags):
    assert fused(calibration, boards=(board, None)).flags & Flag.STALE_CALIBRATION == flags


def test_nothing_is_added_unless_both_stations_state_their_uncertainty():
    plain = fused()
    for stated in (fused({'delay_std': 1e-11}), fused(weather_std=(1.0, 100.0, 0.1))):
        assert (stated.correlated_std, stated.range_std) == (0.0, plain.range_std)


def test_correlated_part_is_in_the_standard_deviation_and_beside_it():
    plain = fused()
    stated = fused({'delay_std': 3e-11}, {'delay_std': 4e-11})
    assert stated.correlated_std == pytest.approx(5e-11 * SPEED_OF_LIGHT, rel=1e-3)
    assert stated.range_std == pytest.approx(math.hypot(plain.range_std, stated.correlated_std))
    assert stated.white_std == pytest.approx(plain.range_std)
    assert (stated.range, stated.flags) == (plain.range, plain.flags)


def test_delay_measured_with_the_peer_states_the_sum_of_both():
    stated = fused({'delay_std': 9e-11}, {'delay_std': 4e-11, 'delay_peer': 'a'})
    assert stated.correlated_std == pytest.approx(4e-11 * SPEED_OF_LIGHT, rel=1e-3)


def test_weather_is_uncertain_as_its_sensors_state():
    stated = fused({'alpha_std': 1e-15}, {'alpha_std': 1e-15}, weather_std=(0.5, 50.0, 0.03))
    change = [
        refractive_index(15.5, 1e5, 0.5) - refractive_index(15.0, 1e5, 0.5),
        refractive_index(15.0, 1e5 + 50.0, 0.5) - refractive_index(15.0, 1e5, 0.5),
        refractive_index(15.0, 1e5, 0.53) - refractive_index(15.0, 1e5, 0.5),
    ]
    assert stated.correlated_std == pytest.approx(stated.range * math.hypot(*change), rel=1e-3)
    vacuum = fused({'alpha_std': 1e-15}, {'alpha_std': 1e-15}, weather_std=(0.5, 50.0, 0.03), atmosphere='vacuum')
    assert vacuum.correlated_std < 1e-9


@pytest.mark.parametrize('field', ['alpha', 'sample_clock_alpha'])
def test_clocks_contribute_what_they_do_to_the_delay(field):
    """Against the exact combination, one clock 0.3 ppm off."""
    stated = fused({f'{field}_std': 3e-7}, {'alpha_std': 1e-15})
    sweeps = SweepSettings('a', 'b', role=1), SweepSettings('b', 'a', role=2)
    k, late = sweeps[0].chirp_rate, sweeps[0].start_delay
    frequency = k * (late + TAU), k * (late - TAU)
    right = (Calibration('a'), Calibration('b'))
    wrong = (dataclasses.replace(right[0], **{field: 1.0 + 3e-7}), right[1])
    change = delay_on_true_clocks(sweeps, wrong, frequency) - delay_on_true_clocks(sweeps, right, frequency)
    assert stated.correlated_std == pytest.approx(abs(change) * SPEED_OF_LIGHT, rel=2e-3)


def test_curves_take_arrays_and_unknown_temperatures():
    calibration = Calibration('a', alpha=1.00001, **CURVE)
    values = calibration.alpha_at(np.array([25.0, np.nan, 100.0]))
    assert values.tolist() == [1.00001, 1.00001, float(calibration.alpha_at(45.0))]
    assert calibration.at(math.nan).alpha == 1.00001


def test_fields_that_an_older_recording_lacks_are_not_stated():
    old = Calibration('a', alpha_std=math.nan, delay_slope=math.nan, temperature_high=math.nan)
    assert old == Calibration('a') and not old.depends_on_temperature and not old.states_uncertainty
