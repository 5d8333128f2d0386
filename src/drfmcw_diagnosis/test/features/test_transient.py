"""Means of the samples after the begin of a signal, at the phase of its line."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drfmcw_diagnosis.features import transient
from drfmcw_diagnosis.features.spectra import at_line, turning
from drfmcw_node.estimators.spectral import window_samples
from drfmcw_physics.sweep import SweepSettings

RATE, COUNT = 2.048e6, 2048
SWEEP = SweepSettings('master', 'slave')
PHASES = np.arange(16) / 16.0  # of the line, in turns


def means(samples, frequency):
    """Complex means over both spans and phases (n, V) of lines that begin at sample 0."""
    weights = window_samples('hann', *SWEEP.analysis_window(), RATE, COUNT)
    lines = np.full(len(samples), frequency)
    real, imaginary = np.split(transient.measured(samples, lines, weights / weights.sum(), SWEEP), 2, axis=1)
    return real + 1j * imaginary


@given(st.integers(1, 3000), st.booleans(), st.integers(0, 2**32 - 1))
def test_two_tables_turn_as_each_sample_does(count, is_iq, seed):
    """To the rounding of float32, whatever the number of samples."""
    random = np.random.default_rng(seed)
    samples = random.standard_normal((3, count)) + 1j * is_iq * random.standard_normal((3, count))
    samples = samples if is_iq else samples.real
    cycles, weights = random.uniform(-0.5, 0.5, 3), random.uniform(0.0, 1.0, count)
    turned = np.exp(-2j * np.pi * cycles[:, None] * np.arange(count))
    np.testing.assert_allclose(turning(-cycles, 0, count), turned, atol=1e-6)
    np.testing.assert_allclose(at_line(samples, cycles, weights), np.sum(samples * weights * turned, axis=1), atol=1e-4)


@pytest.mark.parametrize('is_iq', [False, True])
def test_a_line_leaves_nothing(is_iq):
    turns = 3e5 / RATE * np.arange(COUNT) + PHASES[:, None]
    line = np.exp(2j * np.pi * turns) if is_iq else np.cos(2.0 * np.pi * turns)
    assert np.abs(means(1000.0 * line, 3e5)).max() < 1e-5


def test_what_fades_with_the_lines_phase_is_its_mean_over_sweeps():
    """A high-pass of pole p adds Re(a p / (p + j f)) exp(-2 pi p t) with the sign reversed to a line that begins."""
    frequency, pole = 3e5, 1e4
    t = np.arange(COUNT) / RATE
    line = np.exp(2j * np.pi * (frequency * t + PHASES[:, None]))
    share = pole / (pole + 1j * frequency)
    fading = np.exp(-2.0 * np.pi * pole * t)
    constant = 0.01  # of a receiver, at no phase of the line
    samples = (line - share * np.exp(2j * np.pi * PHASES[:, None]) * fading).real + constant
    found = means(samples, frequency).mean(axis=0)
    for (begin, end), value in zip(np.round(transient.times(SWEEP) * RATE).astype(int), found, strict=True):
        # half of a real line is its analytic one; beside it a fading mean is nearly its own mean
        assert value == pytest.approx(-share * fading[begin:end].mean(), rel=0.1, abs=1e-5)


def test_a_bent_ramp_leaves_hardly_anything():
    """A line whose frequency changes by 2 kHz over the sweep turns by half a period beside one of its mean."""
    t = np.arange(COUNT) / RATE
    turns = 3e5 * t + 1e6 * ((t - 5e-4) ** 2 - 2.5e-7) + PHASES[:, None]
    assert np.abs(means(np.cos(2.0 * np.pi * turns), 3e5).mean(axis=0)).max() < 5e-4
