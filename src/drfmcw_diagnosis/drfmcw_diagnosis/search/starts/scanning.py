"""What all scanners take and give.

In: what an explanation leaves. Out: values of an effect's scanned parameters.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d

from drfmcw_sim.effects import Recipe

from ...compare.comparison import Comparison
from ..limits import SCAN

Values = Sequence[float | tuple[float, ...]]
"""Values of a scanned parameter, or of several parameters together, best first."""


@dataclasses.dataclass(frozen=True)
class Rest:
    """What an explanation leaves of a recording, and where it has the crane."""

    comparison: Comparison
    residual: np.ndarray  # over the numbers' standard deviations (n,)
    distance: np.ndarray  # from station to station, mean of each group (G,) [m]
    least: float = 0.0  # gain below which no starting point is wanted [1]


@dataclasses.dataclass(frozen=True)
class Scanner:
    """One way to find starting points in a remainder."""

    find: Callable[[Rest, int, Recipe], Values]
    """From (rest, number of the station, recipe); the station is -1 where there is none."""

    of_station: bool = False  # it scans the records of one station
    resolution: Callable[[Comparison], float] = lambda comparison: 0.0  # two nearer than that look like one


def peaks(score: np.ndarray, count: int = SCAN.peaks, apart: int = SCAN.fine // 2) -> list[int]:
    """Return the indices of the largest local maxima, best first."""
    high = np.flatnonzero((score == maximum_filter1d(score, 2 * apart + 1)) & (score > 0.0))
    return [int(k) for k in high[np.argsort(score[high])[::-1][:count]]]
