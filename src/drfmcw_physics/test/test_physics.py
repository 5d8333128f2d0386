"""Formulas against the paper, ITU-R recommendations and the tables of bounds."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import constants as codata
from scipy.signal import get_window

from drfmcw_physics import air, bounds, constants, link_budget
from drfmcw_physics.bounds import (
    LineNoise,
    additive_std,
    coloured_bound,
    image_noise_ratio,
    outlier_probability,
    phase_noise_std,
)
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.link_budget import received_power
from drfmcw_physics.oscillators import range_bias
from drfmcw_physics.phase_noise import (
    PhaseNoise,
    around_line,
    combination_gain,
    components_around_line,
    components_between_lines,
    covariance,
    variance_within,
)
from drfmcw_physics.rules.history import History
from drfmcw_physics.rules.mode import ModeSettings, choose_mode
from drfmcw_physics.sweep import Mode, Role, SweepSettings, beat_frequency, largest_range, residual_chirp
from drfmcw_physics.windows import WINDOWS, symmetric_window

NOISE = PhaseNoise(-90.0, 200e3)
FLOOR_A, FLOOR_B = -97.7, -80.6  # dBm in the whole IF band
IF_BAND = 1.024e6
alphas = st.floats(1 - 50e-6, 1 + 50e-6)


def sweep(role=Role.FIRST, mode=Mode.SHORT_DISTANCE, start_delay=3.41e-6, **changes):
    return SweepSettings('a', 'b', role=role, mode=mode, start_delay=start_delay, **changes)


@pytest.mark.parametrize(('distance', 'power'), [(15, -37.2), (50, -47.7), (200, -59.7), (500, -67.7), (1000, -73.7)])
def test_received_power_of_table_1(distance, power):
    assert link_budget.received_power(13.0, 21.0, distance, 5.8e9) == pytest.approx(power, abs=0.05)


def test_noise_density_at_0_db_is_minus_174_dbm_per_hz():
    assert link_budget.noise_density(0.0) == pytest.approx(-173.98, abs=0.01)


def test_constants_are_those_of_the_si():
    assert constants.SPEED_OF_LIGHT == codata.speed_of_light
    assert constants.BOLTZMANN == codata.Boltzmann
    assert constants.ZERO_CELSIUS == codata.zero_Celsius


@pytest.mark.parametrize('name', WINDOWS)
def test_windows_are_those_of_their_names(name):
    for count in (2, 5, 64, 1001):
        np.testing.assert_allclose(symmetric_window(name, count), get_window(name, count, fftbins=False), atol=1e-15)


def test_rectangular_window_reaches_the_cramer_rao_bound_and_hann_costs_1_53():
    assert bounds.additive_factor('boxcar') == pytest.approx(math.sqrt(6) / (2 * math.pi), rel=1e-5)
    assert bounds.additive_factor('hann') / bounds.additive_factor('boxcar') == pytest.approx(1.53, abs=0.005)


def test_one_pole_phase_noise_is_pinned_at_100_khz():
    assert 10 * math.log10(NOISE.single_sideband(100e3)) == pytest.approx(-90.0, abs=1e-9)
    decade = NOISE.single_sideband(20e6) / NOISE.single_sideband(200e6)
    assert 10 * math.log10(decade) == pytest.approx(20.0, abs=0.01)


def test_refractive_index_of_dry_air_as_the_paper_computes_it():
    # the paper prints 299704442 m/s for this; its own eq. 23 gives 299711916 m/s
    index = air.refractive_index(25.0, 103250.0, 0.0, 'paper_eq23_as_printed')
    assert SPEED_OF_LIGHT / index == pytest.approx(299711916, abs=1)


def test_misprinted_wet_term_costs_60_mm_at_1_km_in_humid_summer_air():
    printed = air.refractive_index(25.0, 101325.0, 0.5, 'paper_eq23_as_printed')
    corrected = air.refractive_index(25.0, 101325.0, 0.5, 'paper_eq23_corrected')
    standard = air.refractive_index(25.0, 101325.0, 0.5)
    assert (corrected - printed) * 1e6 == pytest.approx(60.0, abs=1.5)
    assert corrected == pytest.approx(standard, abs=1.5e-6)


def test_unknown_air_model_is_refused():
    with pytest.raises(ValueError, match='eq24'):
        air.refractive_index(20.0, 1e5, 0.5, 'eq24')


def test_saturation_pressure_at_20_degc_is_that_of_the_steam_tables():
    assert air.saturation_vapour_pressure(20.0, 101325.0) == pytest.approx(23.39 * 1.0042, rel=2e-3)


def test_reference_error_of_40_ppm_is_40_mm_at_1_km_for_one_station_and_80_for_both():
    assert range_bias(1000.0, 1 + 40e-6, 1.0) == pytest.approx(0.040, abs=1e-5)
    assert range_bias(1000.0, 1 + 40e-6, 1 + 40e-6) == pytest.approx(0.080, abs=1e-5)


def test_largest_ranges_of_table_1():
    velocity = SPEED_OF_LIGHT / 1.0003
    assert largest_range(sweep(start_delay=3.41e-6), velocity) == pytest.approx(1023.0, abs=1.0)
    assert largest_range(sweep(start_delay=4e-6), velocity) == pytest.approx(847.0, abs=1.0)
    assert largest_range(sweep(mode=Mode.LONG_DISTANCE, start_delay=0.0), velocity) == pytest.approx(2046.0, abs=2.0)


@pytest.mark.parametrize(
    ('distance', 'start_delay', 'floor', 'hann', 'best', 'carrier'),
    [
        (15.0, 3.41e-6, FLOOR_A, 0.26, 0.170, 0.0013),
        (15.0, 3.41e-6, FLOOR_B, 0.31, 0.206, 0.0015),
        (50.0, 3.41e-6, FLOOR_A, 0.28, 0.184, 0.0014),
        (50.0, 3.41e-6, FLOOR_B, 0.65, 0.427, 0.0032),
        (200.0, 3.41e-6, FLOOR_A, 0.46, 0.300, 0.0022),
        (200.0, 3.41e-6, FLOOR_B, 2.40, 1.57, 0.012),
        (500.0, 3.41e-6, FLOOR_A, 0.96, 0.629, 0.0047),
        (500.0, 3.41e-6, FLOOR_B, 5.98, 3.91, 0.029),
        (1000.0, 0.6e-6, FLOOR_A, 1.69, 1.11, 0.008),
        (1000.0, 0.6e-6, FLOOR_B, 11.92, 7.80, 0.058),
    ],
)
def test_bounds_are_those_of_the_reference_table(distance, start_delay, floor, hann, best, carrier):
    """Table of what limits the range [mm], by others: Hann window, best estimator, carrier phase; to 1 %."""
    duration, k, velocity = 1e-3, 150e9, SPEED_OF_LIGHT / 1.0003
    delay = distance / velocity
    power = received_power(13.0, 21.0, distance, 5.8e9)
    ratio = 10 ** ((power - floor) / 10) * IF_BAND
    lines = tuple(LineNoise(ratio, k * abs(start_delay + sign * delay), 2.048e6) for sign in (1, -1))
    bound = coloured_bound(lines, (NOISE, NOISE), duration, delay)
    per_hertz = 1e3 * velocity / (2 * k)
    assert bound.frequency * per_hertz == pytest.approx(best, rel=0.01, abs=0.0005)
    assert bound.phase * 1e3 * velocity / (4 * math.pi * 5.8e9) == pytest.approx(carrier, rel=0.01, abs=0.0006)
    variance = 2 * phase_noise_std(NOISE, duration, 'hann', delay) ** 2
    for line in lines:
        inverse = 1 / ratio / duration + 2 * float(image_noise_ratio(NOISE, line.frequency, duration, 2.048e6))
        variance += additive_std(1 / inverse, duration, 'hann') ** 2
    assert math.sqrt(variance) * per_hertz == pytest.approx(hann, rel=0.01, abs=0.006)


def total_variance(noise):
    """Of the phase, over all offsets, in closed form."""
    return math.pi * noise.corner * noise.plateau


@pytest.mark.parametrize('delay', [50e-9, 3.3e-6])
def test_variance_of_a_phase_is_the_integral_of_its_density(delay):
    """Alone, and mixed with itself a delay later, where the density ripples faster than the corner."""
    rate = 800e6  # beyond the Nyquist frequency lies 3e-4 of the variance
    offset = (np.arange(4_000_000) + 0.5) * 100.0
    density = NOISE.phase_density(offset)
    assert np.sum(density) * 100.0 == pytest.approx(total_variance(NOISE), rel=1e-3)
    assert covariance(NOISE, rate, count=2**20)[0] == pytest.approx(total_variance(NOISE), rel=1e-3)
    mixed = np.sum(density * combination_gain(offset, delay)) * 100.0
    shared = covariance(NOISE, rate, np.array([0.0, delay]), 2**20)[:, 0]
    assert mixed == pytest.approx(2.0 * (shared[0] - shared[1]), rel=1e-2)


@pytest.mark.parametrize('count', [4, 360, 4000])
def test_variance_within_a_stretch_is_what_its_mean_does_not_follow(count):
    """Of the exponential covariance in closed form; mixed with itself after a long delay, twice as much."""
    rate, slow = 400e6, PhaseNoise(-90.0, 1e6)  # 0.3 % of the noise lies beyond the Nyquist frequency
    turns = 2.0 * math.pi * slow.corner * count / rate
    followed = 2.0 * (turns + math.expm1(-turns)) / turns**2
    assert variance_within(slow, count, rate) == pytest.approx(
        total_variance(slow) * (1.0 - followed), rel=1e-2, abs=3e-3
    )
    mixed = variance_within(slow, count, rate, np.array([0.0, 2e-5]))
    np.testing.assert_allclose(mixed, [0.0, 2.0 * variance_within(slow, count, rate)], rtol=1e-6, atol=1e-12)


def test_skirts_hold_all_power_that_the_line_lost():
    """The line keeps exp(-variance) of its power; all of the noise below the Nyquist frequency counts."""
    noisy, rate, count = (PhaseNoise(-60.0, 120e3), PhaseNoise(-65.0, 60e3)), 2e6, 4096
    offset = np.fft.fftfreq(count, 1.0 / rate)
    variance = sum(np.sum(o.single_sideband(offset)) for o in noisy) * rate / count
    assert variance > 0.5
    quadrature, in_phase = components_around_line(noisy, rate, count)
    held = np.array([2.0 * np.sum(d[1:-1]) + d[0] + d[-1] for d in (quadrature, in_phase)]) * rate / count
    assert held == pytest.approx([math.sinh(variance), math.cosh(variance) - 1.0], rel=1e-9)
    # the same on either side of the line, and a whole sample rate away, where samples show no difference
    at = np.array([0.0, 31e3, -31e3, 31e3 + rate])
    expected = np.interp(np.abs([0.0, 31e3, 31e3, 31e3]), offset[: count // 2], (quadrature + in_phase)[: count // 2])
    assert around_line(noisy, at, rate) == pytest.approx(expected, rel=1e-3)


def test_both_lines_share_noise_to_all_orders_where_no_delay_lies_between_them():
    """And to first order in weak noise: -(S_1 exp(j w tau) + S_2 exp(-j w tau))."""
    rate, count, delay = 2e6, 2048, np.array([0.0, 0.7e-6])
    strong = PhaseNoise(-60.0, 120e3), PhaseNoise(-65.0, 60e3)
    quadrature, in_phase = components_between_lines(*strong, delay, rate, count)
    around = components_around_line(strong, rate, count)
    np.testing.assert_allclose([-quadrature[0], in_phase[0]], around, rtol=1e-9, atol=1e-15)
    weak = PhaseNoise(-120.0, 120e3), PhaseNoise(-125.0, 60e3)
    quadrature, in_phase = components_between_lines(*weak, delay, rate, count)
    at = np.arange(1, count // 2) * rate / count
    turn = np.exp(2j * np.pi * at * delay[1])
    first = -(weak[0].single_sideband(at) * turn + weak[1].single_sideband(at) / turn)
    np.testing.assert_allclose(quadrature[1, 1:-1], first, rtol=1e-6, atol=1e-6 * np.abs(first).max())
    assert np.abs(in_phase).max() < 1e-5 * np.abs(first).max()


def test_synchronised_single_station_suffers_from_its_phase_noise():
    """limits.md: 2.69 mm at 15 m, 3.57 mm at 1 km with floor A, Hann window; every Hz counts twice there."""
    k, velocity = 150e9, SPEED_OF_LIGHT / 1.0003
    for distance, expected in ((15.0, 2.69), (1000.0, 3.57)):
        snr = 10 ** ((received_power(13.0, 21.0, distance, 5.8e9) - FLOOR_A) / 10) * IF_BAND * 1e-3
        std = math.hypot(additive_std(snr, 1e-3, 'hann'), math.sqrt(2) * phase_noise_std(NOISE, 1e-3, 'hann'))
        assert 1e3 * std * velocity / k == pytest.approx(expected, rel=0.015)


def test_outliers_of_orthogonal_bins():
    """Against drawn bins: 4e5 draws, false failure 1e-5 (4.4 standard errors)."""
    rng = np.random.default_rng(4)
    snr, bins, draws = 10**0.9, 64, 400_000
    line = np.abs(math.sqrt(snr) + (rng.normal(size=draws) + 1j * rng.normal(size=draws)) / math.sqrt(2)) ** 2
    highest = -np.log(-np.expm1(np.log(rng.random(draws)) / (bins - 1)))  # of the others, by its distribution
    share = np.mean(highest > line)
    expected = outlier_probability(snr, bins)
    assert abs(share - expected) < 4.4 * math.sqrt(expected / draws)


@given(alphas, alphas, st.floats(1e-7, 3.4e-6))
def test_lines_in_short_distance_mode_give_2_k_tau(first, second, delay):
    """Eqs. 5 and 18 for any references, as long as both lines stay clear of zero."""
    one, two = sweep(), sweep(role=Role.SECOND)
    k = one.chirp_rate
    # at the window's centre t, where f_0 (a - b) + k t (a^2 - b^2) is near (f_0 + 2 k t) (a - b), and 2 k t is B
    common = (one.start_frequency + one.bandwidth) * (first - second)
    if min(k * (3.41e-6 + delay) + common, k * (3.41e-6 - delay) + common) < 5e3:
        return
    total = beat_frequency(one, delay, first, second) - beat_frequency(two, delay, second, first)
    assert total == pytest.approx(k * delay * (first**2 + second**2), abs=1e-4)


@given(alphas, alphas)
def test_residual_chirps_of_both_stations_cancel(first, second):
    for mode in Mode:
        one = residual_chirp(sweep(mode=mode), first, second)
        two = residual_chirp(sweep(role=Role.SECOND, mode=mode), second, first)
        assert one == pytest.approx(two if mode == Mode.SHORT_DISTANCE else -two, abs=1e-6)


def test_mode_changes_with_hysteresis():
    settings = ModeSettings(limit=650.0, hysteresis=20.0)
    mode, changes = None, []
    for distance in [*np.arange(600.0, 700.0, 1.0), *np.arange(700.0, 600.0, -1.0)]:
        new = choose_mode(mode, float(distance), settings)
        if mode is not None and new != mode:
            changes.append((float(distance), new))
        mode = new
    assert changes == [(661.0, Mode.LONG_DISTANCE), (639.0, Mode.SHORT_DISTANCE)]


@given(st.lists(st.tuples(st.integers(0, 50), st.integers()), min_size=1), st.integers(-5, 55))
def test_history_returns_the_newest_not_later_value(entries, stamp):
    history = History()
    for at, value in entries:
        history.add(at, value)
    expected = [(at, value) for at, value in dict(entries).items() if at <= stamp]
    assert history.at(stamp) == (max(expected) if expected else None)


@given(st.sets(st.integers(0, 50), min_size=1), st.integers(-5, 55), st.integers(0, 20))
def test_history_keeps_all_that_holds_between_two_stamps(stamps, start, length):
    """The same is found between them as before, and nothing more is kept than holds there."""
    history = History()
    for at in stamps:
        history.add(at, at)
    before = [history.at(at) for at in range(start, start + length + 1)]
    history.keep(start, start + length)
    assert len(history) == len({found for found in before if found}) or (len(history) == 1 and not any(before))
    assert before == [history.at(at) for at in range(start, start + length + 1)]
