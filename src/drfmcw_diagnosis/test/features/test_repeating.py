"""What repeats in each sweep beside a line, and what is noise."""

import numpy as np
import pytest

from drfmcw_diagnosis.features.noise_bands import edges_of
from drfmcw_diagnosis.features.repeating import repeating_share

RATE, COUNT, SWEEPS = 2.048e6, 2048, 24


def sweeps(line, jump, noise, seed):
    """Return sweeps of a real line of random phase and scattered frequency whose phase jumps in mid-sweep."""
    generator = np.random.default_rng(seed)
    frequency = line + generator.normal(0.0, 300.0, SWEEPS)
    start = generator.uniform(0.0, 2.0 * np.pi, SWEEPS)
    phase = 2.0 * np.pi * frequency[:, None] / RATE * np.arange(COUNT) + start[:, None]
    phase[:, COUNT // 2 :] += jump
    return np.cos(phase) + noise * generator.normal(size=phase.shape), frequency


@pytest.mark.parametrize('line', [93e3, 400e3, 871e3])
def test_noise_shares_nothing(line):
    """Median over 128 bins of 1/24 of a power: below 0.1 in each band, with a false failure in less than 1e-6."""
    samples, frequency = sweeps(line, 0.0, 0.1, 1)
    share = repeating_share(samples, frequency, RATE)
    assert len(share) == len(edges_of(COUNT // 2 + 1)) - 1
    assert np.nanmax(share) < 0.1


@pytest.mark.parametrize('line', [93e3, 400e3, 871e3])
def test_a_jump_of_the_phase_repeats(line):
    """It fills all bands. Its mirror does too, which turns against it: as strong as it is far from the line."""
    samples, frequency = sweeps(line, 2.0, 1e-4, 2)
    share = repeating_share(samples, frequency, RATE)
    assert np.nanmin(share) > 0.2
    assert np.nanmax(share) > 0.8
