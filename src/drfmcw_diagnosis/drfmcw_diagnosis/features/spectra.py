"""Powers of spectra: the noise around a bin, which bins are a line's, and means of powers as standard normals."""

from typing import overload

import numpy as np
from scipy.ndimage import median_filter

from .limits import SPECTRUM


def local_noise(power: np.ndarray, bins: int = SPECTRUM.median) -> np.ndarray:
    """Return the noise around each bin of mean spectra (..., B), lines left out: a running median over `bins`."""
    return median_filter(power, size=(1,) * (power.ndim - 1) + (bins,), mode='reflect')


def near_line(bins: int, frequency: np.ndarray, width: float, rate: float) -> np.ndarray:
    """Return which bins are at a line, or outside of what is compared (..., B).

    Args:
        bins: number of bins B.
        frequency: of the lines (...) [Hz].
        width: of a bin [Hz].
        rate: sample rate [Hz].
    """
    axis = np.arange(bins) * width
    close = np.abs(axis - frequency[..., None]) < SPECTRUM.line * width
    return close | (axis < SPECTRUM.edge * width) | (axis > rate / 2 - SPECTRUM.edge * width)


def gaussian(ratio: np.ndarray, count: float | np.ndarray) -> np.ndarray:
    """Return means of `count` exponential powers over their expectation as standard normals (Wilson, Hilferty 1931)."""
    return (np.cbrt(ratio) - np.cbrt(median_of_mean(count))) * np.sqrt(9.0 * count)


@overload
def median_of_mean(count: float) -> float: ...
@overload
def median_of_mean(count: np.ndarray) -> np.ndarray: ...
def median_of_mean(count: float | np.ndarray) -> float | np.ndarray:
    """Return the median of the mean of `count` exponential powers over their expectation (Wilson, Hilferty 1931)."""
    return (1.0 - 1.0 / (9.0 * count)) ** 3


def mean_power(power: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (mean of the chosen sweeps' spectra (S, B), their number (S,)).

    Args:
        power: spectra (n, S, B).
        chosen: which sweeps, or their weights (n, S).
    """
    count = chosen.sum(axis=0)
    return np.einsum('nsb,ns->sb', power, chosen) / count[:, None], count
