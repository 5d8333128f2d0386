"""What repeats with the ramp: leakage, returns that stand still, settling; and patterns that vary between sweeps."""

import dataclasses
import math

import numpy as np

from .limits import BACKGROUND, JUDGE
from .material import Material


@dataclasses.dataclass(frozen=True)
class Background:
    """Patterns over the ramp, learnt from the first sweeps and tried on the rest; rms of what they leave [LSB]."""

    mean: np.ndarray  # (N,) repeats with each ramp [LSB]
    patterns: np.ndarray  # (k, N) of unit power, whose amplitudes vary from sweep to sweep
    constant: float  # left by a constant alone
    repeating: float  # left by the mean sweep
    varying: float  # left by the mean sweep and the patterns
    leakage: float  # amplitude of what repeats within two cells of 0 Hz [LSB]
    line: float  # amplitude of the strongest line beyond [LSB]

    @property
    def leaks(self) -> bool:
        """Leakage stands far above every line."""
        return self.leakage > self.line * 10.0 ** (BACKGROUND.above / 20.0)


def background(m: Material) -> Background | None:
    """Return what repeats with the ramp, None with too few sweeps."""
    count, length = m.signal.shape
    if count < BACKGROUND.fewest or length < 2 * BACKGROUND.components:
        return None
    at = round(JUDGE.fitted * count)
    known, held = m.signal[:at], m.signal[at:]
    mean = known.mean(axis=0)
    constant = _rms(held - known.mean())
    rest = held - mean
    repeating = varying = _rms(rest)
    _, _, patterns = np.linalg.svd(known - mean, full_matrices=False)
    used = 0
    for number in range(1, BACKGROUND.components + 1):
        some = patterns[:number]
        left = _rms(rest - (rest @ some.conj().T) @ some)
        if left < BACKGROUND.helps * varying:
            varying, used = left, number
    window = np.hanning(length + 2)[1:-1]
    spectrum = np.fft.fft(m.signal * window, axis=1) / window.sum()
    still = np.abs(spectrum.mean(axis=0))
    each = np.sqrt(np.mean(np.abs(spectrum - spectrum.mean(axis=0)) ** 2, axis=0))
    cell = np.minimum(np.arange(length), length - np.arange(length))
    factor = 1.0 if m.iq else 2.0
    leakage = float(still[0])
    beyond = cell > BACKGROUND.cells
    line = factor * float(np.max(np.hypot(still, each)[beyond]))
    return Background(mean, patterns[:used], constant, repeating, varying, leakage, line)


def gain(before: float, after: float) -> float:
    """Return by how much a misfit falls [dB]."""
    return 20.0 * math.log10(max(before, 1e-9) / max(after, 1e-9))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))
