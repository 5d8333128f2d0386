"""Blocks of the ramp that scatter far more than others are found, and leave no trace."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drfmcw_diagnosis.features import uneven_blocks

SEED, SWEEPS, CHANNELS, BLOCKS, PHASES = 3, 10, 4, 127, 2


def steady(random):
    """Return ramps of steady noise (SWEEPS, CHANNELS, BLOCKS)."""
    return random.standard_normal((SWEEPS, CHANNELS, BLOCKS))


def test_steady_noise_has_no_uneven_block():
    """Of 1e6 blocks of ten sweeps; a scatter of four times the usual has a chance of less than 1e-20 each."""
    random = np.random.default_rng(SEED)
    assert not any(uneven_blocks.uneven([steady(random)]).any() for _ in range(2000))


def test_a_block_of_a_phase_of_its_own_in_each_sweep_is_found():
    random = np.random.default_rng(SEED)
    ramps = [steady(random) for _ in range(8)]
    for ramp in ramps[2:6]:
        ramp[:, 1, :2] += 20.0 * random.standard_normal((SWEEPS, 2))
    ramps[7][:, 0, 5] += 20.0 * random.standard_normal(SWEEPS)  # as a burst does
    found = uneven_blocks.uneven(ramps)
    assert list(zip(*np.nonzero(found), strict=True)) == [(g, 1, block) for g in range(2, 6) for block in (0, 1)]


@given(st.integers(0, 2**32 - 1))
def test_what_is_left_out_changes_nothing_and_each_sweep_keeps_its_level_and_frequency(seed):
    """Whatever stands in blocks left out, as a whole turn between them and the others, the rest is the same."""
    random = np.random.default_rng(seed)
    ramp = steady(random)
    left_out = random.random((CHANNELS, BLOCKS)) < 0.05
    left_out[:, 0] = True
    once = uneven_blocks.without(ramp, left_out, PHASES)
    other = np.where(left_out, 30.0 * random.standard_normal(ramp.shape), ramp + 5.0)
    other[:, PHASES:] += 0.1 * np.arange(BLOCKS) * ~left_out[PHASES:]
    np.testing.assert_allclose(uneven_blocks.without(other, left_out, PHASES), once, atol=1e-9)
    np.testing.assert_allclose(uneven_blocks.without(once, left_out, PHASES), once, atol=1e-9)
    assert not once[:, left_out].any()


def test_ramps_without_uneven_blocks_stay_as_they_are():
    ramp = steady(np.random.default_rng(SEED))
    assert np.array_equal(uneven_blocks.without(ramp, np.zeros((CHANNELS, BLOCKS), bool), PHASES), ramp)
