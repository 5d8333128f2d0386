"""Blocks of the ramp that change from sweep to sweep far more than others: they are left out.

In: the ramps of a group's sweeps. Out: the same without such blocks. While a synthesiser settles, the line may sweep
over so much of the band within a block that its mirror line decides what is left of it, at a phase of its own in each
sweep. A cosine series spreads such a block over all of its terms.
"""

from collections.abc import Sequence

import numpy as np

from .limits import BLOCKS


def uneven(ramps: Sequence[np.ndarray]) -> np.ndarray:
    """Return which blocks scatter far more than those of the same channel usually do, in each group (G, C, K).

    A synthesiser makes them so in many groups. None are in groups of few sweeps.

    Args:
        ramps: of each group's sweeps (n, C, K), see `SweepFeatures`.
    """
    found = np.stack([_uneven(ramp) for ramp in ramps])
    return np.asarray(found & (found.mean(axis=0) >= BLOCKS.groups))


def _uneven(ramp: np.ndarray) -> np.ndarray:
    """Return the same of one group by itself (C, K)."""
    if len(ramp) < BLOCKS.sweeps:
        return np.zeros(ramp.shape[1:], bool)
    scatter = ramp.std(axis=0)
    return np.asarray(scatter > BLOCKS.uneven * np.median(scatter, axis=1, keepdims=True))


def without(ramp: np.ndarray, left_out: np.ndarray, phases: int) -> np.ndarray:
    """Return ramps whose blocks left out are zero, and whose others have no mean, nor a slope if of a phase (..., K).

    Each sweep has its own amplitude, phase and frequency, which only blocks that count may determine.

    Args:
        ramp: of sweeps (..., C, K).
        left_out: which blocks of them (..., C, K).
        phases: number of the first channel of a phase.
    """
    kept = 1.0 - left_out
    count = np.maximum(kept.sum(axis=-1, keepdims=True), 1.0)
    result = (ramp - (ramp * kept).sum(axis=-1, keepdims=True) / count) * kept
    time = np.arange(ramp.shape[-1], dtype=float)
    time = (time - (time * kept).sum(axis=-1, keepdims=True) / count) * kept
    slope = (result * time).sum(axis=-1, keepdims=True) / np.maximum((time**2).sum(axis=-1, keepdims=True), 1.0)
    slope[..., :phases, :] = 0.0
    changed = left_out.any(axis=-1, keepdims=True)
    return np.asarray(np.where(changed, result - slope * time, ramp))
