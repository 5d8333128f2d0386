"""How much of the power beside a line repeats in each sweep: what an event within the ramp leaves there is no noise.

In: the samples of a group's sweeps and their lines. Out: the share of the power in bands of the IF.
"""

import numpy as np
from scipy import signal

from .noise_bands import edges_of
from .spectra import near_line


def repeating_share(samples: np.ndarray, line: np.ndarray, rate: float) -> np.ndarray:
    """Return the share of the power in each band that repeats at the line's phase and amplitude (N,), from 0 to 1.

    Of n sweeps that share nothing, the mean spectrum holds 1/n of their power; that is taken away. NaN where a line
    fills the band.

    Args:
        samples: of n sweeps, two or more (n, T), real or complex.
        line: frequency of each sweep's line (n,) [Hz].
        rate: sample rate [Hz].
    """
    n, count = samples.shape
    window = signal.windows.hann(count, sym=False)
    turned = samples * np.exp(-2j * np.pi * line[:, None] / rate * np.arange(count))
    levels = turned @ window
    spectra = np.fft.fft(turned * window / levels[:, None], axis=1)
    each, mean = np.mean(np.abs(spectra) ** 2, axis=0), np.abs(spectra.mean(axis=0)) ** 2
    repeated = (n * mean - each) / (n - 1)
    bins = count // 2 + 1
    at = np.arange(bins) - round(float(line.mean()) * count / rate)  # of the real IF, counted from the line
    beside = ~near_line(bins, line.mean(keepdims=True)[0], rate / count, rate)
    edges = edges_of(bins)
    found = np.full(len(edges) - 1, np.nan)
    for band in range(len(found)):
        inside = at[edges[band] : edges[band + 1]][beside[edges[band] : edges[band + 1]]]
        if len(inside):
            found[band] = np.clip(np.median(repeated[inside]) / np.median(each[inside]), 0.0, 1.0)
    return found
