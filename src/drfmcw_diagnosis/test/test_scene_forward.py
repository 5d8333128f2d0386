"""Lines of a scene and what acts on all of them, on sweeps of a generator of its own: phases integrated numerically."""

import math

import numpy as np
import pytest

from drfmcw_diagnosis.scene.bursts import bursts
from drfmcw_diagnosis.scene.forward.agreement import agreement
from drfmcw_diagnosis.scene.forward.model import moving, multiples, scene, straight
from drfmcw_diagnosis.scene.forward.naming import named
from drfmcw_diagnosis.scene.forward.outcome import of_bursts
from drfmcw_diagnosis.scene.material import Material
from drfmcw_diagnosis.scene.noise import noise

RATE, COUNT, BANDWIDTH, START = 10e6, 500, 0.5e9, 24e9
DURATION = COUNT / RATE
FINE = 16  # points per sample at which the frequency is integrated
FULL_SCALE = 2048.0
PATHS = ((33.0, 200.0), (51.0, 300.0), (64.0, 250.0), (80.0, 200.0), (107.0, 150.0))  # [m], [LSB]


def sweeps(seed, error=None, envelope=None, after=None, paths=PATHS, count=18, iq=False, noise_std=1.0, turning=0.0):
    """Sweeps of a homodyne radar (count, COUNT) [LSB]: the transmit phase is the running sum of its frequency.

    Args:
        seed: of phases and noise.
        error: of the frequency over the time in the sweep [Hz].
        envelope: factor on all lines over that time.
        after: what the receiver does to the sum of all lines before noise.
        paths: length and amplitude of each.
        count: sweeps.
        iq: quadrature samples.
        noise_std: of each real number [LSB].
        turning: path by which the last line moves from sweep to sweep [m].
    """
    generator = np.random.default_rng(seed)
    before = 64
    fine = (np.arange((COUNT + before) * FINE + 1) - before * FINE) / (RATE * FINE)
    bent = BANDWIDTH / DURATION * fine + (error(fine) if error else 0.0)
    # trapezoids
    turns = np.concatenate([[0.0], np.cumsum(0.5 * (bent[1:] + bent[:-1]))]) / (RATE * FINE)
    time = np.arange(COUNT) / RATE
    own = np.interp(time, fine, turns)
    rows = []
    for sweep in range(count):
        total = np.zeros(COUNT, complex)
        for number, (path, amplitude) in enumerate(paths):
            delay = (path + turning * sweep * (number == len(paths) - 1)) / 299792458.0
            phase = START * delay + own - np.interp(time - delay, fine, turns)
            total += amplitude * np.exp(2j * np.pi * phase)
        total *= envelope(time) if envelope else 1.0
        x = total if iq else total.real
        x = after(x, time, sweep) if after else x
        x = x + noise_std * (generator.normal(size=COUNT) + (1j * generator.normal(size=COUNT) if iq else 0.0))
        rows.append(np.rint(x.real) + 1j * np.rint(x.imag) if iq else np.rint(x))
    return np.array(rows)


def material(signal):
    return Material('radar', signal, RATE, START, BANDWIDTH, DURATION, FULL_SCALE, np.zeros(len(signal), int))


def explained(signal):
    """Names found, names listed as well, and the misfit before and after."""
    alone = straight(scene(material(signal)))
    found = named(alone, 1e-3)
    if found is None:
        return [], [], alone, None
    others = [c.effect for x, _ in found.rivals for c in x.candidates]
    return [c.effect for c in found.fitted.candidates], others, alone, found


def settling(level):
    return lambda x, t, _: x + level * np.exp(-t / 4e-6)


EFFECTS = {
    'curvature': ('sweep_curvature', {'error': lambda t: 1e6 * 4 * (t / DURATION) * (1 - t / DURATION)}),
    'strong slow ripple': (
        'sweep_ripple',
        {'error': lambda t: 15e6 * np.sin(2 * np.pi * 2.3 * t / DURATION) * (t > 0)},
    ),
    'distortion': ('second_order_distortion', {'after': lambda x, t, _: x + 2e-5 * x**2}),
    'strong settling': ('receiver_settling', {'after': settling(800.0)}),
    'slope': ('amplitude_slope', {'envelope': lambda t: 10 ** (-1.0 * t / DURATION / 20)}),
}
"""What acts on all lines alike."""


@pytest.mark.parametrize(('name', 'how'), EFFECTS.values(), ids=EFFECTS)
def test_an_effect_on_all_lines_is_named(name, how):
    """Right, or listed; one seed each. What is held out is noise afterwards, within what integration costs."""
    names, others, alone, found = explained(sweeps(5, **how))
    assert alone.held_out.probability < 0.01 or len(alone.tracks) > len(PATHS)
    assert name in names or name in others
    assert found.outside.per_freedom < 1.1


def test_a_ripple_is_found_in_clutter_of_more_lines_than_are_fitted():
    """60 returns, of which 24 are fitted: the lines that are left do not hide it; one seed."""
    generator = np.random.default_rng(2)
    paths = [(path, 100.0 * 10.0 ** generator.uniform(-0.5, 0.3)) for path in generator.uniform(25.0, 120.0, 60)]
    names, _, _, found = explained(sweeps(5, lambda t: 1e6 * np.sin(2 * np.pi * 120e3 * t), paths=paths, count=18))
    assert names == ['sweep_ripple']
    values = found.fitted.candidates[0].values
    assert abs(values['rate'] / 120e3 - 1.0) < 0.02 and abs(abs(values['deviation']) / 1e6 - 1.0) < 0.1


def cluttered(error, seed=5):
    """Sweeps with 60 returns at rest, settling that repeats, and three targets that move, on a ramp with an error."""
    generator = np.random.default_rng(seed)
    at_rest = [(path, 100.0 * 10.0 ** generator.uniform(-0.5, 0.3)) for path in generator.uniform(25.0, 120.0, 60)]
    still = sweeps(seed, error, paths=at_rest, count=48, noise_std=0.0, after=settling(400.0))
    targets = ((40.0, 60.0, 0.013), (66.0, 40.0, -0.017), (90.0, 40.0, 0.011))
    return still + sum(
        sweeps(seed + i, error, paths=((path, level),), count=48, turning=turning)
        for i, (path, level, turning) in enumerate(targets)
    )


def test_targets_that_move_show_a_ripple_behind_a_crowd_at_rest():
    """The crowd and what repeats with the ramp leave much unexplained; targets show one size each; one seed."""
    static = straight(scene(material(cluttered(lambda t: 5e5 * np.sin(2 * np.pi * 120e3 * t)))))
    assert static.held_out.per_freedom > 5.0
    alone = straight(moving(static.scene))
    found = named(alone, 1e-3)
    assert [c.effect for c in found.fitted.candidates] == ['sweep_ripple']
    values = found.fitted.candidates[0].values
    assert abs(values['rate'] / 120e3 - 1.0) < 0.02 and abs(abs(values['deviation']) / 5e5 - 1.0) < 0.1
    sizes = agreement(alone.scene, found.fitted)
    assert sizes.agrees and np.all(np.abs(sizes.size - 1.0) < np.maximum(5.0 * sizes.std, 0.05))


def test_targets_that_move_on_a_straight_ramp_leave_noise():
    """Behind a crowd at rest, at a false-alarm rate of 0.1 %, and nothing is named; one seed."""
    static = straight(scene(material(cluttered(None))))
    assert static.held_out.probability < 1e-3
    alone = straight(moving(static.scene))
    assert alone.held_out.probability > 1e-3
    assert named(alone, 1e-3) is None


@pytest.mark.parametrize('iq', [False, True])
def test_lines_in_noise_are_consistent(iq):
    """100 scenes at a false-alarm rate of 1 %: 6 or more fail with a chance of 5e-4."""
    failing = 0
    for seed in range(100):
        generator = np.random.default_rng(seed)
        paths = [(path, 10.0 ** generator.uniform(0.5, 2.5)) for path in generator.uniform(10.0, 130.0, 4)]
        alone = straight(scene(material(sweeps(seed, paths=paths, iq=iq, turning=1e-3))))
        failing += alone.held_out.probability < 0.01
    assert failing <= 5


def test_a_single_sweep_of_lines_is_consistent():
    """100 scenes, blocks of samples held out; bound as above."""
    chances = [straight(scene(material(sweeps(seed, count=1)))).held_out.probability for seed in range(100)]
    assert sum(x < 0.01 for x in chances) <= 5


@pytest.mark.parametrize('iq', [False, True])
@pytest.mark.parametrize('error', [None, lambda t: 2e6 * np.sin(2 * np.pi * 120e3 * t)])
def test_noise_is_measured_beside_lines_whatever_their_spectrum(iq, error):
    """Within 4 %: 4 standard deviations of the noise of 12 000 numbers, and the rounding's twelfth."""
    found = noise(sweeps(3, count=24, iq=iq, error=error, noise_std=2.0))
    assert abs(found.mean / ((4.0 + 1.0 / 12.0) * (2.0 if iq else 1.0)) - 1.0) < 0.08


def test_settling_of_the_ramp_is_no_burst():
    error = lambda t: np.where(t > 0, 5e6 * np.exp(-np.abs(t) / 5e-6) * np.cos(2 * np.pi * 100e3 * t), 0.0)  # noqa: E731
    m = material(sweeps(4, error=error, turning=6e-4, count=48))
    found = bursts(m)
    assert found is None or of_bursts(m, found, 1e-3) is None


def test_bursts_of_some_sweeps_are_beyond_chance():
    """Bursts of 30 samples, 20 dB above the noise, in 12 of 48 sweeps."""
    generator = np.random.default_rng(6)
    x = sweeps(6, count=48)
    for row in generator.permutation(48)[:12]:
        first = generator.integers(40, COUNT - 40)
        x[row, first : first + 30] += np.rint(generator.normal(0.0, 10.0, 30))
    m = material(x)
    result = of_bursts(m, bursts(m), 1e-3)
    assert result is not None
    assert result.fit.held_out.after < result.fit.held_out.before
    assert math.exp(-result.gain) < 1e-6


def test_a_cubic_law_of_one_line_is_compression_or_said_to_be_multiples():
    x = sweeps(7, paths=((60.0, 600.0),), after=lambda x, t, _: x - 0.15 * x**3 / 1000.0**2)
    names, others, alone, _ = explained(x)
    assert 'compression' in [*names, *others] or (not names and multiples(alone))
