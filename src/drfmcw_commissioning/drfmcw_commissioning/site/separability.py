"""What the sweeps of a site can separate, and which further measurement would: the diagnosis, asked about a fit.

The corrections are taken for true and simulated under the conditions of the recording. What predicts the same sweeps is
a rival, whatever else the recording holds. The errors of the reference instrument are among the rivals.
"""

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.finding.result import NextMeasurement
from drfmcw_diagnosis.judging.rivals import rivals
from drfmcw_diagnosis.next.ranking import ranked
from drfmcw_diagnosis.recording.dataset import Dataset, read_dataset
from drfmcw_diagnosis.recording.thinning import representative
from drfmcw_diagnosis.search.fits.fitted import Fitted, FittedEffect
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.search import Search
from drfmcw_diagnosis.search.starts.bank import Candidate as Searched
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import declared_parameters
from drfmcw_sim.effects import Effect, Of, Stated

from .candidates import Candidate, title
from .fit import SiteFit

_STILL = 1e-3  # how still a crane stands at a mark, from sweep to sweep [m]


@dataclasses.dataclass(frozen=True)
class Size:
    """One number of an explanation, with what it is in words."""

    title: str
    value: float  # [unit]
    std: float  # [unit]
    unit: str


@dataclasses.dataclass(frozen=True)
class Rival:
    """Another explanation of the same sweeps."""

    sizes: tuple[Size, ...]
    distance: float  # of the sweeps that it predicts [standard deviations]


@dataclasses.dataclass(frozen=True)
class Separability:
    """What the diagnosis says of a fit."""

    by_samples: tuple[Size, ...]  # the corrections, in order, fitted to the samples; empty where the crane drives
    rivals: tuple[Rival, ...]
    deciding: tuple[NextMeasurement, ...]  # that rule out the rivals, the most decisive first; separations of each
    showing: tuple[NextMeasurement | None, ...]  # that would show each number that is not determined; None: none would
    simulated: int  # number of measurements among which these were chosen


def separability(path: str, calibrations: Sequence[Calibration], fit: SiteFit, by_marks: bool) -> Separability:
    """Return what the sweeps of the explained groups separate.

    Args:
        path: of the recording.
        calibrations: of the first and the second station, from which the fit began.
        fit: of the site, which explains at least one group.
        by_marks: whether the distances are those of marks, not of the recorded reference.

    Raises:
        ConfigurationError: the sweeps cannot be compared with a model.
    """
    stations = tuple(c.station for c in calibrations)
    data, rows = _as_fitted(read_dataset(path, '/'.join(stations)), calibrations, fit, by_marks)
    comparison = Comparison(data, rows)
    start = [(c := _searched(found.candidate, stations, found.value), c.values) for found in fit.corrections]
    true = copy.copy(comparison)
    true.residual = comparison.template([candidate.build() for candidate, _ in start])
    search = Search(true, without=[name for name, effect in Effect.registry.items() if effect.error_of is None])
    chosen, again, near = _nothing(comparison), _nothing(comparison), []
    if start:
        chosen = _fitted(search, start)
        near = rivals(search, chosen, search.exchanges(chosen))
    if start and comparison.standing.all():  # the model of a crane that drives lacks its speed
        again = _fitted(Fitting(comparison), start)
    unseen = [_beside(chosen, comparison, _searched(u.candidate, stations, u.std)) for u in fit.undetermined]
    measured = ranked(search, chosen, [*near, *unseen]) if near or unseen else ()
    units = {c.kind: c.unit for c in fit.posterior.offered}
    return Separability(
        by_samples=_sizes(again, units),
        rivals=tuple(Rival(_sizes(r, units), math.sqrt(search.apart(r, chosen))) for r in near),
        deciding=_deciding([_of(m, slice(len(near))) for m in measured], len(near)),
        showing=tuple(
            _showing([_of(m, slice(i, i + 1)) for m in measured]) for i in range(len(near), len(near) + len(unseen))
        ),
        simulated=len(measured),
    )


def _as_fitted(
    data: Dataset, calibrations: Sequence[Calibration], fit: SiteFit, by_marks: bool
) -> tuple[Dataset, np.ndarray]:
    """Return a recording with the calibrations and distances of a fit, and rows of the groups that it explains."""
    given = {c.station: c for c in calibrations}
    held = []
    for station, recorded in zip(data.stations, data.calibration, strict=True):
        own = given[station]
        held.append(dataclasses.replace(own, noise_floor=recorded.noise_floor) if math.isnan(own.noise_floor) else own)
    lacking = frozenset(topic for topic in data.lacking if topic.startswith('/site/'))
    data = dataclasses.replace(data, calibration=tuple(held), lacking=lacking)
    groups = [group for group, good in zip(fit.groups, fit.explained, strict=True) if good]
    members = [np.flatnonzero(np.isin(data.stamp, group.stamps)) for group in groups]
    if by_marks:
        reference, limit = np.full(len(data), np.nan), np.zeros(len(data))
        for group, rows in zip(groups, members, strict=True):
            reference[rows], limit[rows] = group.distance, group.shared
        std = np.where(np.isfinite(reference), _STILL, np.nan)
        data = dataclasses.replace(data, reference=reference, reference_std=std, reference_limit=limit)
    rows = np.sort(np.concatenate(members))
    return data, rows[representative(data.group[rows])]


def _searched(candidate: Candidate, stations: Sequence[str], value: float) -> Searched:
    """Return a number that is off by `value` [units] as the effect that is its error."""
    effect = next(effect for effect in Effect.registry.values() if effect.error_of is candidate.kind)
    station = stations[candidate.station] if effect.of is Of.STATION else ''
    return Searched(effect.name, station, effect.recipes[0], {effect.recipes[0].size: value})


def _nothing(comparison: Comparison) -> Fitted:
    """Return the explanation without any effect."""
    return Fitted((), 0.0, np.zeros(len(comparison.residual)), 0.0)


def _fitted(fitting: Fitting, start: list[tuple[Searched, dict[str, float]]]) -> Fitted:
    """Return effects fitted together, the forward models trusted as far as they are exact."""
    found = fitting.fit(start)
    fitting.trust(found)
    return fitting.fit(found.start)


def _beside(fitted: Fitted, comparison: Comparison, other: Searched) -> Fitted:
    """Return an explanation with one more effect, of a size that is not fitted."""
    fixed = dataclasses.replace(other, recipe=dataclasses.replace(other.recipe, prior={}))
    effects = (*fitted.effects, FittedEffect(fixed, fixed.values, {}))
    return dataclasses.replace(fitted, effects=effects, template=comparison.template([e.build() for e in effects]))


def _sizes(fitted: Fitted, units: Mapping[Stated, str]) -> tuple[Size, ...]:
    """Return the numbers of an explanation."""
    found = []
    for effect in fitted.effects:
        kind, name = effect.candidate.kind, effect.candidate.recipe.size
        if kind.error_of is not None:
            unit = units.get(kind.error_of) or declared_parameters(kind)[name][1].unit
            words = title(kind.error_of, effect.candidate.station)
            found.append(Size(words, effect.values[name], effect.stds[name], unit))
    return tuple(found)


def _of(measurement: NextMeasurement, some: slice) -> NextMeasurement:
    """Return what a measurement does to some of the explanations."""
    return dataclasses.replace(measurement, separations=measurement.separations[some])


def _deciding(measured: Sequence[NextMeasurement], count: int) -> tuple[NextMeasurement, ...]:
    """Return measurements that together rule out as many of `count` rivals as can be, most at once first."""
    chosen: list[NextMeasurement] = []
    left = set(range(count))
    while left:
        ruled_out, best = max(
            ((left & m.ruled_out, m) for m in measured), key=lambda found: (len(found[0]), found[1].separation)
        )
        if not ruled_out:
            break
        chosen.append(best)
        left -= ruled_out
    return tuple(chosen)


def _showing(measured: Sequence[NextMeasurement]) -> NextMeasurement | None:
    """Return the measurement that shows an error best, None where none does."""
    best = max(measured, key=lambda m: m.separation)
    return best if best.decides else None
