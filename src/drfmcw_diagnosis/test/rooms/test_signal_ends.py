"""When a signal begins and ends within the sweep, also where it hardly stands out of the noise."""

import numpy as np
import pytest

from drfmcw_diagnosis.features import signal_ends
from drfmcw_physics.sweep import SweepSettings

SWEEP = SweepSettings('master', 'slave')
RATE, COUNT, SWEEPS = 2.048e6, 2048, 2000


@pytest.mark.parametrize('iq', [True, False])
@pytest.mark.parametrize('late', [0, 6, 14])
@pytest.mark.parametrize('noise', [0.0, 1.0])
def test_noise_brings_a_signal_neither_forward_nor_back(late, noise, iq):
    """Seed 1; where there is no signal, a magnitude of noise would be one. P(false failure) < 1e-5 (5 sigma each)."""
    random = np.random.default_rng(1)
    turns = 3.1e5 / RATE * np.arange(COUNT) + random.uniform(0.0, 1.0, (SWEEPS, 1))
    samples = np.exp(2j * np.pi * turns)
    samples[:, :late] = 0.0
    samples += noise * (random.standard_normal(samples.shape) + 1j * random.standard_normal(samples.shape))
    found = signal_ends.measured(samples if iq else samples.real, np.full(SWEEPS, 3.1e5), SWEEP)
    mean, std = found.mean(axis=0), found.std(axis=0) / np.sqrt(SWEEPS)
    first = round(SWEEP.analysis_window()[0] * RATE)
    assert abs(mean[0] - min(late, first)) < 5.0 * std[0] + 0.03 * first


@pytest.mark.parametrize('frequency', [3e4, 3.1e5, 9.9e5])
def test_mirror_of_a_real_line_moves_no_end(frequency):
    """Whatever the phase of a line that has half a cycle in these samples, its signal begins with the sweep."""
    turns = frequency / RATE * np.arange(COUNT) + np.linspace(0.0, 1.0, 64, endpoint=False)[:, None]
    found = signal_ends.measured(np.cos(2.0 * np.pi * turns), np.full(64, frequency), SWEEP)
    assert np.all(np.abs(found[:, 0]) < 1e-2)
