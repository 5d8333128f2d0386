"""The measured remainder of a comparison: which terms there are, how far they hold, and what does not repeat."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from drfmcw_sim.effects import Effect
from drfmcw_sim.measured import Measured, MeasuredModel, Term

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

    model: MeasuredModel
    curves: tuple[Curve, ...]

    @property
    def effect(self) -> Measured:
        """What simulates it in a comparison."""
        return Measured(self.model, noisy=False)


def learnt(comparison: Comparison, effects: Sequence[Effect], leftovers: Sequence[Leftover]) -> Learnt | None:
    """Return what is learnt of the remainder of a comparison, None where nothing of it repeats.

    Args:
        comparison: recording and model.
        effects: of the explanation.
        leftovers: what these leave beyond chance: nothing else is learnt.
    """
    wanted = [(x.kind, x.station) for x in leftovers]
    present = tuple(effects)
    added: list[Term] = []
    found: list[Curve] = []
    for station in sorted({s for kind, s in wanted if kind in _SPECTRAL}):
        added += background(LeftOver(comparison, present), station)
    for station in sorted({s for kind, s in wanted if kind == 'lines'}):
        added += line_terms(LeftOver(comparison, _with(comparison, present, added)), station)
    for station in sorted({s for kind, s in wanted if kind == 'noise'}):
        left = LeftOver(comparison, _with(comparison, present, added))
        curve, terms = noise_terms(left, station)
        added += terms
        if curve is not None:
            found.append(Curve('noise', station, curve, terms))
    found += curves(LeftOver(comparison, _with(comparison, present, added)), wanted)
    terms_ = [*added, *(t for curve in found if curve.kind != 'noise' for t in curve.terms)]
    return Learnt(model_of(comparison, terms_), tuple(found)) if terms_ else None


def _with(comparison: Comparison, effects: tuple[Effect, ...], terms: Sequence[Term]) -> tuple[Effect, ...]:
    """Return effects with what has been learnt so far."""
    return (*effects, Measured(model_of(comparison, terms), noisy=False)) if terms else effects


def uncertainty(comparison: Comparison, found: Learnt) -> np.ndarray:
    """Return the variance of what was learnt, in a comparison's numbers over their standard deviations (n,)."""
    c = comparison
    result = np.zeros(len(c.residual))
    kinds = {kind.name: kind for kind in c.kinds}
    for curve in found.curves:
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
