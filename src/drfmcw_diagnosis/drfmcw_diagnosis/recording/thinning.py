"""Which sweeps of a long recording are compared: enough for every effect, and no more than the model is good for."""

import numpy as np

from .limits import THINNING


def representative(group: np.ndarray) -> np.ndarray:
    """Return the sweeps to compare, spread evenly over all groups and over each of them (m,), in order.

    Args:
        group: number of each sweep's group (n,), see `Dataset.group`.
    """
    numbers = np.unique(group)
    kept = numbers[_spread(len(numbers), THINNING.groups)]
    rows = (np.flatnonzero(group == number) for number in kept)
    return np.concatenate([r[_spread(len(r), THINNING.sweeps)] for r in rows])


def _spread(count: int, most: int) -> np.ndarray:
    """Return at most so many of `count` numbers, evenly spaced."""
    return np.unique(np.round(np.linspace(0, count - 1, min(count, most))).astype(int))
