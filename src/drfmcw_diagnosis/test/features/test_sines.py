"""Sines of random phase are taken out of the terms of sweeps, and the noise around them keeps its size."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drfmcw_diagnosis.features.sines import strongest, waves, without, without_strong

BLOCKS = 128
FIRST = 3
STD = np.geomspace(2.0, 0.5, BLOCKS)
"""Noise of the terms, stronger near the line."""


def noise(generator, groups=6, sweeps=24):
    return [STD * generator.standard_normal((sweeps, BLOCKS)) for _ in range(groups)]


def modulated(generator, number, size, groups=6, sweeps=24):
    """Return noise with a wave of one size and a random phase in each sweep."""
    phase = generator.uniform(0.0, 2.0 * math.pi, (groups, sweeps))
    wave = waves(BLOCKS).terms[number]
    sines = size * np.stack([np.cos(phase), np.sin(phase)], axis=-1) @ wave
    return [values + own for values, own in zip(noise(generator, groups, sweeps), sines, strict=True)]


@given(st.integers(0, len(waves(BLOCKS).frequency) - 1), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_nothing_stays_of_a_wave(number, cosine, sine):
    wave = np.array([[cosine, sine]]) @ waves(BLOCKS).terms[number]
    left = without(wave, STD, number, 0)
    assert np.abs(left).max() < 1e-6 * max(1.0, np.abs(wave).max())


@pytest.mark.parametrize('number', [40, 150, 400])
def test_modulation_of_random_phase_is_found_and_the_noise_keeps_its_size(number):
    """The variance of each eighth of the terms stays within 15 %: five deviations. The seed is fixed."""
    series = modulated(np.random.default_rng(20261125), number, 8.0)
    stds = [STD] * len(series)
    found, gain = strongest([s - s.mean(axis=0) for s in series], stds, FIRST)
    period = 1.0 / (BLOCKS - 1)
    assert abs(waves(BLOCKS).frequency[found] - waves(BLOCKS).frequency[number]) < 0.25 * period
    assert gain > 2.0
    left = np.concatenate(without_strong(series, stds, FIRST)) / STD
    for part in np.array_split(np.arange(FIRST, BLOCKS), 8):
        assert np.mean(left[:, part] ** 2) == pytest.approx(23.0 / 24.0, rel=0.15)


def test_noise_alone_is_left_as_it_is():
    """No sine is taken out of 20 recordings of noise: one is in a thousand of them. The seed is fixed."""
    generator = np.random.default_rng(7)
    for _ in range(20):
        series = noise(generator)
        for values, left in zip(series, without_strong(series, [STD] * len(series), FIRST), strict=True):
            np.testing.assert_array_equal(left, values - values.mean(axis=0))
