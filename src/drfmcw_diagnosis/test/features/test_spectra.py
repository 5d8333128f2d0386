"""Numbers taken from spectra: medians of many rows at once."""

import warnings

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from drfmcw_diagnosis.features.spectra import row_medians


@given(
    arrays.arrays(
        np.float32,
        arrays.array_shapes(min_dims=2, max_dims=3, min_side=1, max_side=9),
        elements=st.one_of(st.just(np.nan), st.floats(0.0, 1e6, width=32)),
    )
)
def test_medians_of_rows_are_those_of_numpy(values):
    """To the last bit, and NaN where a row has nothing."""
    median, count = row_medians(values)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RuntimeWarning)  # of rows without a number
        expected = np.nanmedian(values, axis=-1)
    np.testing.assert_array_equal(median, expected)
    np.testing.assert_array_equal(count, np.sum(~np.isnan(values), axis=-1))
