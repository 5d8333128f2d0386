"""The fast estimator: FFT under a Hann window, then Newton steps to the spectrum's peak from nine bins alone."""

from typing import Any

import numpy as np

from .estimation import TINY, Estimator, Sweeps

_REACH = 4  # bins on either side of the strongest: a Hann line has 1e-4 of its amplitude beyond
_STEPS = 2  # of Newton's method, from a parabola's 0.02 bins
_GRID = np.linspace(-0.75, 0.75, 193)  # offsets from the strongest bin at which the truncation is calibrated [bins]


class HannEstimator(Estimator, name='hann'):
    """FFT under a Hann window, Newton steps on nine bins: the same peak as `paper` finds, without a zoom; the fastest.

    At a frequency b + d between bins, the windowed spectrum and its derivative are sums over all bins,
    X(b + d) = sum_m sinc(d - m) X_m and dX/df alike. Sums over nine bins miss the peak by up to 1e-3 bins. That error
    depends on d alone and is calibrated on a clean line.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Calibrate; arguments as for `Estimator`."""
        super().__init__(*args, **kwargs)
        self._around = np.arange(-_REACH, _REACH + 1)
        center = self.center * self.sweep.sample_rate
        # refers the phase of a bin to the centre of the window
        self._turn = np.exp(2j * np.pi * np.arange(self.length // 2 + 1) * (center / self.length))
        u = (np.arange(self.sweep.sample_count) - center) / self.length
        window = self._window.astype(float)
        self._slope = window.sum() / (window * u**2).sum() / (2.0 * np.pi)
        lines = np.exp(2j * np.pi * np.subtract.outer(_GRID, self._around)[..., None] * u) @ window
        self._found, amplitude = self._climb(lines, _GRID)
        self._error, self._gain = _GRID - self._found, self.window_sum / np.abs(amplitude)

    def _climb(self, lines: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (offset [bins], complex amplitude) of the peak among nine bins (B, 9), from a first guess (B,)."""
        for _ in range(_STEPS):
            value, derivative = _between(lines, offset[:, None] - self._around)
            power = np.maximum(value.real**2 + value.imag**2, TINY)
            step = (value.real * derivative.imag - value.imag * derivative.real) / power * self._slope
            offset = offset + np.clip(step, -0.5, 0.5)
        return offset, _between(lines, offset[:, None] - self._around)[0]

    def _refine(self, sweeps: Sweeps) -> tuple[np.ndarray, np.ndarray]:
        near = np.clip(sweeps.peak[:, None] + self._around, 0, len(self._turn) - 1)
        rows = np.arange(len(near))[:, None]
        offset, amplitude = self._climb(sweeps.spectrum[rows, near] * self._turn[near], sweeps.parabola())
        gain = np.interp(offset, self._found, self._gain)
        return sweeps.peak + offset + np.interp(offset, self._found, self._error), amplitude * gain


def _between(lines: np.ndarray, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the spectrum (B,) and its moment of first order in time, both (B,), between bins.

    Args:
        lines: bins (B, K), phases referred to the centre of the window.
        distance: of the wanted frequency from each bin (B, K) [bins].
    """
    angle = np.pi * distance
    safe = np.where(np.abs(angle) < 1e-4, 1e-4, angle)  # the series' next term is 1e-8
    sine, cosine = np.sin(safe) / safe, np.cos(safe)
    first = (sine - cosine) / (2.0 * safe)  # integral of x sin(2 pi y x) over a record of unit length
    return (lines * sine).sum(axis=1), -1j * (lines * first).sum(axis=1)
