"""What the bench compares with does the job that it is compared on."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / 'benchmarks'))
import references  # noqa: E402

RATE = 2.048e6
CHIRP_RATE = 150e9
SWEEPS = 64


@pytest.mark.parametrize('start_delay', [3.41e-6, 0.6e-6])
def test_reference_estimators_find_the_lines(start_delay):
    """Mean of 64 sweeps at k (T_off + tau) and k |T_off - tau|: each scatters by 3 Hz, asserted to 2 Hz, 5 sigma."""
    delay = 700e-9 if start_delay > 1e-6 else 2e-6
    pair = references.two_station_if(SWEEPS, 1, delay, start_delay)
    first, second = CHIRP_RATE * (start_delay + delay), CHIRP_RATE * abs(start_delay - delay)
    for estimate in (references.frequency_by_zoom_fft, references.frequency_by_matrix):
        assert np.mean(estimate(pair[0], RATE)) == pytest.approx(first, abs=2.0)
        assert np.mean(estimate(pair[1], RATE)) == pytest.approx(second, abs=2.0)
    sign = -1 if start_delay > delay else 1
    sums = references.beat_sum_by_product(*pair, RATE, sign)
    assert sums.shape == (SWEEPS,)
    assert np.mean(sums) == pytest.approx(2.0 * CHIRP_RATE * delay, abs=2.0)
