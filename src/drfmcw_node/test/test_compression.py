"""The radio link's codecs give back every sweep exactly, and say so when they cannot."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drfmcw_node.compression import CODECS, CompressionError, compress, decompress
from drfmcw_physics.settings import ConfigurationError


@pytest.mark.parametrize('codec', CODECS)
@given(
    samples=arrays(np.int16, st.integers(0, 600).map(lambda n: 2 * n), elements=st.integers(-32768, 32767)),
    iq=st.booleans(),
)
@settings(max_examples=80, deadline=None, derandomize=True)
def test_round_trip(codec, samples, iq):
    restored = decompress(compress(samples, codec, iq), codec, len(samples), iq)
    assert restored.dtype == np.int16 and np.array_equal(restored, samples)


@pytest.mark.parametrize('codec', CODECS)
def test_sweep_shrinks(codec):
    """A line 50 dB above 6 LSB of noise needs less than two thirds of its 16 bits."""
    t = np.arange(2048)
    wave = 200 * np.cos(2 * np.pi * 0.31 * t) + np.random.default_rng(1).normal(0, 6, t.shape)
    samples = np.round(wave).astype(np.int16)
    assert 2 * len(samples) / len(compress(samples, codec)) > 1.5


@pytest.mark.parametrize('codec', CODECS)
@pytest.mark.parametrize('data', [b'', b'nonsense', bytes(200)])
def test_damaged_data_is_refused(codec, data):
    with pytest.raises(CompressionError):
        decompress(data, codec, 100)


@pytest.mark.parametrize('codec', CODECS)
def test_wrong_count_is_refused(codec):
    data = compress(np.arange(100, dtype=np.int16), codec)
    with pytest.raises(CompressionError):
        decompress(data, codec, 102)


def test_unknown_codec_names_the_nearest():
    with pytest.raises(ConfigurationError, match="did you mean 'flac'"):
        compress(np.zeros(4, np.int16), 'flak')
