"""When a signal begins and ends within the sweep, however weak it is, and how its line begins."""

import numpy as np
import pytest
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.features import signal_ends
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_physics.sweep import SweepSettings
from drfmcw_sim.effects import Effect

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


@pytest.mark.parametrize('iq', [True, False])
@pytest.mark.parametrize('frequency', [9e4, 3.1e5, 9e5])
@pytest.mark.parametrize('turned', [0.0, 0.1])
def test_a_line_that_begins_turned_shows_by_how_much(iq, frequency, turned):
    """Of any phase, and beside the mirror of a real line; the last span begins as the line goes on."""
    turns = frequency / SWEEP.sample_rate * np.arange(SWEEP.sample_count) + np.linspace(0.0, 1.0, 32)[:, None]
    (begin, end), (_, last) = signal_ends.onset_spans(SWEEP)
    turns[:, begin:end] += turned / (2.0 * np.pi)
    samples = 40.0 * np.exp(2j * np.pi * turns)
    found = signal_ends.onset(samples if iq else samples.real, np.full(32, frequency), SWEEP)
    expected = np.exp(1j * turned) - 1.0
    assert last == round(SWEEP.analysis_window()[0] * SWEEP.sample_rate)
    np.testing.assert_allclose(found, np.tile([expected.real, 0.0, expected.imag, 0.0], (32, 1)), atol=2e-3)


def test_first_samples_show_at_which_station_a_synthesiser_settles():
    """The same settling at the other station, the other way round, is there when the peer's signal begins."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    values = {'natural_frequency': 2.1e4, 'damping': 0.5}
    own, other = (
        comparison.template([Effect.registry['pll_settling'](step=step, station=station, **values)])
        for step, station in ((1500.0, 'slave'), (-1500.0, 'master'))
    )
    of_onset = comparison.entries.where(kind='onset')

    def apart(rows):
        """What of one no size of the other explains (n,)."""
        size = (own[rows] @ other[rows]) / (other[rows] @ other[rows])
        return float(np.sum((own[rows] - size * other[rows]) ** 2))

    assert apart(np.ones(len(own), bool)) > 1.5 * apart(~of_onset)
