"""The whole chain of a diagnosis: compare, search, judge, verify on held-out sweeps, and say what was found."""

import dataclasses
import math
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import numpy as np
import scipy.fft

from drfmcw_physics.settings import ConfigurationError, declared_parameters, nearest
from drfmcw_sim.effects import Effect

from .bank import RECIPES
from .comparison import Comparison
from .dataset import Dataset, read_dataset
from .fitting import Fitted, FittedEffect, Fitting
from .known import FEWEST
from .leftovers import leftovers
from .next_measurement import ranked
from .refined import write_scenario
from .result import (
    BeforeAfter,
    Diagnosis,
    Estimate,
    Explanation,
    Fit,
    FoundEffect,
    Location,
    MisfitMap,
    NextMeasurement,
    Separability,
    Series,
)
from .search import Search, rivals, searched
from .wording import sentences

FALSE_ALARM_RATE = 0.01
"""Accepted chance of finding a mismatch in a recording that holds none."""

_FITTED_SHARE = 2.0 / 3.0  # of the sweeps of each group, the first ones
_SIZE_TRUST = 0.002  # of an effect's size, to which the forward models tell it
_DECIBEL_TRUST = 0.02  # the same of one in decibels
_TOLD = 3.0  # times its noise, to which a number must be predicted for a misfit
_CENTRAL = 0.9  # of an excess, which a location's span holds
_SHOWN = 0.01  # share of the excess below which a location is not named

_LEVELS = {
    'ramp': ('if_samples', 'ramp_time'),
    'flutter': ('noise', 'if_frequency'),
    'lines': ('if_spectrum', 'if_frequency'),
    'mean': ('if_spectrum', 'if_frequency'),
    'harmonic': ('if_spectrum', 'range'),
    'burst': ('noise', 'range'),
    'coherence': ('noise', 'range'),
    'noise': ('noise', 'if_frequency'),
    'beat': ('beat_frequency', 'range'),
    'amplitude': ('amplitude', 'range'),
    'range': ('range', 'range'),
    'velocity': ('range', 'velocity'),
    'movement': ('range', 'time'),
}
"""Level and axis of the interface by kind of number."""


def diagnose(
    path: Path | str,
    pair: str | None = None,
    false_alarm_rate: float = FALSE_ALARM_RATE,
    out: Path | None = None,
    progress: Callable[[str, float], None] | None = None,
    command: str = '',
    without: Collection[str] = (),
    jobs: int = 1,
) -> Diagnosis:
    """Return what a recording holds beyond its nominal model.

    Args:
        path: of the recording.
        pair: 'first/second'; None takes the one with most sweeps.
        false_alarm_rate: accepted chance of finding a mismatch where there is none.
        out: directory for the refined simulator configuration; None writes none.
        progress: called with what is being done and its share done.
        command: that was given, for the report.
        without: effects that are not searched for.
        jobs: processes that work at once, forked from this one.

    Raises:
        BagError: the recording cannot be read.
        ConfigurationError: it lacks what is needed, or no such effect is there to be left out.
    """
    if progress is not None:
        progress('reading', 0.0)
    return diagnose_dataset(read_dataset(path, pair), false_alarm_rate, out, progress, command, without, jobs)


def diagnose_dataset(
    data: Dataset,
    false_alarm_rate: float = FALSE_ALARM_RATE,
    out: Path | None = None,
    progress: Callable[[str, float], None] | None = None,
    command: str = '',
    without: Collection[str] = (),
    jobs: int = 1,
) -> Diagnosis:
    """Return what sweeps hold beyond their nominal model; arguments and errors as `diagnose`."""
    for effect in without:
        if effect not in Effect.registry:
            raise ConfigurationError(f"no effect '{effect}'{nearest(effect, sorted(Effect.registry))}")
    report = progress or (lambda text, share: None)
    comparison = Comparison(data)
    search = Search(comparison, progress, without, jobs)
    result = searched(search, false_alarm_rate)
    found, significance = result.explanation, result.significance
    left = leftovers(search, found)
    unexplained = [x for x in left if x.probability < false_alarm_rate]
    alternatives: list[Fitted] = []
    if unexplained:
        verdict, chosen = 'unexplained', None
        significance = min(significance, unexplained[0].probability)
    elif found is None:
        verdict, chosen = 'consistent', None
    else:
        alternatives = rivals(found, result.exchanged)
        verdict, chosen = ('ambiguous' if alternatives else 'explained'), found
    deciding: tuple[NextMeasurement, ...] = ()
    if alternatives:
        report('measurements that would decide', 0.93)
        deciding = ranked(search, found, alternatives)
    report('held-out sweeps', 0.95)
    explanation = _explanation(search, chosen) if chosen else None
    refined = None
    if chosen and out is not None:
        Path(out).mkdir(parents=True, exist_ok=True)
        refined = str(Path(out) / 'refined.yaml')
        write_scenario(refined, data, [_entry(e) for e in chosen.effects])
    fitted_rows, held_rows = _split(data)
    diagnosis = Diagnosis(
        recording=data.path,
        verdict=verdict,
        significance=significance,
        false_alarm_rate=false_alarm_rate,
        locations=_locations(comparison),
        explanation=explanation,
        alternatives=tuple(_explanation(search, r) for r in alternatives),
        next_measurement=deciding[0].sentence if deciding and deciding[0].decides else None,
        measurements=deciding,
        fit=_fit(comparison, chosen, data, fitted_rows, held_rows),
        refined_config=refined,
        not_testable=_not_testable(data, search, without),
        sentences=(),
        series=_series(comparison, chosen),
        misfit_map=_misfit_map(comparison, chosen),
        separability=_separability(result.rounds),
        sweeps_fitted=len(fitted_rows),
        sweeps_held_out=len(held_rows),
        command=command,
        places=search.places,
    )
    return dataclasses.replace(diagnosis, sentences=sentences(diagnosis))


def check(data: Dataset) -> tuple[float, float]:
    """Return the chance of what the nominal model leaves over, and its misfit per degree of freedom; no search.

    It takes a hundredth of the time of `diagnose_dataset`, whose "consistent" implies a chance above its false-alarm
    rate. Only a search sees mismatches that stand out of the noise by their shape alone.

    Raises:
        ConfigurationError: the data lack what is needed.
    """
    comparison = Comparison(data)
    return leftovers(Fitting(comparison), None)[0].probability, _per_freedom(comparison, None)


def _split(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return the sweeps to fit and those to judge by: the first of each group, and the rest."""
    fitted, held = [], []
    for g in np.unique(data.group):
        rows = np.flatnonzero(data.group == g)
        at = max(FEWEST, round(_FITTED_SHARE * len(rows)))
        fitted.append(rows[:at])
        if len(rows) - at >= FEWEST:
            held.append(rows[at:])
    return np.concatenate(fitted), np.concatenate(held) if held else np.array([], int)


def _per_freedom(comparison: Comparison, chosen: Fitted | None) -> float:
    """Return the squared whitened residual per number beside an explanation, where it tells what to expect.

    What the forward models may be off by counts as noise, see `Fitting.doubt`; numbers of which they tell next to
    nothing are left out.
    """
    used = comparison.residual != 0.0
    if chosen is None:
        return float(np.mean(comparison.residual[used] ** 2))
    effects = [e.build() for e in chosen.effects]
    beside = dataclasses.replace(chosen, template=comparison.template(effects))
    doubt = Fitting(comparison).doubt(beside)
    told = used & (doubt < _TOLD)
    return float(np.mean((comparison.residual - beside.template)[told] ** 2 / (1.0 + doubt[told] ** 2)))


def _fit(
    comparison: Comparison, chosen: Fitted | None, data: Dataset, fitted_rows: np.ndarray, held_rows: np.ndarray
) -> Fit:
    """Return misfits before and after, on the sweeps fitted and on those held out, and the range errors."""
    part = Comparison(data, fitted_rows)
    again = Fitting(part).fit([(e.candidate, e.values) for e in chosen.effects], 4) if chosen else None
    inside = BeforeAfter(_per_freedom(part, None), _per_freedom(part, again))
    outside = BeforeAfter(math.nan, math.nan)
    if len(held_rows):
        rest = Comparison(data, held_rows)
        outside = BeforeAfter(_per_freedom(rest, None), _per_freedom(rest, again))
    if not np.isfinite(data.reference).any():
        return Fit(inside, outside)
    errors = [s.range - data.distance[m] for s, m in zip(comparison.sweeps, comparison.members, strict=True)]
    added = np.zeros(len(errors))
    if chosen:
        added = comparison.predict(tuple(e.build() for e in chosen.effects)).range - comparison.plain.range
    before = np.concatenate(errors)
    after = np.concatenate([e - a for e, a in zip(errors, added, strict=True)])
    return Fit(
        inside,
        outside,
        BeforeAfter(float(before.mean()), float(after.mean())),
        BeforeAfter(float(before.std()), float(after.std())),
    )


def _explanation(search: Search, fitted: Fitted) -> Explanation:
    """Return a fitted explanation in the words of the interface."""
    return Explanation(tuple(_found(search, fitted, e) for e in fitted.effects), fitted.evidence)


def _entry(effect: FittedEffect) -> tuple[str, str | None, dict]:
    """Return an effect for the simulator's configuration, with the values that fit best."""
    parameters = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in effect.candidate.parameters(effect.values).items()
    }
    return effect.candidate.effect, effect.candidate.station or None, parameters


def _found(search: Search, fitted: Fitted, effect: FittedEffect) -> FoundEffect:
    comparison = search.comparison
    others = [e.build() for e in fitted.effects if e is not effect]
    without = comparison.template(others) if others else 0.0
    gain = search.misfit(without) - fitted.misfit
    alone = comparison.predict((effect.build(),)).range - comparison.plain.range
    declared = declared_parameters(Effect.registry[effect.candidate.effect])
    parameters = {}
    for name in effect.candidate.free:
        value, std = effect.told.get(name, (effect.values[name], effect.stds[name]))
        unit = declared[name.partition('[')[0]][1].unit
        base, recipe = name.partition('[')[0], effect.candidate.recipe
        decibel = unit.startswith('dB')
        trust = recipe.trust.get(base, 0.0)
        if base == recipe.size or not recipe.size:
            trust = max(trust, _DECIBEL_TRUST if decibel else _SIZE_TRUST)
        trust *= 1.0 if decibel else abs(value)
        parameters[name] = Estimate(value, math.hypot(std, trust), unit)
    return FoundEffect(
        effect=effect.candidate.effect,
        station=effect.candidate.station or None,
        parameters=parameters,
        log_evidence_gain=gain / 2.0,
        p_value=search.probability(gain, len(effect.candidate.free), effect.key),
        range_shift=float(alone[np.argmax(np.abs(alone))]),
    )


def _not_testable(data: Dataset, search: Search, without: Collection[str]) -> tuple[str, ...]:
    sentences_ = [*data.missing, *search.comparison.known.untold()]
    unsearched = sorted({*set(Effect.registry) - set(RECIPES), *without})
    if unsearched:
        sentences_.append(f'Not searched for: {", ".join(unsearched)}.')
    if search.untested:
        sentences_.append(f'Without any influence on this recording: {", ".join(search.untested)}.')
    return tuple(sentences_)


# --- where ---


def _name(comparison: Comparison, kind: str, station: int) -> str | None:
    """Return the station's name, None where the numbers are the path's."""
    if kind in ('ramp', 'flutter'):
        station = comparison.channels[station].receiver
    return None if station < 0 else comparison.receivers[station]


def _axis(comparison: Comparison, kind: str, station: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (x, squared whitened residuals) of one kind of number at one station, along its axis."""
    c = comparison
    chosen = c.entries.where(kind=kind, station=station)
    z = c.residual[chosen]
    groups = len(c.members)
    distance = np.array([c.data.distance[m].mean() for m in c.members])
    rate = c.data.sweeps[0][0].sample_rate
    if kind == 'ramp':
        over_time = scipy.fft.idct(z.reshape(groups, -1), norm='ortho', axis=1)
        return c.time, np.mean(over_time**2, axis=0) * groups
    if kind == 'lines':
        bins = z.reshape(groups, -1)
        return np.arange(bins.shape[1]) * (rate / 2 / (bins.shape[1] - 1)), np.sum(bins**2, axis=0)
    if kind == 'flutter':
        terms = z.reshape(groups, -1)
        return _modulation(c, terms.shape[1]), np.sum(terms**2, axis=0)
    if kind == 'mean':
        return np.zeros(1), np.array([float(z @ z)])
    if kind == 'noise':
        bands = z.reshape(groups, -1)
        return (np.arange(bands.shape[1]) + 0.5) * (rate / 2 / bands.shape[1]), np.sum(bands**2, axis=0)
    if kind == 'movement':
        return c.data.time[c.entries.position[chosen]], z**2
    if kind == 'velocity':
        return c.slope, z**2
    return distance, z**2


def _modulation(comparison: Comparison, terms: int) -> np.ndarray:
    """Return the frequencies of the terms of a cosine series over the sweep (terms,) [Hz]."""
    step = float(comparison.time[1] - comparison.time[0])
    return np.arange(terms) / (2.0 * terms * step)


def _locations(comparison: Comparison) -> tuple[Location, ...]:
    """Return where the excess over the nominal model sits, largest share first."""
    c = comparison
    excess = {}
    for kind, station in c.entries.kinds():
        z = c.residual[c.entries.where(kind=kind, station=station)]
        used = np.count_nonzero(z)
        if used:
            excess[kind, station] = max(float(z @ z) - used - 4.0 * math.sqrt(2.0 * used), 0.0)
    total = sum(excess.values())
    found = []
    for (kind, station), amount in sorted(excess.items(), key=lambda item: -item[1]):
        if total <= 0.0 or amount < _SHOWN * total:
            continue
        level, axis = _LEVELS[kind]
        x, squares = _axis(comparison, kind, station)
        order = np.argsort(x)
        weight = np.cumsum(np.maximum(squares[order] - np.median(squares), 0.0))
        low, high = x[order][0], x[order][-1]
        if weight[-1] > 0.0:
            low, high = (
                x[order][np.searchsorted(weight, q * weight[-1]).clip(0, len(x) - 1)]
                for q in ((1 - _CENTRAL) / 2, (1 + _CENTRAL) / 2)
            )
        found.append(Location(level, _name(c, kind, station), axis, float(low), float(high), amount / total))
    return tuple(found)


# --- pictures ---

_WORDS = {
    'lines': 'narrow lines in the IF spectrum',
    'mean': 'mean of the samples',
    'harmonic': 'harmonics of the line',
    'burst': 'bursts of noise',
    'coherence': 'noise that both lines share',
    'noise': 'noise',
    'beat': 'common part of both beat frequencies',
    'amplitude': 'received power',
    'range': 'range beyond the reference',
    'velocity': 'slope of the reference',
    'movement': 'movement by the carrier phase',
}


def _row_name(comparison: Comparison, kind: str, station: int) -> str:
    name = _name(comparison, kind, station)
    if kind in ('ramp', 'flutter'):
        changing = ', from sweep to sweep' if kind == 'flutter' else ''
        return f'{comparison.channels[station].words}{changing}{f", {name}" if name else ""}'
    words = _WORDS[kind]
    return words + (f', {name}' if name else '')


def _rows(comparison: Comparison) -> list[tuple[str, int]]:
    """Return kinds and stations that hold numbers."""
    c = comparison
    return [(k, s) for k, s in c.entries.kinds() if np.any(c.residual[c.entries.where(kind=k, station=s)] != 0.0)]


def _misfit_map(comparison: Comparison, chosen: Fitted | None) -> MisfitMap:
    """Return mean squared whitened residuals by kind and group."""
    c = comparison
    rest = c.residual - (chosen.template if chosen else 0.0)
    rows = _rows(c)
    before = np.full((len(rows), len(c.members)), np.nan)
    after = before.copy()
    for i, (kind, station) in enumerate(rows):
        for g in range(len(c.members)):
            inside = c.entries.where(kind=kind, station=station, group=g) & (c.residual != 0.0)
            if inside.any():
                before[i, g] = np.mean(c.residual[inside] ** 2)
                after[i, g] = np.mean(rest[inside] ** 2)
    columns = tuple(f'{c.data.distance[m].mean():.0f} m' for m in c.members)
    return MisfitMap(tuple(_row_name(c, *row) for row in rows), columns, before, after)


def _series(comparison: Comparison, chosen: Fitted | None) -> tuple[Series, ...]:
    """Return residuals along their axes, of the group with the largest misfit where there is one for each."""
    c = comparison
    effects = tuple(e.build() for e in chosen.effects) if chosen else ()
    added = c.predict(effects) if effects else c.plain
    distance = np.array([c.data.distance[m].mean() for m in c.members])
    rate = c.data.sweeps[0][0].sample_rate
    found = []
    for kind, station in _rows(c):
        level, axis = _LEVELS[kind]
        name = _name(c, kind, station)
        words = _row_name(c, kind, station)
        chosen_rows = c.entries.where(kind=kind, station=station)
        squares = np.bincount(c.entries.group[chosen_rows], c.residual[chosen_rows] ** 2)
        worst = int(squares.argmax())
        at = f' at {distance[worst]:.0f} m'
        if kind == 'ramp':
            scale, unit = (1.0, 'rad') if c.channels[station].of_phase else (20.0 / math.log(10.0), 'dB')
            residual, curve = (
                scipy.fft.idct(np.where(np.isfinite(c.std.ramp[worst, station]), v, 0.0), norm='ortho') * scale
                for v in (
                    c.measured.ramp[worst, station] - c.plain.ramp[worst, station],
                    added.ramp[worst, station] - c.plain.ramp[worst, station],
                )
            )
            finite = c.std.ramp[worst, station][np.isfinite(c.std.ramp[worst, station])]
            std = np.full(len(residual), math.sqrt(np.mean(finite**2)) * scale)
            found.append(Series(level, name, axis, c.time, residual, std, curve, unit, words + at))
        elif kind in ('lines', 'flutter'):
            inside = c.entries.where(kind=kind, station=station, group=worst)
            count = np.count_nonzero(inside)
            x = np.arange(count) * (rate / 2 / (count - 1)) if kind == 'lines' else _modulation(c, count)
            curve = (chosen.template if chosen else np.zeros(len(c.residual)))[inside]
            found.append(Series(level, name, axis, x, c.residual[inside], np.ones(len(x)), curve, 'σ', words + at))
        elif kind == 'noise':
            bands = c.measured.noise.shape[-1]
            x = (np.arange(bands) + 0.5) * (rate / 2 / bands)
            known = np.isfinite(c.measured.noise[worst, station]) & np.isfinite(c.plain.noise[worst, station])
            values = [
                (v[worst, station])[known]
                for v in (c.measured.noise - c.plain.noise, c.std.noise, added.noise - c.plain.noise)
            ]
            found.append(Series(level, name, axis, x[known], values[0], values[1], values[2], 'dB', words + at))
        elif kind in ('beat', 'range', 'velocity'):
            measured, plain, std, with_effects = (getattr(v, kind) for v in (c.measured, c.plain, c.std, added))
            unit = {'beat': 'Hz', 'range': 'm', 'velocity': 'm/s'}[kind]
            x = c.slope if kind == 'velocity' else distance
            found.append(Series(level, name, axis, x, measured - plain, std, with_effects - plain, unit, words))
        elif kind == 'amplitude':
            values = [v[:, station] for v in (c.measured.amplitude - c.plain.amplitude, c.std.amplitude)]
            curve = (added.amplitude - c.plain.amplitude)[:, station]
            found.append(Series(level, name, axis, distance, *values, curve, 'dB', words))
    return tuple(found)


def _separability(rounds: Sequence[Sequence[Fitted]]) -> Separability | None:
    """Return how far the best explanations with one effect lie from each other."""
    ranked = rounds[0][:6] if rounds else []
    if len(ranked) < 2:
        return None
    names = []
    for fitted in ranked:
        effect = fitted.effects[0]
        names.append(effect.candidate.effect + (f' ({effect.candidate.station})' if effect.candidate.station else ''))
    templates = np.array([f.template for f in ranked])
    distance = np.sqrt(np.sum((templates[:, None] - templates[None]) ** 2, axis=-1))
    return Separability(tuple(names), distance)
