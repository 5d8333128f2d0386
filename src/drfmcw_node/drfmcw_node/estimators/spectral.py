"""Analysis window, de-chirping and chirp-z zoom of a batch of sweeps.

Every function works row by row (FFT, ufuncs, a matrix product for each sweep, never one for several, whose blocking
depends on the batch), so that a sweep's numbers do not depend on how many sweeps were processed with it.
"""

import functools
import math

import numpy as np

from drfmcw_physics.windows import symmetric_window

_GRID = 1 << 16  # linear interpolation of a window on it is exact to 1e-9
_BLOCKS = 16  # of a sweep in the chirp-z transform
_SERIES_ERROR = 1e-10  # of its power series, relative to the sum of all magnitudes: below float32's


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
    shape = symmetric_window(name, _GRID + 1)
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
    """Chirp-z transform onto a fine grid around one bin of each sweep (Rabiner, Schafer and Rader 1969).

    On a grid of few bins a block of a sweep turns by little. There exp(i x) is a short power series, so that some
    moments of each block serve all points of the grid. This takes half as long as Bluestein's two FFTs.
    """

    def __init__(self, count: int, length: int, points: int, span: float, center: float) -> None:
        """Prepare what does not depend on the bin.

        Args:
            count: samples per sweep.
            length: of the FFT whose bins are the unit of frequency.
            points: of the grid.
            span: of the grid [bins].
            center: sample index at which phases are referenced; need not be whole.
        """
        self.offsets = (np.arange(points) - (points - 1) / 2) * (span / (points - 1))  # [bins]
        self._length = length
        self._center = center
        self._table = np.exp(-2j * np.pi * np.arange(length) / length)
        size = -(-count // _BLOCKS)
        self._missing = _BLOCKS * size - count  # samples to the end of the last block
        self._n, self._begins = np.arange(size), np.arange(_BLOCKS) * size
        largest = np.pi * span / length * size / 2  # angle by which the edge of the grid turns half a block
        orders = np.arange(next(n for n in range(1, 200) if largest**n / math.factorial(n) < _SERIES_ERROR))
        self._powers = ((2 * self._n - (size - 1)) / size)[:, None] ** orders
        angle = -2j * np.pi / length * self.offsets
        turns = np.exp((self._begins + (size - 1) / 2 - center)[:, None, None] * angle)
        series = (angle * size / 2) ** orders[:, None] / np.array([math.factorial(n) for n in orders])[:, None]
        self._grid = (turns * series).reshape(_BLOCKS * len(orders), points)

    def __call__(self, windowed: np.ndarray, bins: np.ndarray) -> np.ndarray:
        """Return the spectrum at `bins` + `offsets`, phase referenced to `center`.

        Args:
            windowed: sweeps (B, N), real or complex.
            bins: whole bin of each sweep (B,).

        Returns:
            Complex array (B, points).
        """
        if self._missing:
            windowed = np.pad(windowed, ((0, 0), (0, self._missing)))
        shift = self._table[whole_turns(bins[:, None], self._n, self._length)]
        moments = windowed.reshape(len(bins), _BLOCKS, -1) @ (shift[:, :, None] * self._powers)
        moments *= self._table[whole_turns(bins[:, None], self._begins, self._length)][:, :, None]
        turn = np.exp(2j * np.pi * np.remainder(bins * (self._center / self._length), 1.0))
        return (moments.reshape(len(bins), 1, -1) @ self._grid)[:, 0] * turn[:, None]


def parabola_vertex(left: np.ndarray, middle: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the vertex of the parabola through three equidistant values, in steps from the middle (within +-1)."""
    curvature = left - 2.0 * middle + right
    peaked = curvature < 0.0
    vertex = 0.5 * (left - right) / np.where(peaked, curvature, -1.0)
    return np.where(peaked, np.minimum(np.maximum(vertex, -1.0), 1.0), 0.0)


def parabola_value(left: np.ndarray, middle: np.ndarray, right: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Return the parabola through three equidistant values (may be complex) at `offset` steps from the middle."""
    return middle + 0.5 * (right - left) * offset + 0.5 * (left - 2.0 * middle + right) * offset**2
