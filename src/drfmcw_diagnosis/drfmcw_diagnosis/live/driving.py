"""Whether the crane drives, by its reference or its ranges, and from its first centimetre on by the carrier's phase."""

import numpy as np

from ..compare.comparison import Comparison
from .limits import DRIVING


def drives(comparison: Comparison) -> bool:
    """Return True where the crane moves in some of the sweeps that are compared."""
    return _runs(comparison) or _begins(comparison)


def _runs(comparison: Comparison) -> bool:
    """Return whether the distance changes within a group: the reference's, without one that which is measured."""
    velocity, std = comparison.data.motion
    return bool(np.any(np.abs(velocity) > np.maximum(DRIVING.certain * std, DRIVING.standing)))


def _begins(comparison: Comparison) -> bool:
    """Return whether the phase shows a movement that goes on, or that brought the crane elsewhere; sway does neither.

    The distance shows a drive only where it has passed its noise, and the phase a hundredth of that.
    """
    moved, std = comparison.measured.movement, comparison.std.movement
    groups = np.split(np.arange(len(moved)), np.cumsum([len(m) for m in comparison.members])[:-1])
    time = (comparison.data.time[members] for members in comparison.members)
    moving = [g for g, (t, rows) in enumerate(zip(time, groups, strict=True)) if _moves(t, moved[rows], std[rows])]
    last = len(groups) - 1
    return bool(moving) and all(
        g == last or _differs(comparison, g, g + 1) or (g > 0 and _differs(comparison, g - 1, g)) for g in moving
    )


def _moves(time: np.ndarray, moved: np.ndarray, std: np.ndarray) -> bool:
    """Return whether a crane moves at some time of a group; arguments (n,) [s], [m]."""
    for count in DRIVING.spans:
        if count > len(time):
            break
        t, way, noise = (np.lib.stride_tricks.sliding_window_view(x, count) for x in (time, moved, std))
        t = t - t.mean(axis=1, keepdims=True)
        spread = np.sum(t * t, axis=1)
        velocity = np.sum(t * way, axis=1) / spread
        error = np.sqrt(np.mean(noise**2, axis=1) / spread)
        if np.any(np.abs(velocity) > np.maximum(DRIVING.certain_phase * error, DRIVING.standing)):
            return True
    return False


def _differs(comparison: Comparison, one: int, other: int) -> bool:
    """Return whether two groups lie at different distances."""
    distances = [comparison.data.distance[comparison.members[g]] for g in (one, other)]
    noise = np.hypot(*(np.std(d) / np.sqrt(len(d)) for d in distances))
    return bool(abs(np.mean(distances[0]) - np.mean(distances[1])) > DRIVING.certain * noise)
