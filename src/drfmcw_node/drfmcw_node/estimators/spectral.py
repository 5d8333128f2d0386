"""Analysis window, de-chirping and chirp-z zoom of a batch of sweeps.

Every function works row by row (numpy's FFT and ufuncs, never a matrix product, whose blocking depends on the batch),
so that a sweep's numbers do not depend on how many sweeps were processed with it.
"""

import functools

import numpy as np
from scipy.fft import next_fast_len
from scipy.signal import get_window

_GRID = 1 << 16  # linear interpolation of a window on it is exact to 1e-9


@functools.lru_cache(maxsize=64)
def window_samples(name: str, start: float, end: float, sample_rate: float, count: int) -> np.ndarray:
    """Return the continuous-time window between `start` and `end`, at the sample instants n / sample_rate.

    Args:
        name: scipy.signal.get_window name.
        start: of the window [s].
        end: of the window [s].
        sample_rate: [Hz].
        count: number of samples.

    Returns:
        Array (count,); zero outside the window.
    """
    shape = get_window(name, _GRID + 1, fftbins=False)
    t = np.arange(count) / sample_rate
    w = np.interp((t - start) / (end - start) * _GRID, np.arange(_GRID + 1), shape, left=0.0, right=0.0)
    w.setflags(write=False)
    return w


def whole_turns(frequency: np.ndarray, sample: np.ndarray, turn: int) -> np.ndarray:
    """Return `frequency` * `sample` modulo `turn`, all whole numbers: the index of a phase in a table of one turn."""
    product = frequency * sample
    if turn & (turn - 1) == 0:
        product &= turn - 1  # 10 times faster than the remainder
    else:
        product %= turn
    return product


class ChirpZ:
    """Chirp-z transform onto a fine grid around one bin of each sweep (Rabiner, Schafer and Rader 1969; Bluestein).

    Each sweep is first shifted by its own whole number of bins, which is exact, so that one set of chirps serves all.
    """

    def __init__(self, count: int, length: int, points: int, span: float, center: float) -> None:
        """Prepare the chirps.

        Args:
            count: samples per sweep.
            length: of the FFT whose bins are the unit of frequency.
            points: of the grid.
            span: of the grid [bins].
            center: sample index at which phases are referenced; need not be whole.
        """
        self.offsets = (np.arange(points) - (points - 1) / 2) * (span / (points - 1))  # [bins]
        self._length, self._points = length, points
        self._n = np.arange(count)
        self._table = np.exp(-2j * np.pi * np.arange(length) / length)
        self._center = center
        step = span / (points - 1) / length  # cycles per sample and grid point
        size = next_fast_len(count + points - 1)
        n, m = np.arange(count), np.arange(points)
        self._size = size
        # n m = (n^2 + m^2 - (m - n)^2) / 2 turns the transform into a convolution with a chirp
        self._before = np.exp(-2j * np.pi * (self.offsets[0] / length * n + step * n**2 / 2))
        chirp = np.zeros(size, complex)
        chirp[:points] = np.exp(1j * np.pi * step * m**2)
        chirp[size - count + 1 :] = np.exp(1j * np.pi * step * n[:0:-1] ** 2)
        self._chirp = np.fft.fft(chirp)
        self._after = np.exp(1j * np.pi * (2.0 * self.offsets * center / length - step * m**2))

    def __call__(self, windowed: np.ndarray, bins: np.ndarray) -> np.ndarray:
        """Return the spectrum at `bins` + `offsets`, phase referenced to `center`.

        Args:
            windowed: sweeps (B, N), real or complex.
            bins: whole bin of each sweep (B,).

        Returns:
            Complex array (B, points).
        """
        shifted = self._table[whole_turns(bins[:, None], self._n, self._length)]
        shifted *= windowed
        shifted *= self._before
        spectrum = np.fft.fft(shifted, self._size)
        spectrum *= self._chirp
        zoomed = np.fft.ifft(spectrum)[:, : self._points]
        turn = np.exp(2j * np.pi * np.remainder(bins * (self._center / self._length), 1.0))
        return zoomed * self._after * turn[:, None]


def parabola_vertex(left: np.ndarray, middle: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the vertex of the parabola through three equidistant values, in steps from the middle (within +-1)."""
    curvature = left - 2.0 * middle + right
    safe = np.where(curvature < 0.0, curvature, -1.0)
    return np.where(curvature < 0.0, np.clip(0.5 * (left - right) / safe, -1.0, 1.0), 0.0)


def parabola_value(left: np.ndarray, middle: np.ndarray, right: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Return the parabola through three equidistant values (may be complex) at `offset` steps from the middle."""
    return middle + 0.5 * (right - left) * offset + 0.5 * (left - 2.0 * middle + right) * offset**2
