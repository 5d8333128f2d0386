"""The verdict on a scene: which effects are there, what they leave, and the scenario with them."""

import dataclasses
import math
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from drfmcw_sim.effects import Effect

from ..finding.result import BeforeAfter, Diagnosis, Explanation, Fit, Location, Remainder, Series
from ..finding.wording import sentences
from ..recording.dataset import Dataset
from .background import background
from .bursts import Bursts, bursts
from .evidence import Evidence, of_background, of_bursts, of_image, of_limit, of_ramp, of_side, shown_by
from .forward.misfit import tail
from .forward.model import scattered, scene, straight
from .images import Image, image, measured
from .limits import BURSTS, FORWARD, JUDGE
from .lines import limited_fit
from .material import Material, material
from .rails import Limit, limit
from .ramps.ramp import Ramp, ramp
from .ramps.shared import together
from .refining import write_refined
from .track import track


def shared_ramps(datasets: Sequence[Dataset]) -> list[Ramp | None]:
    """Return the ramps of several recordings of one radar with the shape that they share; None without a strong line.

    For `examine`, whose findings then have delays on one scale.
    """
    return with_one_shape([own_ramp(data) for data in datasets])


def with_one_shape(ramps: Sequence[Ramp | None]) -> list[Ramp | None]:
    """Return ramps of one radar with the shape that they share, those that do not bend as they are."""
    bent = [r for r in ramps if r is not None and r.bends]
    shared = iter(together(bent) if bent else [])
    return [next(shared) if r is not None and r.bends else r for r in ramps]


def examine(
    data: Dataset,
    false_alarm_rate: float,
    out: Path | None = None,
    command: str = '',
    without: Collection[str] = (),
    shared: Ramp | None = None,
) -> Diagnosis | None:
    """Return what the samples of a station that hears itself show, None where comparing features says more.

    That is so for one line on a ramp that is nearly straight. `shared` is this recording's ramp of `shared_ramps`,
    None to learn it from this recording alone; the other arguments are those of `engine.diagnose_dataset`.
    """
    m = material(data)
    single, at_zero = _alone(m)
    accepted = false_alarm_rate / sum(bool(kind.evidence) for kind in Effect.registry.values())
    found: list[Evidence] = []
    limited = None if single or shown_by('limit') in without else limit(m)
    outcome = None
    if limited is not None:
        outcome, said = _limited(m, limited)
        found += [of_limit(limited, m, outcome.gain), Evidence((), (), (said,))]
    bursting = None
    if not single and limited is None and shown_by('bursts') not in without:
        bursting = bursts(m)
    if bursting is not None:
        outcome = _bursting(m, bursting, accepted)
        if outcome is None:
            bursting = None
        else:
            found.append(of_bursts(bursting, m, outcome.gain))
    bent = (shared or ramp(m)) if limited is None and bursting is None else None
    if bent is not None and (bent.bends or any(bent.narrower)):
        found.append(_kept(of_ramp(bent), without))
    imaged = image(_without(bursting, m)) if shown_by('image') not in without else None
    if imaged is not None:
        found.append(of_image(imaged, m))
    if (single or at_zero) and not any(e.effects for e in found):
        return None
    repeated = None if single else background(m)
    if repeated is not None:
        found.append(_kept(of_background(repeated, track(m, repeated.mean), m), without))
    found = [_beyond_chance(e, accepted) for e in found]
    found.append(of_side(m))
    if outcome is None and bent is not None and any(e.effects for e in found):
        outcome = _ramped(bent)
    if outcome is None:
        outcome = _straight(m)
    return _diagnosis(data, m, found, outcome, bent, false_alarm_rate, out, command)


def own_image(data: Dataset) -> Image | None:
    """Return what stands at the images of the strongest lines outside bursts, whether it is an effect or not."""
    m = material(data)
    return measured(_without(bursts(m), m))


def _without(found: Bursts | None, m: Material) -> Material:
    return m if found is None else dataclasses.replace(m, signal=np.where(found.at, 0.0, m.signal))


def own_ramp(data: Dataset) -> Ramp | None:
    """Return the ramp that a recording's own line shows, None where no single line is strong enough."""
    m = material(data)
    return None if limit(m) is not None else ramp(m)


def _beyond_chance(evidence: Evidence, accepted: float) -> Evidence:
    return dataclasses.replace(evidence, effects=tuple(e for e in evidence.effects if e.p_value < accepted))


def _kept(evidence: Evidence, without: Collection[str]) -> Evidence:
    return dataclasses.replace(evidence, effects=tuple(e for e in evidence.effects if e.effect not in without))


def _alone(m: Material) -> tuple[bool, bool]:
    """Return whether one line, and whether 0 Hz, holds nearly all power: features are compared for one line."""
    signal = m.signal[: JUDGE.sweeps]
    count = signal.shape[1]
    if count < JUDGE.fewest_samples:
        return False, False
    power = np.abs(np.fft.fft((signal - signal.mean(axis=1, keepdims=True)) * np.hanning(count), axis=1)) ** 2
    whole = float(power.sum())
    power[:, np.minimum(np.arange(count), count - np.arange(count)) <= JUDGE.skirt] = 0.0
    held = 0.0
    for row in power:
        around = np.arange(-JUDGE.skirt, JUDGE.skirt + 1) + int(np.argmax(row))
        held += float(row[around % count].sum()) * (1.0 if m.iq else 2.0)
    return held > JUDGE.single * whole, float(power.sum()) < (1.0 - JUDGE.single) * whole


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Misfit per degree of freedom without and with what was found, and the chance of what is left."""

    fit: Fit
    chance: float  # of the misfit that is left on what was held out; NaN where it was not tested
    gain: float = 0.0  # of the logarithm of the likelihood of what was held out
    untested: str = ''  # what no test was made of, and why


def _straight(m: Material) -> Outcome:
    """Return what the lines of a straight ramp leave."""
    held = scene(m)
    if held is None:
        nothing = BeforeAfter(math.nan, math.nan)
        said = f"Fewer than {FORWARD.fewest} samples of a sweep, or none but zeros: the scene's lines are not tested."
        return Outcome(Fit(nothing, nothing), math.nan, untested=said)
    found = straight(held)
    inside, outside = (BeforeAfter(x.per_freedom, x.per_freedom) for x in (found.fitted, found.held_out))
    return Outcome(Fit(inside, outside), found.held_out.probability)


def _bursting(m: Material, found: Bursts, accepted: float) -> Outcome | None:
    """Return what lines and bursts leave, None where the bursts are no noise of their own."""
    held = scene(m, found.at)
    if held is None:
        return None
    fitted = straight(held)
    scatter = scattered(fitted)
    if scatter.above < BURSTS.above or math.exp(-min(scatter.gain, 690.0)) > accepted:
        return None
    inside = BeforeAfter(fitted.fitted.per_freedom, fitted.fitted.per_freedom)
    return Outcome(Fit(inside, BeforeAfter(scatter.before, scatter.after)), fitted.held_out.probability, scatter.gain)


def _limited(m: Material, found: Limit) -> tuple[Outcome, str]:
    """Return what lines behind a limit leave, and that in words."""
    fit, count, said = limited_fit(m, found)
    gain = 0.5 * count * math.log(fit.held_out.before / fit.held_out.after)
    return Outcome(fit, tail(fit.held_out.after, count, m.floor.freedom), max(gain, 0.0)), said


def _ramped(found: Ramp) -> Outcome:
    """Return what the ramp that was learnt leaves of its lines."""
    m = found.material
    before, inside, outside = ((x / found.white) ** 2 for x in (found.nominal, found.fitted, found.held_out))
    count = float(sum(line.held.sum() for line in found.lines))
    chance = tail(outside, count, m.floor.freedom)
    return Outcome(Fit(BeforeAfter(before, inside), BeforeAfter(before, outside)), chance)


def _diagnosis(
    data: Dataset,
    m: Material,
    found: list[Evidence],
    outcome: Outcome,
    bent: Ramp | None,
    false_alarm_rate: float,
    out: Path | None,
    command: str,
) -> Diagnosis:
    effects = tuple(e for evidence in found for e in evidence.effects)
    fit = outcome.fit
    after = fit.held_out.after if math.isfinite(fit.held_out.after) else fit.fitted.after
    before = fit.held_out.before if math.isfinite(fit.held_out.before) else fit.fitted.before
    left = not outcome.chance >= false_alarm_rate
    if effects:
        verdict = 'partial' if left else 'explained'
    else:
        verdict = 'unexplained' if left else 'consistent'
    explanation = Explanation(effects, sum(e.log_evidence_gain for e in effects)) if effects else None
    located = tuple(x for evidence in found for x in evidence.locations)
    everywhere = Location('if_samples', m.station, 'ramp_time', 0.0, m.signal.shape[1] / m.rate, 1.0)
    remainder = None
    if left and effects:
        share = float(np.clip((after - 1.0) / (before - 1.0), 0.0, 1.0)) if before > max(after, 1.0) else 1.0
        remainder = Remainder(outcome.chance, share, (everywhere,))
    refined = None
    if out is not None and effects:
        Path(out).mkdir(parents=True, exist_ok=True)
        refined = write_refined(Path(out) / 'refined.yaml', data, effects, bent)
    diagnosis = Diagnosis(
        recording=data.path,
        verdict=verdict,
        significance=min([*(e.p_value for e in effects), outcome.chance]),
        false_alarm_rate=false_alarm_rate,
        locations=located or ((everywhere,) if left else ()),
        explanation=explanation,
        alternatives=(),
        next_measurement=None,
        fit=fit,
        refined_config=refined,
        not_testable=(
            *data.missing,
            *(text for evidence in found for text in evidence.undetermined),
            'A scene of several lines has no nominal model: its lines come from the samples, and only what receiver '
            'and ramp do to them is searched for.',
            *((outcome.untested,) if outcome.untested else ()),
        ),
        sentences=tuple(text for evidence in found for text in evidence.sentences),
        series=_series(bent) if bent is not None and bent.bends else (),
        command=command,
        remainder=remainder,
        scene={name: value for evidence in found for name, value in evidence.figures.items()} or None,
    )
    return dataclasses.replace(diagnosis, sentences=sentences(diagnosis))


def _series(found: Ramp) -> tuple[Series, ...]:
    """Return the residual of the first line beside a straight ramp, and what the shape adds."""
    line, m = found.lines[0], found.material
    straight, bent = found.straight[0].residual, found.shape.scores[0].residual
    return (
        Series(
            'if_samples',
            m.station,
            'ramp_time',
            line.sample / m.rate,
            straight,
            np.full(len(straight), found.white),
            straight - bent,
            'LSB',
            f'IF of {m.station} beside a straight ramp',
        ),
    )
