"""Where a misfit sits and what it looks like: locations, the map over levels and groups, residuals along their axes."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from ..compare.comparison import Comparison
from ..compare.groups import Groups
from ..compare.kinds.kind import Kind, Shown
from ..learn.learning import Learnt, uncertainty
from ..search.fits.fitted import Fitted
from ..search.fits.fitting import Fitting
from .limits import VIEWS
from .result import Location, MisfitMap, Separability, Series


def remainder(comparison: Comparison, chosen: Fitted | None, found: Learnt | None = None) -> np.ndarray:
    """Return whitened residuals beside an explanation and what was learnt (n,), NaN where nothing is compared.

    Errors of the forward models count as noise, see `Fitting.doubt`, and so does that of what was learnt; numbers that
    the effects hardly predict are NaN.
    """
    used = comparison.residual != 0.0
    doubt, template = np.zeros(len(used)), np.zeros(len(used))
    effects = [e.build() for e in chosen.effects] if chosen is not None else []
    if chosen is not None:
        template = comparison.template(effects)
        doubt = Fitting(comparison).doubt(dataclasses.replace(chosen, template=template))
    variance = 1.0 + doubt**2
    if found is not None:
        template = comparison.template((*effects, found.effect))
        variance = variance + uncertainty(comparison, found)
    rest = (comparison.residual - template) / np.sqrt(variance)
    return np.where(used & (doubt < VIEWS.predicted), rest, np.nan)


def _name(comparison: Comparison, kind: Kind, station: int) -> str | None:
    """Return the station's name, None where the numbers are the path's."""
    receiver = kind.receiver(comparison.recorded, station)
    return None if receiver < 0 else comparison.receivers[receiver]


def locations(comparison: Comparison, beside: np.ndarray | None = None) -> tuple[Location, ...]:
    """Return where an excess misfit lies, largest share first.

    Args:
        comparison: recording and model.
        beside: whitened residuals that an explanation leaves (n,), NaN where it does not say what to expect; None takes
            those of the nominal model.
    """
    c = comparison
    residual = c.residual if beside is None else np.nan_to_num(beside)
    excess: dict[tuple[Kind | None, int], float] = {}
    for kind, station in c.series():
        z = residual[c.rows(kind, station)]
        used = np.count_nonzero(z)
        if used:
            excess[kind, station] = max(float(z @ z) - used - VIEWS.beyond_chance * math.sqrt(2.0 * used), 0.0)
    uneven = {i: codes for i, codes in enumerate(c.codes) if codes is not None and codes.probability < VIEWS.by_chance}
    excess |= {(None, station): codes.excess for station, codes in uneven.items()}
    total = sum(excess.values())
    found = []
    for (which, station), amount in sorted(excess.items(), key=lambda item: -item[1]):
        if total <= 0.0 or amount < VIEWS.shown * total:
            continue
        if which is None:  # codes of the ADC
            low, high = uneven[station].low, uneven[station].high
            found.append(Location('if_samples', c.receivers[station], 'adc_code', low, high, amount / total))
            continue
        rows = c.rows(which, station)
        x, squares = which.profile(c.recorded, residual[rows], c.entries.position[rows])
        order = np.argsort(x)
        weight = np.cumsum(np.maximum(squares[order] - np.median(squares), 0.0))
        low, high = x[order][0], x[order][-1]
        if weight[-1] > 0.0:
            low, high = (
                x[order][np.searchsorted(weight, q * weight[-1]).clip(0, len(x) - 1)]
                for q in ((1 - VIEWS.central) / 2, (1 + VIEWS.central) / 2)
            )
        found.append(
            Location(which.level, _name(c, which, station), which.axis, float(low), float(high), amount / total)
        )
    return tuple(found)


def names(comparison: Comparison, kind: Kind, station: int) -> str:
    """Return what a kind of number at a station or channel is called."""
    words, name = kind.words(comparison.recorded, station), _name(comparison, kind, station)
    return f'{words}, {name}' if name else words


def _compared(comparison: Comparison) -> list[tuple[Kind, int]]:
    """Return kinds and stations with numbers that are compared."""
    c = comparison
    return [(kind, station) for kind, station in c.series() if np.any(c.residual[c.rows(kind, station)] != 0.0)]


def misfit_map(comparison: Comparison, chosen: Fitted | None) -> MisfitMap:
    """Return mean squared whitened residuals by kind and group."""
    c = comparison
    rest = remainder(c, chosen)
    rows = _compared(c)
    before = np.full((len(rows), len(c.members)), np.nan)
    after = before.copy()
    for i, (kind, station) in enumerate(rows):
        of_row = c.rows(kind, station)
        for g in range(len(c.members)):
            inside = of_row[(c.entries.group[of_row] == g) & (c.residual[of_row] != 0.0)]
            if len(inside):
                before[i, g] = np.mean(c.residual[inside] ** 2)
                known = rest[inside][np.isfinite(rest[inside])]
                after[i, g] = np.mean(known**2) if len(known) else np.nan
    columns = tuple(f'{c.data.distance[m].mean():.0f} m' for m in c.members)
    return MisfitMap(tuple(names(c, *row) for row in rows), columns, before, after)


def series(comparison: Comparison, chosen: Fitted | None) -> tuple[Series, ...]:
    """Return residuals along their axes, of the group with the largest misfit where there is one for each."""
    c = comparison
    known = np.isfinite(remainder(c, chosen))
    added = c.predict([e.build() for e in chosen.effects]) if chosen else c.plain
    found = []
    for kind, station in _compared(c):
        if not known[c.rows(kind, station)].any():
            continue  # the explanation does not say what to expect
        template = chosen.template if chosen else np.zeros(len(c.residual))
        found.append(_series(c, kind, station, (c.plain, added), (c.residual, template)))
    return tuple(found)


def learnt_series(comparison: Comparison, chosen: Fitted | None, found: Learnt | None) -> tuple[Series, ...]:
    """Return what the effects leave along the axes, with what was learnt of it; of the kinds that were learnt."""
    if found is None:
        return ()
    c = comparison
    effects = [e.build() for e in chosen.effects] if chosen else []
    base, added = c.predict(effects), c.predict((*effects, found.effect))
    before, after = c.template(effects) if effects else np.zeros(len(c.residual)), c.template((*effects, found.effect))
    wanted = {(x.kind, x.row) for x in found.curves} | {('lines', x.row) for x in found.curves if x.smooth is None}
    return tuple(
        _series(c, kind, station, (base, added), (c.residual - before, after - before))
        for kind, station in _compared(c)
        if (kind.name, max(station, 0)) in wanted
    )


def _series(
    comparison: Comparison,
    kind: Kind,
    station: int,
    predicted: tuple[Groups, Groups],
    whitened: tuple[np.ndarray, np.ndarray],
) -> Series:
    """Return the numbers of a kind at a station beyond a model, of the group with the largest misfit.

    Args:
        comparison: recording and model.
        kind: of the numbers.
        station: its number, or that of the ramp's channel; -1 for the path.
        predicted: by the model without and with what explains the numbers.
        whitened: residuals beyond the former, and what the latter adds (n,).
    """
    c = comparison
    rows = c.rows(kind, station)
    residual, template = whitened
    worst = int(np.bincount(c.entries.group[rows], residual[rows] ** 2).argmax())
    inside = rows[c.entries.group[rows] == worst]
    base, added = (groups[kind.name] for groups in predicted)
    plotted = kind.plotted(
        Shown(
            recorded=c.recorded,
            row=station,
            group=worst,
            residual=c.measured[kind.name] - base,
            std=c.std[kind.name],
            curve=added - base,
            whitened=residual[inside],
            template=template[inside],
        )
    )
    values = plotted.x, plotted.residual, plotted.std, plotted.curve, plotted.unit
    label = names(c, kind, station) + plotted.where
    return Series(kind.level, _name(c, kind, station), kind.axis, *values, label)


def separability(rounds: Sequence[Sequence[Fitted]]) -> Separability | None:
    """Return how far the best explanations with one effect lie from each other."""
    ranked = rounds[0][: VIEWS.compared] if rounds else []
    if len(ranked) < 2:
        return None
    names = []
    for fitted in ranked:
        effect = fitted.effects[0]
        names.append(effect.candidate.effect + (f' ({effect.candidate.station})' if effect.candidate.station else ''))
    templates = np.array([f.template for f in ranked])
    distance = np.sqrt(np.sum((templates[:, None] - templates[None]) ** 2, axis=-1))
    return Separability(tuple(names), distance)
