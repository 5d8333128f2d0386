"""Whether sweeps that seem to hold bursts hold something of their line instead.

In: an explanation, and the samples. Out: of each effect that comes and goes, how much stronger what these sweeps have
beyond the others is near the line than far from it. A burst is as strong anywhere in the IF. Samples that are lost in
some sweeps, or a phase that jumps in them, spread the line's own power: the more, the nearer.
"""

import dataclasses

import numpy as np

from ..features.extractor import as_complex
from ..search.fits.fitted import Fitted
from ..search.fits.fitting import Fitting
from .receivers import receivers_of


@dataclasses.dataclass(frozen=True)
class BurstLimits:
    """Where a burst is looked for beside the line."""

    near: tuple[int, int] = (24, 48)
    """Resolution cells from the line between which something of it would show; chosen: beyond its leakage."""

    far: int = 200
    """Resolution cells from the line, from which on it hardly shows; chosen."""

    nearer: float = 10.0
    """Power near the line over that far from it [1], from which on it is no burst's; chosen: an IF filter of one pole
    makes less of a white burst."""

    least: float = 1.0
    """Such power over that of other sweeps near the line, at least [1]; chosen."""

    sweeps: int = 3
    """Sweeps that seem to hold a burst, at least; chosen."""


LIMITS = BurstLimits()


def of_lines(fitting: Fitting, fitted: Fitted) -> list[float]:
    """Return how many times as strong bursts are near the line as far from it; 0 for other effects and where unknown.

    Args:
        fitting: of the recording.
        fitted: the explanation.
    """
    found = [0.0] * len(fitted.effects)
    for number, effect in enumerate(fitted.effects):
        if effect.candidate.kind.bursts:
            found[number] = max((_ratio(fitting, i) for i in receivers_of(fitting, effect)), default=0.0)
    return found


def _ratio(fitting: Fitting, receiver: int) -> float:
    """Return the power near the line over that far from it, of sweeps that seem to hold a burst beyond the others."""
    c = fitting.comparison
    samples = c.data.samples_of(c.heard[receiver])
    sums, count = np.zeros(3), 0  # near and far beyond other sweeps, and near of others: over the line's power
    for sweeps, rows in zip(c.sweeps, c.members, strict=True):
        free = sweeps.free[:, receiver]
        if free.all() or np.count_nonzero(free) < LIMITS.sweeps:
            continue
        each = as_complex(samples[rows].astype(np.float32), c.recorded.topology.iq)
        power = np.abs(np.fft.fft(each * np.hanning(each.shape[1]), axis=1)) ** 2
        power /= np.median(power.max(axis=1))
        frequency = np.fft.fftfreq(each.shape[1], 1.0 / each.shape[1])  # [resolution cells]
        place = float(sweeps.line[:, receiver].mean()) / c.recorded.sample_rate * each.shape[1]
        away = np.abs(frequency - place)
        used = (frequency >= 0.0) | c.recorded.topology.iq  # of real samples the others are the same again
        near, far = used & (away >= LIMITS.near[0]) & (away < LIMITS.near[1]), used & (away >= LIMITS.far)
        loud, others = power[~free].sum(axis=0), power[free].mean(axis=0) * np.count_nonzero(~free)
        sums += [(loud - others)[near].mean(), (loud - others)[far].mean(), others[near].mean()]
        count += int(np.count_nonzero(~free))
    beyond, far_off, usual = sums
    if count < LIMITS.sweeps or beyond < LIMITS.least * usual:
        return 0.0
    return float(beyond / max(far_off, 1e-3 * beyond))
