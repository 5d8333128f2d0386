"""How an effect's size agrees from part to part of the numbers: from distance to distance, from kind to kind.

In: what an explanation leaves, and what an effect adds, whitened (n,), and to which part each number belongs (n,). Out:
by how much the size differs, and what the other parts say of each.
"""

import numpy as np
from scipy import stats

from ..compare.algebra import scaled_inverse


def largest_share(added: np.ndarray, parts: np.ndarray) -> float:
    """Return the share of an effect's power that lies in the part which shows it best."""
    by_part = np.bincount(parts, added**2)
    return float(by_part.max() / max(by_part.sum(), 1e-30))


def without_each(rest: np.ndarray, slopes: np.ndarray, parts: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Return by how much the parameters change when each part is left out of the fit (parts, P), to first order.

    Parameters that one part alone determines stay as they are without it: of which other parts have less than a share
    of the information (P,).
    """
    normal, pull = slopes @ slopes.T, slopes @ rest  # a fit ends where the pull is nearly zero, not quite
    changes = np.zeros((parts.max() + 1, len(slopes)))
    for part in range(parts.max() + 1):
        inside = slopes[:, parts == part]
        left = normal - inside @ inside.T
        kept = np.diag(left) > least * np.diag(normal)
        inverse = scaled_inverse(left[np.ix_(kept, kept)])
        changes[part, kept] = inverse @ (pull - inside @ rest[parts == part])[kept]
    return changes


def unevenness(rest: np.ndarray, added: np.ndarray, parts: np.ndarray) -> float:
    """Return the mean squared relative difference of an effect's size from part to part, less what noise makes of it.

    In each part the size that fits best is 1 + (added . rest) / (added . added) times that of the explanation, with a
    variance of 1 / (added . added); parts count by their power, those of less than the noise not at all.
    """
    squares = _differences(rest, added, parts)
    return float((squares.sum() - len(squares)) / max(float(added @ added), 1e-30))


def chance_of_sizes(rest: np.ndarray, added: np.ndarray, parts: np.ndarray) -> float:
    """Return the chance of sizes that differ so much from part to part, see `unevenness`."""
    squares = _differences(rest, added, parts)
    return float(stats.chi2.sf(squares.sum(), max(len(squares), 1)))


def smallest_size(rest: np.ndarray, added: np.ndarray, parts: np.ndarray, visible: float) -> float:
    """Return the smallest size of an effect over that of the explanation, of parts whose power is above `visible`."""
    power, overlap = np.bincount(parts, added**2), np.bincount(parts, added * rest)
    shown = power > visible
    return float(np.min(1.0 + overlap[shown] / power[shown], initial=1.0))


def _differences(rest: np.ndarray, added: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Return the squared differences of an effect's size in each part that counts over their variances."""
    power, overlap = np.bincount(parts, added**2), np.bincount(parts, added * rest)
    used = power > 1.0
    squares: np.ndarray = overlap[used] ** 2 / power[used]
    return squares
