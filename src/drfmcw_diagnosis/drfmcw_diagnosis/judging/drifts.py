"""A drift without a name that all groups of sweeps share.

In: an explanation. Out: how much of what a sway explains such a drift explains in its place. A delay that creeps turns
the carrier's phase alike in each group. A sway does so where its frequency is an alias, one over the time between
groups: each group then shows the same part of its course.
"""

import numpy as np

from drfmcw_sim.effects import Motion

from ..compare.algebra import gain_of
from ..search.fits.fitted import Fitted, Freedom
from ..search.fits.fitting import Fitting


def drifting(fitting: Fitting, fitted: Fitted) -> list[float]:
    """Return of each effect the share of its gain that one drift for all groups has in its place, 0 of all but a sway.

    Args:
        fitting: of the recording.
        fitted: the explanation.
    """
    found = [0.0] * len(fitted.effects)
    sways = [n for n, effect in enumerate(fitted.effects) if effect.candidate.kind.motion is Motion.SWAY]
    if not sways:
        return found
    c, whitening = fitting.comparison, fitting.whitening
    slopes = whitening(fitting.slopes(fitted))
    rest = whitening(c.residual - fitted.template)
    drift = whitening(_drift(fitting)[None])
    for number in sways:
        beside = Freedom(np.delete(slopes, fitted.spans[number], axis=0))
        unexplained = beside.left(rest + whitening(fitting.added_beside(fitted, number)))
        left = beside.left(rest)
        gain = float(unexplained @ unexplained - left @ left)
        found[number] = gain_of(beside.left(drift), unexplained) / max(gain, 1e-30)
    return found


def _drift(fitting: Fitting) -> np.ndarray:
    """Return the same speed within each group, over the numbers' standard deviations (n,)."""
    c = fitting.comparison
    chosen = np.flatnonzero(c.entries.where(kind='movement'))
    rows, group = c.entries.position[chosen], c.entries.group[chosen]
    time = c.data.time[rows]
    mean = np.bincount(group, time) / np.maximum(np.bincount(group), 1)
    found = np.zeros(len(c.residual))
    found[chosen] = (time - mean[group]) / c.std.movement
    return found
