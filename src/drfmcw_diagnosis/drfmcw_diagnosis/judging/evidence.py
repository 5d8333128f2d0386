"""Which numbers are evidence of an effect: those of which an explanation leaves little beside what the effect adds.

In: an explanation, what it leaves, and what one of its effects adds. Out: which numbers are clean. Numbers that an
uneven converter made are none, nor are those of a kind of which much is left.
"""

import dataclasses

import numpy as np

from ..search.fits.fitted import Fitted
from ..search.fits.fitting import Fitting
from ..search.leftovers import Leftover, leftovers


@dataclasses.dataclass(frozen=True)
class EvidenceLimits:
    """What counts as clean; chosen on recordings by another hand, see docs/diagnosis.md."""

    clean: float = 0.05  # rest of a cell over the effect's power in it, below which the cell counts as clean [1]
    dominated: float = 9.0  # rest of a cell over the effect's power in it, above which it does not show the size [1]
    unchanged: float = 0.01  # square of what an effect adds to a number over the largest in its cell, see `Kind.sparse`
    by_chance: float = 5.0  # standard deviations of noise in such a rest [1]
    noise: float = 1.0  # standard deviations by which noise may raise the rest of a cell [1]
    left_over: float = 0.01  # chance of what is left of a kind of number at a station below which it counts [1]
    uneven: float = 1e-4  # chance of a converter's codes below which its numbers are no evidence [1]


LIMITS = EvidenceLimits()


def significantly_left(fitting: Fitting, fitted: Fitted, derivatives: np.ndarray) -> list[Leftover]:
    """Return the kinds of numbers of which an explanation leaves more than chance does, beside what is set aside.

    Args:
        fitting: of the recording.
        fitted: the explanation.
        derivatives: of its parameters, see `Fitting.slopes`.
    """
    return [x for x in leftovers(fitting, fitted, derivatives, apart=True) if x.probability < LIMITS.left_over]


def clean(
    fitting: Fitting, significant: list[Leftover], left_over: np.ndarray, added: np.ndarray, cells: np.ndarray
) -> np.ndarray:
    """Return which numbers may be evidence of an effect (n,), whatever the converters.

    Args:
        fitting: of the recording.
        significant: of the explanation, see `significantly_left`.
        left_over: what it leaves, whitened (n,).
        added: what the effect adds to it, whitened (n,).
        cells: number of each number's cell (n,).
    """
    beside = np.where(_unchanged(fitting, added, cells), 0.0, left_over)
    found: np.ndarray = _in_clean_cells(beside, added, cells) & ~_in_doubt(fitting, significant, beside, added)
    return found


def dominated(left_over: np.ndarray, added: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return which numbers lie in cells of which far more is left than an effect adds (n,): they do not show its size.

    An effect that is not there leaves as much as it adds.

    Args:
        left_over: what the explanation leaves, whitened (n,).
        added: what the effect adds to it, whitened (n,).
        cells: number of each number's cell (n,).
    """
    power, over = np.bincount(cells, added**2), np.bincount(cells, left_over**2 - (left_over != 0.0))
    by_chance = LIMITS.by_chance * np.sqrt(2.0 * np.bincount(cells, left_over != 0.0))  # chi-squared
    found: np.ndarray = (over > LIMITS.dominated * power + by_chance)[cells]
    return found


def of_uneven_converters(fitting: Fitting, significant: list[Leftover], added: np.ndarray) -> np.ndarray:
    """Return which numbers an ADC may have made that shows uneven codes, or samples at the outermost ones (n,).

    A small rest of what an explanation adds (n,) to the samples at the outermost codes is its own inaccuracy.
    """
    c = fitting.comparison
    of_rail = (x for x in significant if x.kind == 'piled' and x.probability < LIMITS.uneven)
    found = np.zeros(len(c.residual), bool)
    stations = {s for s, codes in enumerate(c.codes) if codes is not None and codes.probability < LIMITS.uneven}
    for left in of_rail:
        explained = added[c.entries.where(kind=left.kind, station=left.station)]
        if left.at_least(left.excess) > LIMITS.clean * float(explained @ explained):
            stations.add(left.station)
    for station in stations:
        for kind in c.kinds:
            if kind.of_converter:
                found[c.rows(kind, station)] = True
    return found


def excess(rest: np.ndarray) -> float:
    """Return by how much the squares of whitened numbers exceed their expectation; zeros are not compared."""
    return float(rest @ rest) - np.count_nonzero(rest)


def _in_clean_cells(rest: np.ndarray, added: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return which numbers lie in cells that an effect explains but for a small rest (n,), beyond that of noise."""
    power, over = np.bincount(cells, added**2), np.bincount(cells, rest**2 - (rest != 0.0))
    by_chance = LIMITS.noise * np.sqrt(2.0 * np.bincount(cells, rest != 0.0))  # chi-squared
    return (np.maximum(over - by_chance, 0.0) < LIMITS.clean * power)[cells]


def _unchanged(fitting: Fitting, added: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return which numbers, of those of which an effect changes few, one does not change (n,)."""
    most = np.zeros(cells.max() + 1)
    np.maximum.at(most, cells, added**2)
    rows = fitting.comparison.rows_of_kinds(lambda kind: kind.sparse)
    found = np.zeros(len(added), bool)
    found[rows] = added[rows] ** 2 <= LIMITS.unchanged * most[cells[rows]]
    return found


def _in_doubt(fitting: Fitting, significant: list[Leftover], rest: np.ndarray, added: np.ndarray) -> np.ndarray:
    """Return which numbers are of a kind, at a station, of which much is left beside what an effect explains (n,).

    A step is left in the ramp where two ripples imitate it, though no single cell shows it. What is relative to a kind
    of which much is left is in doubt with it.
    """
    entries, kinds = fitting.comparison.entries, fitting.comparison.kinds
    found = np.zeros(len(rest), bool)
    sparse = {kind.name for kind in kinds if kind.sparse}
    for left in significant:
        rows = entries.where(kind=left.kind, station=left.station)
        over = excess(rest[rows])
        if left.kind not in sparse:
            over = left.at_least(over)
        resting = (entries.where(kind=kind.name) for kind in kinds if kind.rests_on == left.kind)
        for doubted in (rows, *(rows | other for other in resting)):
            if over > LIMITS.clean * float(added[doubted] @ added[doubted]):
                found |= doubted
    return found
