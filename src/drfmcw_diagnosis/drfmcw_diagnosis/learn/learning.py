"""The measured remainder of a comparison: which terms there are, how far they hold, and what does not repeat."""

import dataclasses
import functools
from collections.abc import Collection, Sequence

import numpy as np

from drfmcw_sim.effects import Effect
from drfmcw_sim.synthesis.measured import Measured, MeasuredModel, Term

from ..compare.comparison import Comparison
from ..search.leftovers import Leftover
from .added import line_terms, noise_terms
from .background import background
from .curves import Curve, curves, model_of
from .evidence import LeftOver
from .smoothing import Smooth

_SPECTRAL = ('lines', 'mean')  # kinds of numbers in which a background shows


@dataclasses.dataclass(frozen=True)
class Learnt:
    """What was learnt from one comparison."""

    comparison: Comparison
    curves: tuple[Curve, ...]

    @property
    def model(self) -> MeasuredModel:
        """What the simulator reads."""
        return model_of(self.comparison, [t for curve in self.curves for t in curve.terms])

    @functools.cached_property
    def effect(self) -> Measured:
        """What simulates it in a comparison."""
        return Measured(self.model, noisy=False)

    def only(self, kept: Collection[tuple[str, int]]) -> 'Learnt | None':
        """Return the curves of some kinds and rows, None where there is none."""
        curves = tuple(c for c in self.curves if (c.kind, c.row) in kept)
        return Learnt(self.comparison, curves) if curves else None


def learnt(comparison: Comparison, effects: Sequence[Effect], leftovers: Sequence[Leftover]) -> Learnt | None:
    """Return what is learnt of the remainder of a comparison, None where nothing of it repeats.

    Args:
        comparison: recording and model.
        effects: of the explanation.
        leftovers: what these leave beyond chance: nothing else is learnt.
    """
    wanted = [(x.kind, x.station) for x in leftovers]
    found: list[Curve] = []

    def left() -> LeftOver:
        return LeftOver(comparison, (*effects, Learnt(comparison, tuple(found)).effect) if found else effects)

    for kinds, name, make in (
        (_SPECTRAL, 'mean', background),
        (('lines',), 'lines', line_terms),
    ):
        for station in sorted({s for kind, s in wanted if kind in kinds}):
            terms = make(left(), station)
            found += [Curve(name, station, None, terms)] if terms else []
    for station in sorted({s for kind, s in wanted if kind == 'noise'}):
        curve, terms = noise_terms(left(), station)
        found += [Curve('noise', station, curve, terms)] if terms else []
    bent = curves(left(), [x for x in wanted if x[0] == 'ramp'])
    found += bent
    # what bends phases over the sweep also moves lines
    others = [x for x in wanted if x[0] != 'ramp'] + (_moved(comparison) if bent else [])
    found += curves(left(), list(dict.fromkeys(others)))
    return Learnt(comparison, tuple(found)) if found else None


def _moved(comparison: Comparison) -> list[tuple[str, int]]:
    """Return kinds and rows that a response over the sweep may move, as `Leftover` has them."""
    return [('beat', -1), ('range', -1), *(('amplitude', i) for i in range(len(comparison.receivers)))]


def uncertainty(comparison: Comparison, found: Learnt) -> np.ndarray:
    """Return the variance of what was learnt, in a comparison's numbers over their standard deviations (n,)."""
    c = comparison
    result = np.zeros(len(c.residual))
    kinds = {kind.name: kind for kind in c.kinds}
    for curve in found.curves:
        if curve.smooth is None:
            continue
        kind = kinds[curve.kind]
        std = c.std[curve.kind]
        std = (std[:, None] if std.ndim == 1 else std)[:, curve.row].reshape(len(c.members), -1)
        variance = _over_groups(c, curve.smooth)
        over = np.nan_to_num(variance / std**2, posinf=0.0)
        rows = c.rows(kind, curve.row if c.std[curve.kind].ndim > 1 else None)
        result[rows] += over.ravel()
    return result


def _over_groups(comparison: Comparison, smooth: Smooth) -> np.ndarray:
    """Return the variance of a curve in each group of a comparison (G, P)."""
    axis = smooth.covariate
    over = LeftOver(comparison, ()).over_groups(axis.axis, axis.station)
    term = Term('', '', '', '', smooth.at, np.zeros(smooth.variance.shape[1]), smooth.variance)
    return term.over(over)
