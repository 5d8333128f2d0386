"""Where in a remainder the search begins: distortions take long to simulate, so few of them are tried."""

import math

import numpy as np
import pytest
from checkout import DATA
from scenes import record, scene

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.starts.scanners import starting_points
from drfmcw_diagnosis.search.starts.scanning import Rest
from drfmcw_diagnosis.search.starts.swaying import Swaying
from drfmcw_sim.effects import Effect


def begun(comparison, effect, station, least=0.0):
    """Return where an effect's search begins in what a comparison leaves without any effect."""
    rest = Rest(comparison, comparison.residual, comparison.distances(()), least)
    return starting_points(rest, Effect.registry[effect].recipes[0], station)


@pytest.mark.parametrize('share', [-0.2, -0.02, 0.05, 0.25])
def test_a_curve_is_sought_by_the_sign_and_size_of_its_third_harmonics(share):
    """In data without noise: one of the starts has its sign, and half to twice its size, or the least size tried.

    That is 0.03 of the line; others are a factor of about three apart.
    """
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    strongest = float(comparison.measured.amplitude[:, 0].max()) / 20.0
    line = 10.0**strongest / float(comparison.data.full_scale[0].max())
    curve = Effect.registry['compression'](station='master', third_order=share / (0.75 * line**2))
    comparison.residual = comparison.template([curve])
    starts = [point['third_order'] * 0.75 * line**2 for point in begun(comparison, 'compression', 0)]
    assert min(abs(math.log(s / share)) for s in starts if s * share > 0.0) < math.log(
        max(2.0, 0.03 / abs(share)) + 0.1
    )
    assert len(starts) <= 3


def test_a_limit_is_sought_only_where_samples_pile_up(tmp_path):
    """Noise makes a spectrum as suspicious as a limit does, and piles up nothing. The recordings are fixed."""
    standing = {'standing': {'distances': [30.0, 60.0, 90.0], 'sweeps': 12}}
    noise = {'effect': 'noise_floor', 'station': 'slave', 'excess': 6.0}
    noisy = Comparison(read_dataset(record(scene(standing, effects=[noise]), tmp_path / 'noisy')))
    assert begun(noisy, 'compression', 1)  # suspicious
    assert not begun(noisy, 'clipping', 1)
    level = float(noisy.measured.amplitude[:, 1].max())
    level -= 20.0 * math.log10(float(noisy.data.full_scale[1].max())) + 1.0
    limiter = {'effect': 'clipping', 'station': 'slave', 'level': level}
    limited = Comparison(read_dataset(record(scene(standing, effects=[limiter]), tmp_path / 'limited')))
    assert min(abs(point['level'] - level) for point in begun(limited, 'clipping', 1)) < 0.1


@pytest.mark.parametrize(
    ('effect', 'station', 'values', 'apart'),
    [
        ('ground_reflection', -1, {'height_product': 70.3, 'coefficient': 0.02}, 0.2),
        ('ground_reflection', -1, {'height_product': 350.0, 'coefficient': -0.05}, 0.2),
        ('spur', 1, {'frequency': 3.1e5, 'level': -60.0}, 500.0),
        ('spur', 0, {'frequency': 7.2e5, 'level': -75.0}, 500.0),
    ],
)
def test_what_cannot_gain_enough_is_not_begun(effect, station, values, apart):
    """In data without noise: an effect is sought where all that it gains is wanted, and nowhere if four times that is.

    Its most conspicuous numbers show at least half of the gain.
    """
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    kind = Effect.registry[effect]
    built = kind(**values, station=comparison.receivers[station]) if station >= 0 else kind(**values)
    comparison.residual = comparison.template([built])
    gain = float(comparison.residual @ comparison.residual)
    scanned = kind.recipes[0].scanned
    found = [abs(point[scanned] - values[scanned]) for point in begun(comparison, effect, station, gain)]
    assert min(found) < apart
    assert not begun(comparison, effect, station, 4.0 * gain)


def test_a_sway_gains_what_least_squares_make_of_it():
    """Exactly, by cosine and sine of its frequency, about the mean of each group and with the means. Seed 4."""
    random = np.random.default_rng(4)
    groups = slice(0, 5), slice(5, 12), slice(12, 31)
    time = np.repeat([0.0, 40.0, 95.0], [5, 7, 19]) + np.sort(random.uniform(0.0, 2.0, 31))
    numbers = {'movement': random.standard_normal(31), 'weight': random.uniform(0.5, 2.0, 31)}
    means = {'error': random.standard_normal(3), 'weight_of_mean': random.uniform(0.5, 2.0, 3)}
    first, second = np.array([0.1, 0.4, 2.0]), np.array([0.0, 0.013])
    alone, with_means = Swaying(time, groups, **numbers, **means).gains(first, second)
    for at in np.ndindex(alone.shape):
        angle = 2.0 * np.pi * (first[at[0]] + second[at[1]]) * time
        wave = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        of_groups = np.array([wave[g].mean(axis=0) for g in groups])
        apart = (wave - np.repeat(of_groups, [5, 7, 19], axis=0)) * numbers['weight'][:, None]
        both = np.concatenate([apart, of_groups * means['weight_of_mean'][:, None]])
        z = np.concatenate([numbers['movement'], means['error']])
        for model, measured, gain in ((apart, z[:31], alone[at]), (both, z, with_means[at])):
            left = measured - model @ np.linalg.lstsq(model, measured, rcond=None)[0]
            assert gain == pytest.approx(measured @ measured - left @ left, rel=1e-9)


@pytest.mark.parametrize('frequency', [0.2407, 0.64, 0.8517, 1.1])
def test_a_sway_is_separated_from_its_aliases(frequency):
    """In data without noise: it comes first, although others a turn per pause off gain as much within 0.1 %."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    comparison.residual = comparison.template([Effect.registry['sway'](amplitude=0.13, frequency=frequency, phase=0.3)])
    found = [point['frequency'] for point in begun(comparison, 'sway', -1)]
    assert found[0] == pytest.approx(frequency, abs=1e-5)
    assert len(found) > 1
