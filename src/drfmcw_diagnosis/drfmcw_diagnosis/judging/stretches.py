"""Stretches over which the received power is another one: while it rains, or where something stands in the way.

In: an explanation. Out: of each effect that shows in the received power alone, by how much it gains more than a stretch
of a condition, distance, time or temperature, in which both stations receive less or more. A loss everywhere imitates
half of such a stretch.
"""

import dataclasses

import numpy as np

from ..compare.comparison import Comparison
from ..search.fits.fitted import Fitted, Freedom
from ..search.fits.fitting import Fitting
from .curves import conditions
from .receivers import of_level


@dataclasses.dataclass(frozen=True)
class StretchLimits:
    """When a stretch is taken for the cause."""

    by_power: float = 0.9
    """Share of an effect's power in the received power, above which a stretch may stand for it [1]; chosen."""

    parameter: float = 2.0
    """Gain that each parameter must bring (Akaike 1974)."""

    of_stretch: int = 2
    """Parameters of a stretch: its place and its size; how many places are tried counts as well."""

    beaten: float = 0.0
    """Gain of an effect beyond that of a stretch in its place, below which it is in doubt; chosen, as of a step."""


LIMITS = StretchLimits()


def beyond_stretches(fitting: Fitting, fitted: Fitted) -> list[float]:
    """Return by how much each effect gains more than a stretch in its place, infinity for effects that show elsewhere.

    What a stretch explains beside an effect counts for the effect.

    Args:
        fitting: of the recording.
        fitted: the explanation.
    """
    c, whitening = fitting.comparison, fitting.whitening
    found = [np.inf] * len(fitted.effects)
    of_power = of_level(fitting, 'amplitude')
    added = [whitening(fitting.added_beside(fitted, number)) for number in range(len(found))]
    own = [i for i, x in enumerate(added) if float(x[of_power] @ x[of_power]) >= LIMITS.by_power * float(x @ x)]
    masks = _stretches(fitting) if own else np.zeros((0, 0))
    if not len(masks):
        return found
    slopes, rest = whitening(fitting.slopes(fitted)), whitening(c.residual - fitted.template)
    stretches = whitening(_templates(c, masks))
    beside_them = _worth(stretches, Freedom(slopes), rest)
    for number in own:
        span = fitted.spans[number]
        others = Freedom(np.delete(slopes, span, axis=0))
        unexplained, left = others.left(rest + added[number]), others.left(rest)
        gain = float(unexplained @ unexplained - left @ left) - LIMITS.parameter * (span.stop - span.start)
        found[number] = gain + beside_them - _worth(stretches, others, unexplained)
    return found


def _worth(stretches: np.ndarray, beside: Freedom, rest: np.ndarray) -> float:
    """Return the gain of the best stretch in a rest (n,), less what its parameters cost; none of less.

    Args:
        stretches: whitened (M, n).
        beside: the freedom of effects.
        rest: what they leave, whitened (n,).
    """
    whole = np.einsum('mn,mn->m', stretches, stretches)
    power = whole - beside.followed(stretches)
    gains = (stretches @ beside.left(rest)) ** 2 / np.maximum(power, 1e-6 * whole + 1e-30)  # some are not compared
    places = 2.0 * np.log(len(stretches))
    return max(float(gains.max()) - LIMITS.parameter * LIMITS.of_stretch - places, 0.0)


def _stretches(fitting: Fitting) -> np.ndarray:
    """Return distinct stretches of any condition, which hold some of the groups (M, G)."""
    found = set()
    for x in conditions(fitting).values():
        values = np.unique(x)
        for i, first in enumerate(values):
            for last in values[i:]:
                found.add(tuple(((x >= first) & (x <= last)).tolist()))
    everywhere = (True,) * len(fitting.comparison.members)
    return np.array(sorted(found - {everywhere}), float)


def _templates(c: Comparison, masks: np.ndarray) -> np.ndarray:
    """Return a change of both stations' received power in some groups (M, G), over standard deviations (M, n)."""
    kind = next(k for k in c.kinds if k.name == 'amplitude')
    rows = c.rows(kind)
    found = np.zeros((len(masks), len(c.residual)))
    found[:, rows] = masks[:, c.entries.group[rows]] / np.asarray(c.std['amplitude']).ravel()
    return found
