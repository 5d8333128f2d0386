"""Analysis windows by name.

In: a name and a number of samples. Out: the window's samples. NumPy has the common ones; SciPy has all, but its signal
package takes longer to import than all else that a station starts with. SciPy imports it when it is first used, so only
the others wait for it.
"""

from collections.abc import Callable

import numpy as np
import scipy

WINDOWS = ('hann', 'boxcar', 'hamming', 'blackman', 'blackmanharris', 'nuttall', 'cosine', 'parzen', 'bohman')
"""scipy.signal.get_window names that can be chosen."""

_OF_NUMPY: dict[str, Callable[[int], np.ndarray]] = {
    'hann': np.hanning,
    'boxcar': np.ones,
    'hamming': np.hamming,
    'blackman': np.blackman,
}


def symmetric_window(name: str, count: int) -> np.ndarray:
    """Return a window that begins and ends alike (count,).

    Args:
        name: scipy.signal.get_window name.
        count: number of samples.

    Raises:
        ValueError: no window has this name.
    """
    if name in _OF_NUMPY:
        return _OF_NUMPY[name](count)
    samples: np.ndarray = scipy.signal.get_window(name, count, fftbins=False)
    return samples
