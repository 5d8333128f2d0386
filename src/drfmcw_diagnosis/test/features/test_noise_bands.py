"""Noise in bands: what a median over bins shows, and how far it scatters."""

import numpy as np
import pytest

from drfmcw_diagnosis.features.noise_bands import NoiseBands

RATE, BINS, TRIALS = 2e6, 1025, 300


@pytest.mark.parametrize('count', [3, 50])
@pytest.mark.parametrize('slope', [0.0, 2.0, 6.0, 20.0])
def test_medians_scatter_as_stated(count, slope):
    """Seed 1, noise that falls by `slope` decibels a band, under a Hann window. P(false failure) < 1e-6 (5 sigma)."""
    random = np.random.default_rng(1)
    bands = NoiseBands(RATE, [1.5])
    level = 10.0 ** (-0.05 * slope * 8.0 * np.arange(BINS + 2) / BINS)
    line = np.array([3e5])
    found, stated = [], []
    for _ in range(TRIALS):
        noise = level * (random.standard_normal((count, BINS + 2)) + 1j * random.standard_normal((count, BINS + 2)))
        hann = noise[:, 1:-1] - 0.5 * (noise[:, :-2] + noise[:, 2:])
        of_all = np.mean(np.abs(hann) ** 2, axis=0)[None], line, np.array([count])
        found.append(bands.measured(*of_all)[0])
        stated.append(bands.std(*of_all)[0])
    compared = np.isfinite(stated[0])
    ratio = (np.std(found, axis=0) / np.sqrt(np.mean(np.square(stated), axis=0)))[compared]
    assert compared.sum() > 6 and np.all(np.abs(ratio - 1.0) < 5.0 / np.sqrt(2.0 * TRIALS) + 0.1), ratio


@pytest.mark.parametrize('silent', [slice(None), slice(0, BINS, 2), slice(0, 64)])
def test_samples_without_noise_have_a_deviation_all_the_same(silent):
    """Bins of no power at all, as of a receiver that is off, leave no number undefined."""
    power = np.random.default_rng(2).exponential(1.0, (1, BINS))
    power[:, silent] = 0.0
    std = NoiseBands(RATE, [1.5]).std(power, np.array([3e5]), np.array([26]))
    assert not np.any(np.isnan(std)) and np.all(std > 0.0)
