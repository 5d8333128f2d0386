"""How large effects are: what the best detector could see of them, which knows no phase that nobody knows."""

import dataclasses
import math

import numpy as np
import pytest
from proof_conditions import BOTH, condition, with_effect
from scipy import special, stats
from scipy.integrate import trapezoid

from drfmcw_diagnosis.compare.limits import MODEL
from drfmcw_proof.cases import changes, draws, side_bands, sizes
from drfmcw_proof.cases.concealing import Applied, conceal
from drfmcw_proof.generator import model as generator
from drfmcw_proof.generator.model import FIRST, SECOND, clean, nominal


def test_matched_sizes_have_their_closed_forms():
    c = condition((40.0, 60.0, 90.0), 16)
    silent = dataclasses.replace(
        c, stations=tuple(dataclasses.replace(s, phase_noise_level=-160.0) for s in c.stations), reference_std=0.05
    )
    offset = sizes.matched_size(silent, [Applied('reference_offset', None, {'offset': 0.03})])
    assert offset.total == pytest.approx(0.03 / 0.05 * math.sqrt(48), rel=0.01)
    twin = sizes.matched_size(silent, [Applied('delay_offset', None, {'delay': 0.03 / 0.299792458 * 1.0003})])
    assert twin.total == pytest.approx(offset.total, rel=0.01)
    noise = sizes.matched_size(silent, [Applied('noise_floor', 'slave', {'excess': 0.2})])
    measured_to = 10.0 / math.log(10.0) / math.sqrt(48 * 1024)  # [dB]
    assert noise.total == pytest.approx(0.2 / math.hypot(measured_to, sizes.FLOOR_KNOWN), rel=0.02)
    loss = sizes.matched_size(silent, [Applied('amplitude_loss', None, {'loss': 0.1})])
    assert loss.total == pytest.approx(0.1 / 0.2 * math.sqrt(48), rel=0.02)
    halved = sizes.matched_size(silent, [Applied('amplitude_loss', None, {'loss': 10.0})])
    assert halved.amplitude == pytest.approx(10.0 / 0.2 * math.sqrt(48), rel=0.02)


def test_matched_sizes_know_the_noise_as_well_as_the_diagnosis_does():
    assert (sizes.FLOOR_KNOWN, sizes.SKIRTS_KNOWN) == (MODEL.common_floor, MODEL.common_skirt)
    c = condition((40.0, 60.0, 90.0), 16)  # in whose bands the skirts hide the floor
    assert c.stations[0].phase_noise_level > -100.0
    louder = sizes.matched_size(c, [Applied('noise_floor', 'slave', {'excess': 0.2})])
    assert louder.total < 0.2 / math.hypot(10.0 / math.log(10.0) / math.sqrt(48 * 1024), sizes.FLOOR_KNOWN)
    skirts = [c.stations[0].phase_noise_level + x for x in (0.15, 1.5)]
    little, much = (sizes.matched_size(c, [Applied('phase_noise', 'master', {'level': x})]).total for x in skirts)
    assert little < 3.0 < much  # a standard deviation of what is known, and ten


def silent_pair(sweeps):
    """Return a condition of white noise alone."""
    c = condition((60.0,), sweeps, start_delay_jitter=0.0)
    stations = tuple(dataclasses.replace(s, phase_noise_level=-160.0) for s in c.stations)
    return dataclasses.replace(c, stations=stations)


def line(c, energy, frequency=2.5e5):
    """Return a spur of so much energy over the variance of white noise in the samples that are on."""
    std = float(nominal(c).noise_std(FIRST)[0])
    return Applied(
        'spur', 'master', {'frequency': frequency, 'level': 20.0 * math.log10(math.sqrt(energy / 1020) * std / 8192)}
    )


@pytest.mark.parametrize('energy', [0.02, 0.3, 2.0, 8.0, 50.0, 1000.0])
def test_line_of_unknown_phase_counts_as_its_best_detector_sees_it(energy):
    """Its amplitude has Rice's law, without it Rayleigh's: twice the divergence, on a bin and between two alike."""
    rho = math.sqrt(energy)
    x = np.linspace(0.0, rho + 12.0, 20_001)
    gain = np.log(special.i0e(rho * x)) + rho * x - 0.5 * energy
    divergence = trapezoid(stats.rice.pdf(x, rho) * gain, x)
    c = silent_pair(16)
    for frequency in (2.5e5, 2.505e5, 6.1803e5):
        size = sizes.matched_size(c, [line(c, energy, frequency)])
        assert size.total == pytest.approx(math.sqrt(2.0 * 16 * divergence), rel=0.06)  # 4 % of it by the energy
        assert size.shape < 1e-6 * size.total


def test_deflection_of_summed_powers_is_the_size_of_a_weak_line():
    c = silent_pair(2000)
    scene, _ = with_effect(c, 'spur', 'master', **line(c, 0.2).parameters)
    rows = np.arange(2000)
    noise = np.random.default_rng(2).standard_normal((2000, 2048)) * scene.noise_std(FIRST)[rows, None]
    wave = np.exp(-2j * math.pi * 2.5e5 / 2.048e6 * np.arange(2048))
    opposite = [dataclasses.replace(scene, advance=a) for a in (0.0, 0.5)]  # what noise and line share cancels
    powers = [np.abs(generator.receive(s, FIRST, rows, 0.0, noise) @ wave) ** 2 for s in opposite]
    before = np.abs(noise @ wave) ** 2
    deflection = (np.mean(powers) - np.mean(before)) / np.std(before) * math.sqrt(16)
    few = silent_pair(16)
    # the deviation of 2000 powers is known to 3 %, 5 sigma 15 %
    assert sizes.matched_size(few, [line(few, 0.2)]).total == pytest.approx(deflection, rel=0.15)


def test_lines_of_two_explanations_are_compared_by_their_powers():
    c = silent_pair(16)
    weak, strong, elsewhere = line(c, 2.0), line(c, 2.2), line(c, 2.0, 3.1e5)
    ripple = Applied('sweep_ripple', 'slave', {'deviation': 60.0, 'rate': 9e3, 'phase': 1.0})
    assert sizes.separation(c, [weak, ripple], [ripple, weak]) < 1e-4
    apart = math.sqrt(16) * 0.5 * (2.2 - 2.0) / (1.0 + 0.5 * 2.1)
    assert sizes.separation(c, [weak], [strong]) == pytest.approx(apart, rel=0.05)
    assert sizes.separation(c, [strong], [weak]) == pytest.approx(apart, rel=0.05)
    alone = sizes.separation(c, [], [weak])
    assert sizes.separation(c, [weak], []) == pytest.approx(alone, rel=1e-3)
    assert sizes.separation(c, [], [weak, elsewhere]) == pytest.approx(math.sqrt(2.0) * alone, rel=0.02)
    assert sizes.separation(c, [elsewhere], [weak]) == pytest.approx(math.sqrt(2.0) * alone, rel=0.02)


@pytest.mark.parametrize('effect', ['fan_modulation', 'adc_dither'])
def test_what_comes_at_any_time_is_not_counted_as_a_known_shape(effect):
    c = condition((60.0, 300.0), 8)
    random = np.random.default_rng(3)
    (template,) = draws.template(random, effect, c)
    _, size = sizes.scaled(c, template, 10.0)
    assert size.total == pytest.approx(10.0, rel=0.03) and size.shape < 0.1 and size.noise > 9.0


def test_bursts_pay_for_the_places_where_they_could_be():
    """Weak ones count as the power of whole sweeps shows them, strong ones less the choice among the windows."""
    c = silent_pair(16)
    power = nominal(c).noise_std(FIRST)[0] ** 2

    def size(excess, probability=0.2, length=64.0):
        level = 10.0 * math.log10(2.0 * excess * power / 8192.0**2)
        burst = {'probability': probability, 'level': level, 'duration': length / 2.048e6}
        return sizes.matched_size(c, [Applied('interference_burst', 'master', burst)]).total

    assert size(0.02) == pytest.approx(0.2 * 64 * 0.02 * math.sqrt(16 / (2.0 * 2048)), rel=0.05)
    moved = math.sqrt(32.0) * math.log(1.0 + 20.0)
    assert size(20.0) == pytest.approx(math.sqrt(16 * 0.2 * (moved**2 - 2.0 * math.log(32 / 0.2))), rel=0.02)
    assert size(3.0, probability=1.0, length=2048.0) == pytest.approx(math.sqrt(16 * 1024) * math.log(4.0), rel=0.02)
    assert size(0.1) < size(1.0) < size(2.0) < size(20.0)
    weak, strong = (
        Applied('interference_burst', 'master', {'probability': 0.2, 'level': level, 'duration': 5e-5})
        for level in (-51.0, -50.0)
    )
    alone = [sizes.separation(c, [], [burst]) for burst in (weak, strong)]
    assert sizes.separation(c, [weak], [strong]) == pytest.approx(alone[1] - alone[0], rel=1e-6)


def test_filters_nearly_alike_are_not_separated():
    """Poles a per cent apart; their answers to a chirp's edge, where there is no line, count for nothing."""
    c = condition((40.0, 200.0), 16)
    one, other = (Applied('if_filter', 'slave', {'pole': pole}) for pole in (3.75e6, 3.79e6))
    assert sizes.separation(c, [one], [other]) < 1.0
    assert sizes.separation(c, [], [other]) > 3.0


@pytest.mark.parametrize('distance', [60.0, 300.0, 900.0])
def test_noise_is_whitened_to_unit_variance(distance):
    c = condition((distance,), 64)
    scene = nominal(c)
    covariance, present = side_bands.noise_covariance(scene, 0, scene)
    precision = 2.0 * np.linalg.inv(covariance) * (present[:, :, None] & present[:, None, :]) / 2.048e6 / 2048
    rows = np.arange(64)
    samples = generator.render(scene)
    g = []
    for station in BOTH:
        carrier = clean(scene, station, rows)
        on = carrier != 0.0
        g.append(changes.relative_change(samples[station] - carrier.real, carrier, on))
    bands = side_bands.side_bands(g)
    squares = np.einsum('rfi,fij,rfj->rf', np.conj(bands), precision, bands).real
    freedom = 2.0 * np.sum(present, axis=1)
    # 64 x 4000 squares scatter by 0.3 %
    inner = slice(1, 600)
    assert np.sum(squares[:, inner]) / (64 * np.sum(freedom[inner])) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    'effect', ['echo', 'reference_clock_drift', 'phase_noise', 'clipping', 'slant_geometry', 'sweep_shape']
)
def test_effects_are_scaled_to_the_wanted_size(effect):
    random = np.random.default_rng(8)
    c = draws.random_condition(random, draws.Extent(5, 8), full_scale_power=-35.0)
    (template,) = draws.template(random, effect, c)
    applied, size = sizes.scaled(c, template, 12.0)
    assert size.total == pytest.approx(12.0, rel=0.03)
    assert sizes.matched_size(c, [applied]) == size
    assert set(applied.parameters) == set(template.parameters)


def test_size_of_an_effect_does_not_count_what_is_there_already():
    c = condition((60.0, 200.0), 8)
    spur = Applied('spur', 'master', {'frequency': 2.5e5, 'level': -60.0})
    delay = Applied('delay_temperature', 'slave', {'slope': 5.0})
    assert sizes.matched_size(c, [delay], [spur]).total == pytest.approx(sizes.matched_size(c, [delay]).total, rel=1e-6)


def test_a_window_counts_for_the_signal_that_it_takes_away():
    """The squared samples that are gone, over the noise's variance; what is fitted freely takes a few per cent."""
    c = silent_pair(6)
    window = Applied('ramp_window', 'slave', {'start': 40e-6})
    size = sizes.matched_size(c, [window])
    with_it, plain = conceal(nominal(c), [window]), nominal(c)
    rows = np.arange(6)
    gone = sum(
        np.sum((clean(plain, s, rows) - clean(with_it, s, rows)).real ** 2 / plain.noise_std(s)[rows, None] ** 2)
        for s in (FIRST, SECOND)
    )
    assert size.total == pytest.approx(math.sqrt(gone), rel=0.15)


def test_a_modulation_counts_by_its_power_whatever_its_phase():
    """Its phase is drawn in every sweep: another seed draws others, beside a spur or alone."""
    hum = Applied('frequency_modulation', 'master', {'deviation': 100.0, 'rate': 8000.0})
    spur = Applied('spur', 'slave', {'frequency': 2.5e5, 'level': -60.0})
    pairs = [dataclasses.replace(silent_pair(6), seed=seed) for seed in (7, 8)]
    one, other = (sizes.matched_size(c, [hum]) for c in pairs)
    assert one.total == pytest.approx(other.total, rel=0.05)
    assert one.noise > 3.0 * one.shape
    assert sizes.matched_size(pairs[0], [hum], [spur]).total == pytest.approx(one.total, rel=0.1)
