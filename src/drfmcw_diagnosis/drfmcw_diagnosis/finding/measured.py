"""The measured remainder as a finding: what was learnt, how well it predicts held-out sweeps, and what is random."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drfmcw_sim.synthesis.measured import write_measured

from ..compare.comparison import Comparison
from ..learn.curves import Curve
from ..learn.learning import Learnt, learnt
from ..search.fits.fitted import Fitted
from ..search.leftovers import Leftover
from .limits import REPEATS, VIEWS
from .result import BeforeAfter, MeasuredCurve, MeasuredRemainder, RandomPart
from .views import names, remainder

MODEL = 'measured.npz'
"""File beside the refined configuration."""


def measured_remainder(
    comparison: Comparison,
    chosen: Fitted | None,
    leftovers: Sequence[Leftover],
    fitted: tuple[Comparison, Fitted | None],
    held_out: Comparison | None,
) -> tuple[MeasuredRemainder | None, Learnt | None]:
    """Return what is learnt of a remainder and its model, None without a remainder.

    Curves that do not predict the held-out sweeps are left out.

    Args:
        comparison: all sweeps that are compared.
        chosen: explanation.
        leftovers: what it leaves beyond chance.
        fitted: the sweeps that are fitted, and the explanation fitted to them.
        held_out: the others, None where there are none.
    """
    if not leftovers:
        return None, None
    part, again = fitted
    found = learnt(part, _effects(again), leftovers)
    if held_out is not None and found is not None:
        found = found.only(_predicting(held_out, again, found))
    inside = _change(part, again, found)
    outside = _change(held_out, again, found) if held_out is not None else None
    full = learnt(comparison, _effects(chosen), leftovers) if found is not None else None
    if found is not None and full is not None:
        full = full.only({(c.kind, c.row) for c in found.curves})
    judged = outside or inside
    repeats = _repeating(held_out or part, again, found, leftovers) if found is not None else 0.0
    unmodelled: tuple[str, ...] = ()
    random: tuple[RandomPart, ...] = ()
    if repeats < REPEATS.wholly or judged.after > REPEATS.complete:
        tested = held_out if held_out is not None else part
        unmodelled = _exceeding(tested, remainder(tested, again, found), leftovers)
        random = tuple(_random(comparison, chosen, full, i) for i in range(len(comparison.receivers)))
    curves = tuple(_described(comparison, c) for c in full.curves) if full is not None else ()
    return MeasuredRemainder(curves, repeats, inside, outside, unmodelled, random), full


def write_model(folder: Path, found: Learnt) -> str:
    """Write the model into a folder and return its path."""
    path = folder / MODEL
    write_measured(path, found.model)
    return str(path)


def _effects(fitted: Fitted | None) -> tuple:
    return tuple(e.build() for e in fitted.effects) if fitted is not None else ()


def _change(comparison: Comparison, fitted: Fitted | None, found: Learnt | None) -> BeforeAfter:
    """Return the misfit per degree of freedom of the effects alone, and with what was learnt."""
    before = float(np.nanmean(remainder(comparison, fitted) ** 2))
    return BeforeAfter(before, float(np.nanmean(remainder(comparison, fitted, found) ** 2)) if found else before)


def _repeating(comparison: Comparison, fitted: Fitted | None, found: Learnt, leftovers: Sequence[Leftover]) -> float:
    """Return the share of the excess beyond chance that the curves predict, of the numbers that were left over."""
    c = comparison
    kinds = {kind.name: kind for kind in c.kinds}
    rows = [c.rows(kinds[x.kind], x.station) for x in leftovers if x.kind in kinds]
    chosen = np.concatenate(rows) if rows else np.zeros(0, int)
    excess = []
    for learned in (None, found):
        z = remainder(c, fitted, learned)[chosen]
        z = z[np.isfinite(z)]
        excess.append(max(float(z @ z) - len(z) - VIEWS.beyond_chance * np.sqrt(2.0 * len(z)), 0.0))
    return float(np.clip(1.0 - excess[1] / excess[0], 0.0, 1.0)) if excess[0] else 1.0


def _predicting(held_out: Comparison, fitted: Fitted | None, found: Learnt) -> set[tuple[str, int]]:
    """Return kinds and rows of the curves that predict held-out sweeps better than nothing does."""
    before, after = (remainder(held_out, fitted, x) ** 2 for x in (None, found))
    kinds = {kind.name: kind for kind in held_out.kinds}
    kept = set()
    for curve in found.curves:
        kind = kinds[curve.kind]
        rows = held_out.rows(kind, None if held_out.std[curve.kind].ndim == 1 else curve.row)
        # a curve of the path may only undo what others move
        alone = any(x.kind == 'ramp' for x in found.curves) and curve.kind != 'ramp'
        if alone or np.nansum(after[rows]) < np.nansum(before[rows]):
            kept.add((curve.kind, curve.row))
    return kept


def _exceeding(comparison: Comparison, rest: np.ndarray, leftovers: Sequence[Leftover]) -> tuple[str, ...]:
    """Return in words the kinds of numbers that hold more than noise still."""
    wanted = {x.kind for x in leftovers}
    found = []
    for kind, station in comparison.series():
        z = rest[comparison.rows(kind, station)]
        z = z[np.isfinite(z)]
        if kind.name in wanted and len(z) and np.mean(z**2) > 1.0 + REPEATS.exceeding * np.sqrt(2.0 / len(z)):
            found.append(names(comparison, kind, station))
    return tuple(found)


def _described(comparison: Comparison, curve: Curve) -> MeasuredCurve:
    """Return a curve in words of the interface."""
    kind = next(k for k in comparison.kinds if k.name == curve.kind)
    row = curve.row if comparison.std[curve.kind].ndim > 1 else -1
    quantities = tuple(dict.fromkeys(t.quantity for t in curve.terms))
    label = names(comparison, kind, row)
    if curve.smooth is None:
        return MeasuredCurve(label, quantities, curve.terms[0].axis, None, None, None)
    elsewhere = curve.smooth.elsewhere
    return MeasuredCurve(
        label,
        quantities,
        curve.smooth.covariate.axis,
        curve.smooth.terms,
        curve.smooth.freedom,
        elsewhere if np.isfinite(elsewhere) else None,
    )


def _random(comparison: Comparison, chosen: Fitted | None, found: Learnt | None, station: int) -> RandomPart:
    """Return statistics of what does not repeat at a station: its spectrum and how it is spread."""
    effects = (*_effects(chosen), found.effect) if found is not None else _effects(chosen)
    expected = comparison.predict(effects)['noise'][:, station]
    beyond = comparison.measured['noise'][:, station] - expected
    known = np.isfinite(beyond) & np.isfinite(comparison.std['noise'][:, station])
    bands = [float(np.mean(b[k])) if k.any() else None for b, k in zip(beyond.T, known.T, strict=True)]
    spans = np.concatenate([s.quiet[:, station] / np.median(s.quiet[:, station]) for s in comparison.sweeps])
    strongest = np.sort(spans.ravel())[::-1][: max(spans.size // 100, 1)]
    power = 10.0 * np.log10(spans.mean(axis=1))
    rate = comparison.recorded.sample_rate
    edges = np.linspace(0.0, rate / 2.0, len(bands) + 1)
    return RandomPart(
        station=comparison.receivers[station],
        spectrum=tuple(zip(edges[:-1].tolist(), edges[1:].tolist(), bands, strict=True)),
        strongest=float(strongest.sum() / spans.sum()),
        sweep_std=float(power.std()),
        modulation=_modulation(comparison, station),
    )


def _modulation(comparison: Comparison, station: int) -> float | None:
    """Return the frequency at which the sweeps of all groups change most [Hz], None without one beyond chance."""
    kind = next(k for k in comparison.kinds if k.name == 'flutter')
    best: tuple[float, float] | None = None
    for row, channel in enumerate(comparison.channels):
        if channel.receiver not in (station, -1):
            continue
        rows = comparison.rows(kind, row)
        z = comparison.residual[rows].reshape(len(comparison.members), -1)
        together = z.sum(axis=0) / math.sqrt(max(int(np.count_nonzero(z.any(axis=1))), 1))
        at = int(together.argmax())
        largest = float(together[at])
        if largest > REPEATS.rhythm and (best is None or largest > best[0]):
            step = float(comparison.time[1] - comparison.time[0])
            best = largest, at / (2.0 * z.shape[1] * step)
    return None if best is None else best[1]
