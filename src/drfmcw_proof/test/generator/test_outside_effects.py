"""Effects outside the registry do in the generator what their names say."""

import math

import numpy as np
import pytest
from proof_conditions import condition, phase_change, quiet, with_effect

from drfmcw_proof.cases import side_bands
from drfmcw_proof.cases.concealing import Applied, conceal
from drfmcw_proof.generator import model as generator
from drfmcw_proof.generator.model import FIRST, SECOND, nominal


def test_outside_effects_do_what_their_names_say():
    c = quiet(condition((60.0,), 4))
    plain = generator.render(nominal(c))[FIRST]

    def samples(effect, **parameters):
        return generator.render(conceal(nominal(c), [Applied(effect, 'master', parameters)]))[FIRST]

    assert np.array_equal(samples('stuck_bit', bit=4, value=1), plain | 16)
    assert np.array_equal(samples('stuck_bit', bit=4, value=0), plain & ~16)
    assert np.all(np.mod(samples('missing_codes', width=8), 16) >= 8)
    dropped = samples('dropped_samples', count=3, time=5e-4)
    assert np.array_equal(dropped[:, :1024], plain[:, :1024])
    assert np.array_equal(dropped[:, 1024:-3], plain[:, 1027:])
    sporadic = samples('sporadic_drop', count=3, time=5e-4, every=2)
    assert np.array_equal(sporadic[0::2], dropped[0::2]) and np.array_equal(sporadic[1::2], plain[1::2])
    larger = np.where(np.arange(plain.shape[1]) % 8 == 0, 10.0 ** (2.0 / 20.0), 1.0)
    assert np.abs(samples('interleaving_gain', step=2.0, period=8) - plain * larger).max() < 2.0  # both are rounded
    humming = samples('gain_hum', depth=2.0, rate=100.0)
    strong = np.abs(plain) > 0.5 * plain.max()
    gains = 20.0 * np.log10(np.where(strong, humming, 1.0) / np.where(strong, plain, 1.0))
    middle = np.array([np.median(one[on]) for one, on in zip(gains, strong, strict=True)])
    assert np.abs(gains).max() < 2.1 and np.ptp(middle) > 0.3  # in each sweep another one
    assert np.array_equal(samples('gain_step', step=6.0, time=5e-4)[:, :1024], plain[:, :1024])
    time = np.arange(plain.shape[1]) / c.sample_rate
    for effect, parameters, decibels in (
        ('gain_ripple', {'ripple': 2.0, 'rate': 3e3, 'phase': 0.4}, 2.0 * np.sin(2.0 * math.pi * 3e3 * time + 0.4)),
        ('gain_sag', {'sag': 3.0, 'time_constant': 1e-4}, -3.0 * np.exp(-time / 1e-4)),
    ):
        expected = plain * 10.0 ** (decibels / 20.0)
        assert np.abs(samples(effect, **parameters) - expected).max() < 2.0  # both are rounded
    crossed = samples('crossover_distortion', depth=200.0)
    assert np.abs(crossed - (plain - 200.0 * np.tanh(plain / 200.0))).max() < 2.0
    jump, before = with_effect(c, 'phase_jump', 'master', angle=0.3, time=5e-4)
    change = phase_change(jump, before, FIRST, np.array([0]))[0]
    assert change[900] == pytest.approx(0.0, abs=1e-9)
    assert change[1200] == pytest.approx(0.3, abs=1e-9)


def test_outside_effects_of_the_converters_clock_turn_the_own_line_by_its_frequency():
    c = quiet(condition((60.0, 150.0), 4))
    rows = np.array([0, 4])
    time = np.arange(c.sample_count) / c.sample_rate
    cases = (
        ('sampling_ripple', {'skew': 1e-8, 'rate': 5e3, 'phase': 0.4}, np.sin(2.0 * math.pi * 5e3 * time + 0.4)),
        ('sampling_settling', {'skew': -1e-8, 'time_constant': 1e-4}, -np.exp(-time / 1e-4)),
    )
    for effect, parameters, late in cases:
        scene, before = with_effect(c, effect, 'master', **parameters)
        line = side_bands.signed_line(before, FIRST, rows)[:, None]
        expected = 2.0 * math.pi * line * 1e-8 * late
        heard = slice(40, -40)  # both chirps
        change, expected = (x[:, heard] for x in (phase_change(scene, before, FIRST, rows), expected))
        # what a sweep has as a whole is its own
        assert np.allclose(*(x - x.mean(axis=1, keepdims=True) for x in (change, expected)), atol=1e-4)
        assert np.ptp(expected) > 0.01
        assert np.abs(phase_change(scene, before, SECOND, rows)[:, heard]).max() < 1e-12


def test_an_uncertain_time_of_samples_makes_noise_in_proportion_to_the_lines_slope():
    c = condition((60.0, 150.0), 4)
    scene, before = with_effect(c, 'aperture_jitter', 'slave', jitter=3e-9)
    rows = np.arange(len(scene))
    assert np.array_equal(scene.noise_floor[FIRST], before.noise_floor[FIRST])
    added = scene.noise_std(SECOND) ** 2 - before.noise_std(SECOND) ** 2
    time, rng = np.arange(200_000) / c.sample_rate, np.random.default_rng(4)
    for row in (0, 4):
        # the samples of a sine at these times: the variance of 200 000 squares is known to 0.5 %
        amplitude = scene.amplitude(SECOND, rows)[row]
        line = side_bands.signed_line(scene, SECOND, rows)[row]
        late = 3e-9 * rng.standard_normal(len(time))
        error = amplitude * (np.cos(2.0 * math.pi * line * (time + late)) - np.cos(2.0 * math.pi * line * time))
        assert np.mean(error**2) == pytest.approx(added[row], rel=0.03)  # 6 standard deviations


def test_outside_effects_of_single_sweeps_and_distances_act_on_these_alone():
    c = condition((60.0, 90.0, 150.0), 4)
    change = {
        name: scene.gain - before.gain
        for name, (scene, before) in {
            'gain_switch': with_effect(c, 'gain_switch', 'slave', step=2.0, within=100.0),
            'loose_contact': with_effect(c, 'loose_contact', 'slave', loss=2.0, every=3),
            'shadowing': with_effect(c, 'shadowing', loss=2.0, **{'from': 80.0, 'to': 100.0}),
            'wet_antenna': with_effect(c, 'wet_antenna', loss=2.0, time=nominal(c).time[5]),
        }.items()
    }
    assert all(np.all(change[name][FIRST] == 0.0) for name in ('gain_switch', 'loose_contact'))
    assert np.allclose(change['gain_switch'][SECOND], [2.0] * 8 + [0.0] * 4)
    assert np.allclose(change['loose_contact'][SECOND], [-2.0, 0.0, 0.0] * 4)
    assert np.allclose(change['shadowing'], [0.0] * 4 + [-2.0] * 4 + [0.0] * 4)
    assert np.allclose(change['wet_antenna'], [0.0] * 5 + [-2.0] * 7)


def test_outside_effects_of_path_and_reference_do_what_their_names_say():
    c = quiet(condition((60.0, 90.0, 150.0), 4))
    rows, far = np.array([0, 4, 8]), np.array([60.0, 90.0, 150.0])

    def of_ray(effect, **parameters):
        scene = conceal(nominal(c), [Applied(effect, None, parameters)])
        ray = scene.rays[-1]
        one, direct = (generator.heard(scene, FIRST, rows, r) for r in (ray, scene.rays[0]))
        return ray.length(far), one.amplitude[:, 0] / direct.amplitude[:, 0]

    length, share = of_ray(
        'local_echo', excess_range=6.0, relative_power=-20.0, phase=0.1, **{'from': 80.0, 'to': 100.0}
    )
    assert np.allclose(length, far + 6.0)
    assert np.allclose(share, [0.0, 0.1, 0.0])
    length, share = of_ray('fixed_reflector', position=100.0, relative_power=-20.0, phase=0.1)
    assert np.allclose(length[:2], [140.0, 110.0])
    assert np.allclose(share, [0.1 * 60.0 / 140.0, 0.1 * 90.0 / 110.0, 0.0])
    swinging = conceal(nominal(c), [Applied('swinging_echo', None, {
        'excess_range': 6.0, 'relative_power': -20.0, 'swing': 0.1, 'rate': 0.3, 'phase': 0.2
    })])  # fmt: skip
    still = conceal(nominal(c), [Applied('echo', None, {'excess_range': 6.0, 'relative_power': -20.0, 'phase': 0.0})])
    one, other = (generator.heard(s, FIRST, rows, s.rays[-1]) for s in (swinging, still))
    wavelength = generator.SPEED_OF_LIGHT / (c.start_frequency + 0.5 * c.bandwidth)
    moved = 0.1 * np.sin(2.0 * math.pi * 0.3 * swinging.time[rows] + 0.2)
    assert np.allclose(one.turns - other.turns, (moved / wavelength)[:, None], atol=1e-6)
    assert np.allclose(one.amplitude, other.amplitude)
    length, share = of_ray('triple_trip', relative_power=-20.0, phase=0.1)
    assert np.allclose(length, 3.0 * far)
    assert np.allclose(share, 0.1 * (60.0 / far) ** 2)
    scene, _ = with_effect(c, 'rail_bend', height=0.04, length=300.0)
    assert np.allclose(scene.reference()[rows], far - 0.04 * np.sin(math.pi * far / 300.0), atol=1e-12)
    scene, _ = with_effect(c, 'reference_wander', amplitude=0.03, period=100.0, phase=0.2)
    assert np.allclose(
        scene.reference(), scene.distance + 0.03 * np.sin(2.0 * math.pi * scene.time / 100.0 + 0.2), atol=1e-12
    )
    scene, before = with_effect(c, 'delay_step', 'slave', step=2.0, time=scene.time[6])
    assert np.allclose((scene.delay - before.delay)[5:8], [0.0, 2e-9, 2e-9], atol=1e-20)
    scene, before = with_effect(c, 'delay_creep', 'slave', rate=2.0)
    assert np.allclose(scene.delay - before.delay, 2e-12 * scene.time, atol=1e-20)
    scene, before = with_effect(c, 'weather_wander', amplitude=9.0, period=100.0, phase=0.2)
    assert np.allclose(scene.refractivity - before.refractivity, 9.0 * np.sin(2.0 * math.pi * scene.time / 100.0 + 0.2))
    scene, before = with_effect(c, 'air_gradient', gradient=50.0)
    assert np.allclose(scene.refractivity - before.refractivity, 0.05 * scene.distance)
    scene, _ = with_effect(c, 'reference_rounding', step=8.0)
    assert np.allclose(scene.reference()[rows], [60.0, 92.0, 148.0], atol=1e-12)
    scene, _ = with_effect(c, 'reference_backlash', play=0.02, from_afar=(0.0, 1.0, 0.0))
    assert np.allclose((scene.reference() - scene.distance)[rows], [-0.01, 0.01, -0.01], atol=1e-12)
    scene, _ = with_effect(c, 'reference_graduation', amplitude=0.02, period=16.0, phase=0.3)
    assert np.allclose(scene.reference()[rows], far + 0.02 * np.sin(2.0 * math.pi * far / 16.0 + 0.3), atol=1e-12)
    scene, before = with_effect(c, 'gain_temperature', 'slave', slope=0.1)
    assert np.allclose(scene.gain[FIRST], before.gain[FIRST])
    above = scene.board[SECOND] - c.stations[SECOND].calibration_temperature
    assert np.allclose(scene.gain[SECOND] - before.gain[SECOND], 0.1 * above)
