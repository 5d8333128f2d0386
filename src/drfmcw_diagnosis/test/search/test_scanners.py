"""Where in a remainder the search begins: distortions take long to simulate, so few of them are tried."""

import math

import pytest
from checkout import DATA
from scenes import record, scene

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.starts.scanners import starting_points
from drfmcw_diagnosis.search.starts.scanning import Rest
from drfmcw_sim.effects import Effect


def begun(comparison, effect, station):
    """Return where an effect's search begins in what a comparison leaves without any effect."""
    rest = Rest(comparison, comparison.residual, comparison.distances(()))
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
