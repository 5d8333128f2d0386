"""Whether an event at one time of every sweep explains what an effect explains: a step or a bump, which has no name.

In: an explanation. Out: what each effect that shows over the sweep alone gains beyond the best event in its place. No
effect of the registry is an event in mid-sweep, and where one fits better than the effect, the effect is in doubt.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
import scipy.fft
from scipy import special

from .fitting import Fitted, Fitting, Freedom


@dataclasses.dataclass(frozen=True)
class EventLimits:
    """Which events take the place of an effect."""

    by_ramp: float = 0.9
    """Share of an effect's power over the sweep, above which an event may stand for it [1]; chosen."""

    edge: float = 0.1
    """Share of the sweep at either end in which an event may be what settles there [1]; chosen."""

    widths: tuple[float, ...] = (0.0, 2.0, 5.0)
    """Standard deviations of an event's onset [blocks of the sweep]; chosen."""

    longest: float = 2.0
    """Standard deviation of a bump, at most: wider ones resemble a curved ramp [blocks]; chosen."""

    beaten: float = -6.0
    """Gain of an effect beyond that of the best event, below which it is in doubt: odds of 20 to 1; chosen."""

    parameter: float = 2.0
    """Gain that each parameter must bring which an effect has more than an event (Akaike 1974)."""

    of_event: int = 2
    """Parameters of an event: its time and its size."""

    least_power: float = 0.1
    """Share of an event's power that the other effects must leave of it [1]; chosen."""


LIMITS = EventLimits()


def beyond_events(fitting: Fitting, fitted: Fitted) -> list[float]:
    """Return by how much each effect's gain exceeds that of the best event, infinity where no event compares.

    Args:
        fitting: of the recording.
        fitted: the explanation.
    """
    c, whitening = fitting.comparison, fitting.whitening
    slopes = whitening(fitting.slopes(fitted))
    rest = whitening(c.residual - fitted.template)
    over_sweep = c.entries.where(kind='ramp')
    found = []
    for number, own in enumerate(fitted.spans):
        others = [e.build() for i, e in enumerate(fitted.effects) if i != number]
        added = whitening(fitted.template - (c.template(others) if others else 0.0))
        if float(np.sum(added[over_sweep] ** 2)) < LIMITS.by_ramp * float(added @ added):
            found.append(np.inf)
            continue
        beside = Freedom(np.delete(slopes, own, axis=0))
        unexplained = beside.left(rest + added)
        gain = float(unexplained @ unexplained - rest @ rest)
        best = max(_gains(fitting, unexplained, beside))
        found.append(gain - best - LIMITS.parameter * max(own.stop - own.start - LIMITS.of_event, 0))
    return found


def _gains(fitting: Fitting, rest: np.ndarray, beside: Freedom) -> Iterator[float]:
    """Yield the gain of the best event in each channel of the ramp, in both phases, as large at all distances or not.

    Args:
        fitting: of the recording.
        rest: what is to be explained, beyond what other effects can follow, whitened (n,).
        beside: of the other effects.
    """
    c = fitting.comparison
    kind = next(k for k in c.kinds if k.name == 'ramp')
    channels = [(c.rows(kind, row), c.std['ramp'][:, row]) for row in range(c.std['ramp'].shape[1])]
    phases = [i for i in range(len(channels)) if c.recorded.channels[i].of_phase]
    signs = [{i: 1.0} for i in range(len(channels))]
    signs += [{phases[0]: 1.0, phases[1]: sign} for sign in (1.0, -1.0) if len(phases) == 2]
    shapes = scipy.fft.dct(_shapes(channels[0][1].shape[1]), norm='ortho', axis=1)  # (M, K)
    near = c.recorded.distance / c.recorded.distance.mean()
    for law in (np.ones_like(near), near):
        for sign in signs:
            remains, power = np.zeros(len(shapes)), np.zeros(len(shapes))
            imitated = np.zeros((len(shapes), len(beside.slopes)))
            for channel, factor in sign.items():
                rows, std = channels[channel]
                share = factor * law[:, None] * fitting.whitening.weight[rows].reshape(std.shape) / std
                remains += shapes @ np.sum(rest[rows].reshape(std.shape) * share, axis=0)
                power += shapes**2 @ np.sum(share**2, axis=0)
                imitated += shapes @ np.einsum('pgk,gk->kp', beside.slopes[:, rows].reshape(-1, *std.shape), share)
            left = power - beside.power(imitated)
            used = left > LIMITS.least_power * power
            yield float(np.max(remains[used] ** 2 / left[used], initial=0.0))


def _shapes(count: int) -> np.ndarray:
    """Return steps and bumps over `count` blocks (M, count)."""
    block = np.arange(count)
    at = np.arange(round(LIMITS.edge * count), round((1.0 - LIMITS.edge) * count))[:, None]
    found = []
    for width in LIMITS.widths:
        found.append(special.ndtr((block - at + 0.5) / max(width, 1e-3)))
        if width <= LIMITS.longest:
            found.append(np.exp(-0.5 * ((block - at) / max(width, 0.5)) ** 2))
    return np.concatenate(found)
