"""What the comparison counts of an effect, against what theory gives."""

import math

import numpy as np
import pytest
from checkout import DATA
from scenes import record, scene

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_physics.constants import DECIBELS_PER_NEPER
from drfmcw_sim.effects import Effect


def test_all_of_an_amplitude_slope_counts_but_its_mean():
    """A slope of s Np per sample over K samples has s^2 (K^3 - K) / 12 beside its mean."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    slope = 0.05
    template = comparison.template((Effect.registry['amplitude_slope'](station='slave', slope=slope),))
    std = comparison.std['ramp'][:, 1]  # amplitude at the second station
    assert np.isinf(std[:, 0]).all() and np.isfinite(std[:, 1:]).all()
    terms, step = std.shape[1], comparison.time[1] - comparison.time[0]
    each = slope / DECIBELS_PER_NEPER * step / 1e-3
    whole = each**2 * (terms**3 - terms) / 12.0
    expected = math.sqrt(np.sum(whole / std[:, 1] ** 2))
    counted = template[comparison.entries.where(kind='ramp', station=1)]
    assert np.linalg.norm(counted) == pytest.approx(expected, rel=0.03)


def test_noise_behind_a_coupling_is_as_expected(tmp_path):
    """Its bands next to 0 Hz rise with the square of the frequency; chi-square fails with a chance of 1e-6."""
    coupling = {'effect': 'ac_coupling', 'station': 'slave', 'pole': 600e3}
    standing = {'distances': [120.0, 210.0, 320.0], 'sweeps': 40}
    scenario = scene({'standing': standing}, effects=[coupling], reference={'range_std': 0.005})
    comparison = Comparison(read_dataset(record(scenario, tmp_path / 'r')))
    template = comparison.template((Effect.registry['ac_coupling'](station='slave', pole=600e3),))
    left = (comparison.residual - template)[comparison.entries.where(kind='noise', station=1)]
    left = left[np.isfinite(left)]
    assert np.sum(left**2) < len(left) + 5.0 * math.sqrt(2.0 * len(left)) + 10.0
