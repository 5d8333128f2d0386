"""Averaged spectra of sweeps, and what counts as a line in them."""

import numpy as np

from ..formats.base import Numbers


def averaged_spectrum(signal: Numbers) -> Numbers:
    """Return the mean power spectrum of (n, N) sweeps after a Hann window, all N bins, each sweep's mean removed."""
    window = np.hanning(signal.shape[1] + 2)[1:-1]
    power: Numbers = np.mean(np.abs(np.fft.fft((signal - signal.mean(axis=1, keepdims=True)) * window)) ** 2, axis=0)
    return power


def local_maxima(power: Numbers) -> Numbers:
    """Return powers with zero where they are no local maximum along the last axis: the skirt of 0 Hz is no line."""
    around = np.pad(power, [(0, 0)] * (power.ndim - 1) + [(1, 1)], mode='edge')
    peaks: Numbers = np.where((power >= around[..., :-2]) & (power >= around[..., 2:]), power, 0.0)
    return peaks


def near_zero(count: int) -> int:
    """Return the bins around 0 Hz of a spectrum of `count` bins in which no line is sought."""
    return int(np.clip(count // 128, 3, 16))


def strongest(spectrum: Numbers, iq: bool) -> int:
    """Return the bin of the strongest line away from 0 Hz, of a real signal at a positive frequency."""
    count = len(spectrum)
    guard = near_zero(count)
    inner = local_maxima(spectrum)
    inner[:guard] = inner[count - guard + 1 :] = 0.0
    if not iq:
        inner[count // 2 + 1 :] = 0.0
    return int(np.argmax(inner))
