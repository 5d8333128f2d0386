"""Codes of an ADC: even whatever the signal, uneven where bits stick or codes are missing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.features.adc_codes import evenness, piled
from drfmcw_diagnosis.features.limits import CODES
from drfmcw_diagnosis.finding.views import locations
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.leftovers import leftovers
from drfmcw_proof.cases.concealing import Applied, conceal
from drfmcw_proof.cases.draws import Extent, random_condition
from drfmcw_proof.generator.model import nominal
from drfmcw_proof.generator.recordings import write_recording

NOISE = 9.0


def sampled(seed, amplitude=400.0, count=400_000, noise=NOISE):
    """Codes of sweeps with lines of random phases among noise [LSB]."""
    random = np.random.default_rng(seed)
    phase = random.uniform(0.0, 2.0 * np.pi, (200, 1)) + 0.7 * np.arange(count // 200)
    return np.rint(amplitude * np.sin(phase) + noise * random.standard_normal(phase.shape)).astype(np.int16)


@settings(max_examples=30, derandomize=True, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 3000.0), st.integers(0, 4))
def test_codes_of_a_sound_converter_are_even(seed, amplitude, shift):
    """Also of one that fills the upper bits alone; 30 examples at 1e-4: false failure 0.3 %, the seed is fixed."""
    codes = evenness(sampled(seed, amplitude) << shift, NOISE * 2**shift)
    assert codes.probability > 1e-4


@settings(max_examples=30, derandomize=True, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.booleans())
def test_a_bit_that_sticks_makes_them_uneven(seed, bit, one):
    codes = sampled(seed)
    stuck = codes | (1 << bit) if one else codes & ~np.int16(1 << bit)
    found = evenness(stuck, NOISE)
    if bit == 0:  # that is a converter of one bit less
        assert found.probability > 1e-4
    else:
        assert found.probability < 1e-12
        assert found.low >= -430.0 and found.high <= 430.0 + 2.0**bit


@pytest.mark.parametrize('width', [1, 3, 12])
def test_missing_codes_are_located(width):
    codes = sampled(3)
    codes[(codes >= 50) & (codes < 50 + width)] = 50 + width
    found = evenness(codes, NOISE)
    assert found.probability < 1e-12
    assert 40 <= found.low <= found.high <= 60 + width


def test_a_recordings_stuck_bit_has_a_place(tmp_path):
    """A low bit adds little but noise and a constant, which registered effects could explain. The codes show it."""
    condition = random_condition(np.random.default_rng(7), Extent(7, 12))
    stuck = Applied('stuck_bit', 'slave', {'bit': 2, 'value': 1})
    write_recording(conceal(nominal(condition), [stuck]), tmp_path / 'r')
    comparison = Comparison(read_dataset(tmp_path / 'r'))
    chances = {x.station: x.probability for x in leftovers(Fitting(comparison), None) if x.kind == 'codes'}
    assert chances[0] > 1e-4 and chances[1] < 1e-12
    assert ('if_samples', 'slave', 'adc_code') in {(x.level, x.station, x.axis) for x in locations(comparison)}


def test_what_a_limiter_piles_up_is_no_uneven_converter():
    assert evenness(np.clip(sampled(4), -250, 250), NOISE).probability > 1e-4


@settings(max_examples=20, derandomize=True, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(20.0, 2000.0))
def test_only_a_limiter_piles_samples_up(seed, amplitude):
    """As many as it cuts off, no more than lie there; 200 sweeps without one hold less than one in five by chance."""
    codes = sampled(seed, amplitude)
    assert piled(codes).mean() < 0.2
    limit = round(0.7 * amplitude)
    cut = np.count_nonzero(np.abs(codes) >= limit, axis=1)
    found = piled(np.clip(codes, -limit, limit))
    there = np.count_nonzero(np.abs(codes) > limit - CODES.outermost, axis=1)
    assert np.all(found <= there) and found.mean() > 0.8 * cut.mean()
    both = codes[:100] + 1j * codes[100:]
    np.testing.assert_array_equal(piled(both), piled(codes[:100]) + piled(codes[100:]))


def test_too_little_noise_or_too_few_counts_show_nothing():
    assert evenness(sampled(5, noise=1.0), 1.0) is None
    assert evenness(sampled(6, count=2000), NOISE) is None
