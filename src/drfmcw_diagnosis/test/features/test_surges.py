"""Steady noise of any spectrum surges as white noise does, and a burst surges more."""

import numpy as np
import pytest
from scipy import signal

from drfmcw_diagnosis.features import surges
from drfmcw_diagnosis.features.limits import SURGES
from drfmcw_physics.sweep import SweepSettings

RATE, COUNT, SWEEPS, GROUP = 2.048e6, 2048, 240, 12
SEED = 5
LIMIT = 4.0  # standard deviations; 10 numbers of each of nine tests: 0.6 % false failures


def sweep():
    """Return the settings of a sweep of 2048 samples."""
    return SweepSettings('master', 'slave', ramp_duration=COUNT / RATE, sample_rate=RATE, sample_count=COUNT)


def scored(samples, line):
    """Return mean scores of sweeps beyond those of white noise, over their standard deviations (2 W,)."""
    usual = surges.steady(sweep(), np.iscomplexobj(samples))
    frequency = np.full(GROUP, line)
    groups = samples.reshape(-1, GROUP, samples.shape[1])
    each = [surges.scores(surges.measured(x, frequency, np.hanning(COUNT), sweep())) for x in groups]
    std = usual.std * np.sqrt(1.0 / len(samples) + 1.0 / usual.count)
    return (np.concatenate(each).mean(axis=0) - usual.mean) / std


def noise(kind, random):
    """Return steady noise beside a line at 300 kHz (SWEEPS, COUNT)."""
    time = np.arange(COUNT + 512) / RATE
    start = random.uniform(0.0, 2.0 * np.pi, (SWEEPS, 1))
    white = random.standard_normal((SWEEPS, len(time)))
    angle = 2.0 * np.pi * 3e5 * time + start
    if kind == 'filtered':
        white = signal.lfilter(*signal.butter(2, 0.25), white)
    elif kind == 'phase noise':  # far above the other noise, and falling with the offset from the line
        phase = signal.lfilter(*signal.butter(1, 0.05), random.standard_normal(white.shape))
        white = 0.1 * white + 300.0 * 1e-2 * phase * np.sin(angle)
    elif kind == 'fading':  # a reflection changes the line over each sweep alike, and its noise with it
        white = white * np.sqrt(1.0 + 0.5 * np.cos(2.0 * np.pi * 600.0 * time))
    elif kind == 'tones':  # of an echo and a spur
        white = white + 20.0 * np.cos(2.0 * np.pi * 5.1e5 * time + 2.0 * start) + 5.0 * np.cos(1.9 * angle)
    elif kind == 'complex':
        other = random.standard_normal(white.shape)
        return (300.0 * np.exp(1j * angle) + white + 1j * other)[:, 512:]
    return (300.0 * np.cos(angle) + white)[:, 512:]


@pytest.mark.parametrize('kind', ['white', 'filtered', 'phase noise', 'fading', 'tones', 'complex'])
def test_steady_noise_surges_as_white_noise_does(kind):
    found = scored(noise(kind, np.random.default_rng(SEED)), 3e5)
    assert np.abs(found).max() < LIMIT


@pytest.mark.parametrize('kind', ['white', 'tones', 'complex'])
def test_faint_bursts_surge(kind):
    random = np.random.default_rng(SEED)
    samples = noise(kind, random)
    before = scored(samples, 3e5)
    power = surges.surge_power(128, 5.0)
    for row in range(0, SWEEPS, 5):
        at = random.integers(512, COUNT - 640)
        samples[row, at : at + 128] += np.sqrt(power) * random.standard_normal(128)
    after = scored(samples, 3e5)
    assert after[: len(SURGES.windows)].max() > 2.0 * LIMIT > before.max()


def test_sweeps_too_short_for_it_are_not_compared():
    short = SweepSettings('master', 'slave', ramp_duration=256 / RATE, sample_rate=RATE, sample_count=256)
    assert surges.steady(short, False) is None
    samples = np.random.default_rng(SEED).standard_normal((3, 256))
    assert not surges.measured(samples, np.full(3, 3e5), np.hanning(256), short).any()


def test_a_silent_sweep_is_no_surge_and_costs_the_others_nothing():
    samples = noise('white', np.random.default_rng(SEED))[:GROUP]
    samples[3] = 0.0
    found = surges.measured(samples, np.full(GROUP, 3e5), np.hanning(COUNT), sweep())
    assert np.isfinite(found).all()
    assert found[3, :-1].max() <= 0.0
    assert found[:3, -1].min() > 0.5
