"""Spectra: what turns with a line, the noise around a bin, which bins are a line's, and means of powers."""

from typing import overload

import numpy as np
from scipy.ndimage import median_filter

from .limits import SPECTRUM


def phasor(turns: np.ndarray) -> np.ndarray:
    """Return exp(2j pi turns), complex64, however many turns."""
    angle = (2.0 * np.pi * (turns - np.rint(turns))).astype(np.float32)
    result = np.empty(angle.shape, np.complex64)
    np.cos(angle, out=result.real)
    np.sin(angle, out=result.imag)
    return result


def turning(cycles: np.ndarray, first: int, last: int) -> np.ndarray:
    """Return exp(2j pi cycles t) of lines (n,) over the samples t from `first` up to `last`, complex64 (n, N).

    A product of two short tables: a turn by whole stretches of samples, and one within a stretch.

    Args:
        cycles: of each line per sample (n,).
        first: sample.
        last: end of the samples.
    """
    within = phasor(cycles[:, None] * np.arange(SPECTRUM.stretch))
    stretches = phasor(cycles[:, None] * np.arange(first, last, SPECTRUM.stretch))
    return (stretches[..., None] * within[:, None]).reshape(len(cycles), -1)[:, : last - first]


def at_line(samples: np.ndarray, cycles: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the sum of weighted samples times exp(-2j pi cycles t), complex128 (n,); t counts from the first sample.

    Args:
        samples: of a station (n, N), real or complex.
        cycles: of each sweep's line per sample (n,).
        weights: of each sample (N,).
    """
    length = SPECTRUM.stretch
    count = samples.shape[1] // length * length
    weighted = samples * weights.astype(np.float32)
    blocks = weighted[:, :count].reshape(len(samples), -1, length)
    within = phasor(-cycles[:, None] * np.arange(length))
    stretches = phasor(-cycles[:, None] * np.arange(0, count, length))
    if np.iscomplexobj(samples):
        sums = np.matmul(blocks, within[..., None])[..., 0]
    else:  # a real product takes half the time
        parts = np.matmul(blocks, within.view(np.float32).reshape(*within.shape, 2))
        sums = parts[..., 0] + 1j * parts[..., 1]
    rest = weighted[:, count:] * turning(-cycles, count, samples.shape[1])
    return np.sum(sums * stretches, axis=1, dtype=complex) + np.sum(rest, axis=1, dtype=complex)


def line_amplitude(samples: np.ndarray, cycles: np.ndarray, first: int) -> np.ndarray:
    """Return a line's complex amplitude in samples (n, N) from the `first` on, by its cycles per sample (n,): (n,).

    Of real samples beside that of its mirror, which a short span does not keep out.
    """
    count = samples.shape[1]
    if not count:
        return np.zeros(len(samples), complex)
    turn = turning(-cycles, first, first + count)
    line = np.einsum('ij,ij->i', samples, turn).astype(complex) / count
    if np.iscomplexobj(samples):
        return line
    mirror = np.einsum('ij,ij->i', turn, turn).astype(complex) / count
    return (line - mirror * line.conj()) / np.maximum(1.0 - np.abs(mirror) ** 2, SPECTRUM.edge_alike)


def local_noise(power: np.ndarray, bins: int = SPECTRUM.median) -> np.ndarray:
    """Return the noise around each bin of mean spectra (..., B), lines left out: a running median over `bins`."""
    return median_filter(power, size=(1,) * (power.ndim - 1) + (bins,), mode='reflect')


def row_medians(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the medians of rows (..., N), NaN where nothing is, and how many numbers each has; NaN counts as nothing.

    All at once: NumPy's own goes from row to row where there are any.
    """
    ordered = np.sort(values, axis=-1)  # NaN last
    count = np.count_nonzero(~np.isnan(ordered), axis=-1)
    low, high = (
        np.take_along_axis(ordered, at[..., None], -1)[..., 0] for at in (np.maximum(count - 1, 0) // 2, count // 2)
    )
    return 0.5 * (low + np.where(count > 0, high, low)), count


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
    """Return (mean of the chosen sweeps' spectra (S, B), number of sweeps of equal weight with its variance (S,)).

    Args:
        power: spectra (n, S, B).
        chosen: which sweeps, or their weights (n, S).
    """
    total, squares = chosen.sum(axis=0), np.sum(np.square(chosen, dtype=float), axis=0)
    return np.einsum('nsb,ns->sb', power, chosen) / total[:, None], total**2 / squares
