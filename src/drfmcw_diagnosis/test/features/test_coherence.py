"""Coherence of both lines' phase noise, which shows the noisier oscillator."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drfmcw_diagnosis.features.extractor import coherence
from drfmcw_physics.phase_noise import PhaseNoise
from drfmcw_physics.sweep import SweepSettings

SWEEP = SweepSettings(station='master', peer='slave')
LINES = st.tuples(st.floats(60e3, 960e3), st.floats(60e3, 960e3))
DELAYS = st.floats(2e-8, 6e-7)  # of less than a third of a turn at the largest offset


def coherent(used, levels, delay, floor=0.0):
    """Coherence with both corners at 100 kHz."""
    oscillators = np.array([PhaseNoise(level, 100e3).single_sideband(used.offset) for level in levels])
    shape = (2, 2, len(used.offset))
    return coherence.predicted(used, oscillators, np.full(shape, floor), np.ones(shape), delay)


@given(LINES, DELAYS, st.floats(-100.0, -80.0), st.floats(-12.0, 12.0))
def test_without_receiver_noise_it_is_the_share_by_which_one_is_noisier(lines, delay, level, more):
    used = coherence.sidebands(np.array(lines), SWEEP)
    ratio = 10.0 ** (more / 10.0)
    found = coherent(used, (level + more, level), delay)
    share = (ratio - 1.0) / (ratio + 1.0) * np.ones(np.count_nonzero(used.present))
    # shape, delay and which sidebands there are cancel, but for what the delay changes within a band (Cauchy, Schwarz)
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
