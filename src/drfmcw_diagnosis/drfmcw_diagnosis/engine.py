"""The whole chain of a diagnosis: compare, search, judge, verify on held-out sweeps, and say what was found."""

import dataclasses
import math
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np

from drfmcw_physics.settings import ConfigurationError, declared_parameters, nearest
from drfmcw_sim.effects import Effect

from .compare.algebra import scaled_inverse
from .compare.comparison import Comparison
from .compare.limits import SCATTER
from .finding.measured import MODEL, measured_remainder, write_model
from .finding.refined import write_scenario
from .finding.result import (
    BeforeAfter,
    Diagnosis,
    Estimate,
    Explanation,
    Fit,
    FoundEffect,
    MeasuredRemainder,
    NextMeasurement,
    Remainder,
)
from .finding.views import learnt_series, locations, misfit_map, remainder, separability, series
from .finding.wording import sentences
from .judging.verdict import Judgement, judged
from .learn.learning import Learnt
from .next.ranking import ranked
from .recording.dataset import Dataset, read_dataset
from .recording.thinning import representative, shortened
from .scene.judge import examine
from .scene.ramps.ramp import Ramp
from .search.fits.fitted import Fitted, FittedEffect
from .search.fits.fitting import Fitting
from .search.leftovers import leftovers
from .search.search import Search
from .search.selection import searched
from .search.starts.bank import recipes


@dataclasses.dataclass(frozen=True)
class EngineLimits:
    """How a finding is verified, and how far sizes are trusted."""

    false_alarm_rate: float = 0.01
    """Accepted chance of finding a mismatch in a recording that holds none [1]; chosen."""

    fitted_share: float = 2.0 / 3.0
    """Share of the sweeps of each group that is fitted, the first ones [1]; chosen."""

    size: float = 0.002
    """Of an effect's size, to which its forward model determines it [1]; chosen."""

    decibel: float = 0.02
    """The same of a size in decibels [dB]; chosen."""


LIMITS = EngineLimits()


def diagnose(
    path: Path | str,
    pair: str | None = None,
    false_alarm_rate: float = LIMITS.false_alarm_rate,
    out: Path | None = None,
    progress: Callable[[str, float], None] | None = None,
    command: str = '',
    without: Collection[str] = (),
    jobs: int = 1,
    covariances: bool = False,
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
        covariances: compute how the parameters of each effect correlate, to combine recordings.

    Raises:
        BagError: the recording cannot be read.
        ConfigurationError: it lacks what is needed, or no such effect is there to be left out.
    """
    if progress is not None:
        progress('reading', 0.0)
    data = read_dataset(path, pair)
    return diagnose_dataset(data, false_alarm_rate, out, progress, command, without, jobs, covariances)


def diagnose_dataset(
    data: Dataset,
    false_alarm_rate: float = LIMITS.false_alarm_rate,
    out: Path | None = None,
    progress: Callable[[str, float], None] | None = None,
    command: str = '',
    without: Collection[str] = (),
    jobs: int = 1,
    covariances: bool = False,
    shared: Ramp | None = None,
) -> Diagnosis:
    """Return what sweeps hold beyond their nominal model; arguments and errors as `diagnose`.

    `shared` is the ramp of this recording as `scene.judge.shared_ramps` learns it from several of one radar.
    """
    for effect in without:
        if effect not in Effect.registry:
            raise ConfigurationError(f"no effect '{effect}'{nearest(effect, sorted(Effect.registry))}")
    report = progress or (lambda text, share: None)
    if data.topology.hears_itself:
        report('the samples themselves', 0.05)
        scene = examine(data, false_alarm_rate, out, command, without, shared)
        if scene is not None:
            return scene
        data = shortened(data)
    rows = representative(data.group)
    comparison = Comparison(data, rows)
    search = Search(comparison, progress, without, jobs)
    result = searched(search, false_alarm_rate)
    judgement = judged(search, result, false_alarm_rate)
    verdict, chosen, alternatives = judgement.verdict, judgement.explanation, judgement.alternatives
    deciding: tuple[NextMeasurement, ...] = ()
    if chosen is not None and alternatives:
        report('measurements that would decide', 0.93)
        deciding = ranked(search, chosen, alternatives)
    report('held-out sweeps', 0.95)
    explanation = _explanation(search, chosen) if chosen else None
    if explanation and chosen and covariances:
        explanation = _correlated(search, explanation, chosen)
    verification = _verification(data, rows, chosen, jobs)
    held_out = verification.held_out
    measured, found = measured_remainder(comparison, chosen, judgement.remainder, verification.fitted, held_out)
    refined, model = _written(out, data, chosen, found)
    diagnosis = Diagnosis(
        recording=data.path,
        verdict=verdict,
        significance=judgement.significance,
        false_alarm_rate=false_alarm_rate,
        locations=locations(comparison),
        remainder=_remainder(comparison, judgement, measured, model),
        learnt=learnt_series(comparison, chosen, found),
        explanation=explanation,
        alternatives=tuple(_explanation(search, r) for r in alternatives),
        next_measurement=deciding[0].sentence if deciding and deciding[0].decides else None,
        measurements=deciding,
        fit=_fit(comparison, chosen, data, verification),
        refined_config=refined,
        not_testable=_not_testable(data, search, without, thinned=len(rows) < len(data)),
        sentences=(),
        series=series(comparison, chosen),
        misfit_map=misfit_map(comparison, chosen),
        separability=separability(result.rounds),
        sweeps_fitted=verification.sweeps[0],
        sweeps_held_out=verification.sweeps[1],
        command=command,
        stations=data.stations,
        places=search.places,
    )
    return dataclasses.replace(diagnosis, sentences=sentences(diagnosis))


def _written(
    out: Path | None, data: Dataset, chosen: Fitted | None, found: Learnt | None
) -> tuple[str | None, str | None]:
    """Write refined configuration and measured remainder; return their paths, None of what there is not."""
    if out is None or not (chosen or found):
        return None, None
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    model = write_model(folder, found) if found is not None else None
    refined = str(folder / 'refined.yaml')
    effects = [_entry(e) for e in chosen.effects] if chosen else []
    write_scenario(refined, data, effects, MODEL if model is not None else None)
    return refined, model


def _remainder(
    comparison: Comparison, judgement: Judgement, measured: MeasuredRemainder | None, model: str | None
) -> Remainder | None:
    """Return what the effects that are named leave beyond chance, None where nothing is left."""
    if not judgement.remainder:
        return None
    rest = remainder(comparison, judgement.explanation)
    used = np.isfinite(rest)
    after = float(np.sum(rest[used] ** 2)) - np.count_nonzero(used)
    before = float(np.sum(comparison.residual[used] ** 2)) - np.count_nonzero(used)
    share = float(np.clip(after / max(before, 1.0), 0.0, 1.0))
    probability = judgement.remainder[0].probability
    return Remainder(probability, share, locations(comparison, rest), measured, model)


def compared(data: Dataset) -> Comparison:
    """Return the comparison of a recording with its nominal model, of as many sweeps as a diagnosis looks at.

    Raises:
        ConfigurationError: the data lack what is needed.
    """
    data = shortened(data)
    return Comparison(data, representative(data.group))


def check(comparison: Comparison) -> tuple[float, float]:
    """Return the chance of what the nominal model leaves over, and its misfit per degree of freedom; no search.

    It takes a hundredth of the time of `diagnose_dataset`, whose "consistent" implies a chance above its false-alarm
    rate. Only a search sees mismatches that stand out of the noise by their shape alone.
    """
    return float(leftovers(Fitting(comparison), None)[0].probability), _per_freedom(comparison, None)


def _split(data: Dataset, compared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sweeps to fit and those to judge by: the first of each group that are compared, and the rest."""
    fitted, held = [], []
    for g in np.unique(data.group[compared]):
        rows = compared[data.group[compared] == g]
        at = max(SCATTER.fewest, round(LIMITS.fitted_share * len(rows)))
        fitted.append(rows[:at])
        if len(rows) - at >= SCATTER.fewest:
            held.append(rows[at:])
    return np.concatenate(fitted), np.concatenate(held) if held else np.array([], int)


def _per_freedom(comparison: Comparison, chosen: Fitted | None) -> float:
    """Return the squared whitened residual per number beside an explanation, where it predicts the number."""
    rest = remainder(comparison, chosen)
    return float(np.nanmean(rest**2))


@dataclasses.dataclass(frozen=True)
class _Verification:
    """The sweeps that are fitted and those that are held out."""

    fitted: tuple[Comparison, Fitted | None]  # with the explanation fitted to them
    held_out: Comparison | None
    sweeps: tuple[int, int]


def _verification(data: Dataset, compared: np.ndarray, chosen: Fitted | None, jobs: int) -> _Verification:
    fitted_rows, held_rows = _split(data, compared)
    part = Comparison(data, fitted_rows)
    again = Fitting(part, jobs).fit(chosen.start, 4) if chosen else None
    rest = Comparison(data, held_rows) if len(held_rows) else None
    return _Verification((part, again), rest, (len(fitted_rows), len(held_rows)))


def _fit(comparison: Comparison, chosen: Fitted | None, data: Dataset, verification: _Verification) -> Fit:
    """Return misfits before and after, on the sweeps fitted and on those held out, and the range errors."""
    part, again = verification.fitted
    inside = BeforeAfter(_per_freedom(part, None), _per_freedom(part, again))
    outside = BeforeAfter(math.nan, math.nan)
    rest = verification.held_out
    if rest is not None:
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


def _correlated(search: Search, explanation: Explanation, fitted: Fitted) -> Explanation:
    """Return an explanation with the correlations of each effect's parameters, the others' free."""
    slopes = search.whitening(search.slopes(fitted))
    covariance = scaled_inverse(slopes @ slopes.T)
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance / np.outer(std, std)
    effects = (
        dataclasses.replace(found, correlation=tuple(map(tuple, correlation[own, own].tolist())))
        for found, own in zip(explanation.effects, fitted.spans, strict=True)
    )
    return dataclasses.replace(explanation, effects=tuple(effects))


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
    declared = declared_parameters(effect.candidate.kind)
    parameters = {}
    for name in effect.candidate.free:
        value, std = effect.widened.get(name, (effect.values[name], effect.stds[name]))
        if name == effect.candidate.recipe.carrier[0]:
            value, std = effect.candidate.reflected(effect.values), _phase_std(effect)
        unit = declared[name.partition('[')[0]][1].unit
        base, recipe = name.partition('[')[0], effect.candidate.recipe
        decibel = unit.startswith('dB')
        trust = recipe.trust.get(base, 0.0)
        if base == recipe.size or not recipe.size:
            trust = max(trust, LIMITS.decibel if decibel else LIMITS.size)
        nothing = recipe.start[base] if recipe.coefficients else 0.0  # the value without effect
        trust *= 1.0 if decibel else abs(value - nothing)
        if base == recipe.each_sweep:  # of which the sweeps hold one outcome
            trust = math.hypot(trust, math.sqrt(value * (1.0 - value) / len(comparison.data)))
        parameters[name] = Estimate(value, math.hypot(std, trust), unit)
    return FoundEffect(
        effect=effect.candidate.effect,
        station=effect.candidate.station or None,
        parameters=parameters,
        log_evidence_gain=gain / 2.0,
        p_value=search.probability(gain, len(effect.candidate.free), effect.key),
        range_shift=float(alone[np.argmax(np.abs(alone))]),
    )


def _phase_std(effect: FittedEffect) -> float:
    """Return the standard deviation of a reflector's phase [rad], at most that of any phase."""
    phase, length = effect.candidate.recipe.carrier
    turns = 2.0 * math.pi * effect.stds[length] / effect.candidate.recipe.wavelength
    return min(math.hypot(effect.stds[phase], turns), math.pi / math.sqrt(3.0))


def _not_testable(data: Dataset, search: Search, without: Collection[str], thinned: bool) -> tuple[str, ...]:
    sentences_ = [*data.missing, *search.comparison.known.undetermined()]
    if thinned:
        compared = sum(map(len, search.comparison.members))
        sentences_.append(f'Compared: {compared} of {len(data)} sweeps, spread evenly over the recording.')
    unsearched = sorted({*Effect.registry} - {effect for effect, _ in recipes(without)})
    if unsearched:
        sentences_.append(f'Not searched for: {", ".join(unsearched)}.')
    if search.untested:
        sentences_.append(f'These effects would leave no trace in this recording: {", ".join(search.untested)}.')
    return tuple(sentences_)
