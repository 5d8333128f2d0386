"""Coherence of both lines' phase noise, which shows the noisier oscillator."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drfmcw_diagnosis.features.extractor import coherence
from drfmcw_physics.phase_noise import PhaseNoise, around_line
from drfmcw_physics.sweep import Mode, Role, SweepSettings

SWEEP = SweepSettings(station='master', peer='slave')
PAIR = SWEEP, dataclasses.replace(SWEEP, station='slave', peer='master', role=Role.SECOND)
LINES = st.tuples(st.floats(60e3, 960e3), st.floats(60e3, 960e3))
DELAYS = st.floats(2e-8, 6e-7)  # of less than a third of a turn at the largest offset


def coherent(used, levels, delay, floor=0.0):
    """Coherence with both corners at 100 kHz."""
    oscillators = [PhaseNoise(level, 100e3) for level in levels]
    shape = (2, 2, len(used.offset))
    return coherence.predicted(used, oscillators, PAIR, np.full(shape, floor), np.ones(shape), delay)


@given(LINES, DELAYS, st.floats(-160.0, -140.0), st.floats(-12.0, 12.0))
def test_without_receiver_noise_it_is_the_share_by_which_one_is_noisier(lines, delay, level, more):
    used = coherence.sidebands(np.array(lines), SWEEP)
    ratio = 10.0 ** (more / 10.0)
    found = coherent(used, (level + more, level), delay)
    share = (ratio - 1.0) / (ratio + 1.0) * np.ones(np.count_nonzero(used.present))
    # in weak noise shape, delay and which sidebands there are cancel, but for what the delay changes within a band
    # (Cauchy, Schwarz)
    assert np.all(np.abs(found[used.present]) <= np.abs(share) + 1e-9)
    assert found[used.present] == pytest.approx(share, rel=0.15, abs=1e-9)
    assert not found[~used.present].any()


@given(LINES, DELAYS, st.floats(-100.0, -80.0), st.floats(1.0, 12.0), st.floats(1e-11, 1e-8))
def test_exchanged_stations_change_its_sign_and_receiver_noise_its_size(lines, delay, level, more, floor):
    used = coherence.sidebands(np.array(lines), SWEEP)
    one, two = (coherent(used, levels, delay, floor) for levels in ((level + more, level), (level, level + more)))
    assert one == pytest.approx(-two, abs=1e-12)
    assert np.all(np.abs(one) <= np.abs(coherent(used, (level + more, level), delay)) + 1e-12)
    assert coherent(used, (level, level), delay, floor) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ('mode', 'lines', 'levels', 'delay'),
    [
        (Mode.SHORT_DISTANCE, (475e3, 440e3), (-90.0, -59.7), 0.12e-6),
        (Mode.SHORT_DISTANCE, (622e3, 294e3), (-90.0, -55.0), 1.0e-6),
        (Mode.LONG_DISTANCE, (800e3, 810e3), (-60.0, -65.0), 0.5e-6),  # upper sidebands of both end at Nyquist
        (Mode.LONG_DISTANCE, (200e3, 810e3), (-65.0, -60.0), 0.5e-6),
    ],
)
def test_strong_phase_noise_is_predicted_to_all_orders(mode, lines, levels, delay):
    """Against lines whose phases were drawn: up to 2 rad^2, where the first order alone is off by more than 0.1.

    Seed 5. Of 8 bands, each 4.5 standard errors and 0.015: a false failure in 5e-5 of all draws.
    """
    rng, draws = np.random.default_rng(5), 500
    sweeps = [dataclasses.replace(s, mode=mode) for s in PAIR]
    rate, count = SWEEP.sample_rate, SWEEP.sample_count
    oscillators = [PhaseNoise(level, 107e3) for level in levels]
    frequency = np.fft.rfftfreq(2 * count, 1.0 / rate)
    own, late = [], []
    for o in oscillators:
        drawn = rng.normal(size=(2, draws, len(frequency))) * np.sqrt(o.phase_density(frequency) * count * rate / 2.0)
        spectrum = drawn[0] + 1j * drawn[1]
        own.append(np.fft.irfft(spectrum)[:, :count])
        late.append(np.fft.irfft(spectrum * np.exp(-2j * np.pi * frequency * delay))[:, :count])
    phases = own[0] - late[1], late[0] - own[1]
    time = np.arange(count) / rate
    samples = [
        np.cos(2.0 * np.pi * f * time + s.line_sign() * p + rng.uniform(0.0, 6.0, (draws, 1))).astype(np.float32)
        for f, s, p in zip(lines, sweeps, phases, strict=True)
    ]
    window = np.hanning(count) / np.hanning(count).sum()
    still = np.zeros(draws)
    shares = coherence.measured(samples, np.tile(lines, (draws, 1)), np.zeros(2), still, [window, window], sweeps)
    used = coherence.sidebands(np.array(lines), SWEEP)
    sides = np.array(lines)[:, None, None] + np.stack([used.offset, -used.offset])
    mirrors = around_line(oscillators, sides + np.array(lines)[:, None, None], rate)
    expected = coherence.predicted(used, oscillators, sweeps, mirrors, np.ones(mirrors.shape), delay)
    assert np.all(np.abs(shares.mean(axis=0) - expected) < 0.015 + 4.5 * shares.std(axis=0) / np.sqrt(draws))
