"""The verdict on a scene: which effects are there, what they leave, and the scenario with them."""

import dataclasses
import math
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from drfmcw_sim.effects import ActsOn, Effect
from drfmcw_sim.synthesis.measured import write_measured

from ..finding.measured import MODEL
from ..finding.result import Diagnosis, Explanation, Fit, Location, Remainder, Series
from ..finding.wording import sentences
from ..recording.dataset import Dataset
from .background import Background, background
from .bursts import Bursts, bursts
from .evidence import (
    Evidence,
    alternatives,
    of_background,
    of_bursts,
    of_image,
    of_limit,
    of_lines,
    of_moving,
    of_multiples,
    of_named,
    of_ramp,
    of_side,
    shown_by,
)
from .forward import outcome
from .forward.limits import FORWARD, NAMING
from .forward.model import Straight, moving, multiples, scene, straight
from .forward.naming import Named, named, searched
from .images import Image, image
from .images import measured as measured_image
from .limits import JUDGE
from .material import Material, material
from .rails import limit
from .ramps.ramp import Ramp, ramp
from .ramps.shared import together
from .refining import described_remainder, measured, write_refined
from .track import track


def shared_ramps(datasets: Sequence[Dataset]) -> list[Ramp | None]:
    """Return the ramps of several recordings of one radar with the shape that they share; None without a strong line.

    For `examine`, whose findings then have delays on one scale.
    """
    ramps = [own_ramp(data) for data in datasets]
    bent = [r for r in ramps if r is not None and r.bends]
    shared = iter(together(bent))
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
    accepted = false_alarm_rate / (
        sum(bool(kind.evidence) for kind in Effect.registry.values()) + len(searched(without))
    )
    found: list[Evidence] = []
    result: outcome.Outcome | None = None
    limited = None if single or shown_by('limit') in without else limit(m)
    if limited is not None:
        result, said = outcome.of_limit(m, limited)
        found += [of_limit(limited, m, result.gain), Evidence((), (), (said,))]
    bursting = None
    if not single and limited is None and shown_by('bursts') not in without:
        bursting = bursts(m)
    if bursting is not None:
        result = outcome.of_bursts(m, bursting, accepted)
        if result is None:
            bursting = None
        else:
            found.append(of_bursts(bursting, m, result.gain))
    bent = (shared or ramp(m)) if limited is None and bursting is None else None
    imaged = image(_without(bursting, m)) if shown_by('image') not in without else None
    if imaged is not None:
        found.append(of_image(imaged, m))
    lines = scene(m) if result is None else None
    alone = static = straight(lines) if lines is not None else None
    effects = None
    if static is not None and not (bent is not None and any(bent.narrower)):
        failing = static.held_out.probability < false_alarm_rate
        if single:  # lines beside the one may be what an effect does to it
            bends = bent is not None and bent.bends
            asked = bends or static.held_out.per_freedom > JUDGE.strong or (not failing and len(static.tracks) > 1)
        else:
            asked = failing or len(static.tracks) > NAMING.lines
        if asked and (imaged is None or not single):
            alone, effects = _named(static, failing and not single, accepted, without)
            if effects is not None and single and effects.outside.probability < false_alarm_rate:
                effects = None
    if effects is not None and alone is not None:
        bent = None
        result = outcome.of_lines(alone, effects)
        found.append(of_named(effects, alone, m))
    elif bent is not None and (bent.bends or any(bent.narrower)):
        found.append(_kept(of_ramp(bent), without))
        result = outcome.of_ramp(bent)
    harmonics = alone is not None and effects is None and multiples(alone)
    if harmonics:
        found.append(of_multiples())
    elif (single or at_zero) and not any(e.effects for e in found):
        return None
    found += _of_scene(None if single or bent is not None else static, alone, effects)
    repeated = None if single else background(m)
    if repeated is not None:
        found.append(_kept(of_background(repeated, track(m), m), without))
    found = [_beyond_chance(e, accepted) for e in found]
    found.append(of_side(m))
    result = result or outcome.of_lines(alone)
    return _diagnosis(data, m, found, result, bent, repeated, effects, false_alarm_rate, out, command)


def _named(static: Straight, crowded: bool, accepted: float, without: Collection[str]) -> tuple[Straight, Named | None]:
    """Return the lines that describe the sweeps best, and effects on them.

    Where the lines of a `crowded` scene leave more than noise, those that move are looked at first, beside all that
    repeats with the ramp.
    """
    rest = moving(static.scene) if crowded else None
    alone = straight(rest) if rest is not None else static
    if rest is not None and len(alone.tracks) and alone.held_out.per_freedom < static.held_out.per_freedom:
        effects = named(alone, accepted, without)
        if effects is not None or len(static.tracks) == FORWARD.most:
            return alone, effects
    else:
        alone = static
    effects = named(static, accepted, without)
    return (static if effects is not None else alone), effects


def _of_scene(static: Straight | None, alone: Straight | None, effects: Named | None) -> list[Evidence]:
    """Return what the lines of a scene say, nothing where there is none."""
    if static is None or alone is None:
        return []
    if alone.scene.moving:
        return [of_lines(static.scene, static.tracks), of_moving(static, alone)]
    return [of_lines(static.scene, static.tracks if effects is None else effects.fitted.tracks)]


def own_image(data: Dataset) -> Image | None:
    """Return what stands at the images of the strongest lines outside bursts, whether it is an effect or not."""
    m = material(data)
    return measured_image(_without(bursts(m), m))


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


def _diagnosis(
    data: Dataset,
    m: Material,
    found: list[Evidence],
    result: outcome.Outcome,
    bent: Ramp | None,
    repeated: Background | None,
    others: Named | None,
    false_alarm_rate: float,
    out: Path | None,
    command: str,
) -> Diagnosis:
    effects = tuple(e for evidence in found for e in evidence.effects)
    fit = result.fit
    left = not result.chance >= false_alarm_rate
    if effects:
        verdict = 'partial' if left else 'ambiguous' if others is not None and others.rivals else 'explained'
    else:
        verdict = 'unexplained' if left else 'consistent'
    explanation = Explanation(effects, sum(e.log_evidence_gain for e in effects)) if effects else None
    located = tuple(x for evidence in found for x in evidence.locations)
    everywhere = Location('if_samples', m.station, 'ramp_time', 0.0, m.signal.shape[1] / m.rate, 1.0)
    remainder, refined = None, None
    if left:
        plays = repeated is not None and not any(_acts_twice(e.effect) for e in effects)
        learnt = measured(data, m, repeated, effects) if repeated is not None and plays else None
        model = None
        if out is not None:
            Path(out).mkdir(parents=True, exist_ok=True)
            model = str(Path(out) / MODEL) if learnt is not None else None
            if learnt is not None and model is not None:
                write_measured(model, learnt)
        before, after = _judged(fit)
        share = float(np.clip((after - 1.0) / (before - 1.0), 0.0, 1.0)) if before > max(after, 1.0) else 1.0
        described = described_remainder(repeated, m) if repeated is not None else None
        remainder = Remainder(result.chance, share, (everywhere,), described, model)
    if out is not None and (effects or remainder is not None):
        Path(out).mkdir(parents=True, exist_ok=True)
        own = remainder is not None and remainder.model is not None
        refined = write_refined(Path(out) / 'refined.yaml', data, effects, bent, m if own else None)
    diagnosis = Diagnosis(
        recording=data.path,
        verdict=verdict,
        significance=min([*(e.p_value for e in effects), result.chance]),
        false_alarm_rate=false_alarm_rate,
        locations=located or ((everywhere,) if left else ()),
        explanation=explanation,
        alternatives=alternatives(others, m) if others is not None else (),
        next_measurement=None,
        fit=fit,
        refined_config=refined,
        not_testable=(
            *data.missing,
            *(text for evidence in found for text in evidence.undetermined),
            'A scene of several lines has no nominal model: its lines come from the samples, and only what receiver '
            'and ramp do to them is searched for.',
            *((result.untested,) if result.untested else ()),
        ),
        sentences=tuple(text for evidence in found for text in evidence.sentences),
        series=_series(bent) if bent is not None and bent.bends else (),
        command=command,
        remainder=remainder,
        scene={name: value for evidence in found for name, value in evidence.figures.items()} or None,
    )
    return dataclasses.replace(diagnosis, sentences=sentences(diagnosis))


def _acts_twice(effect: str) -> bool:
    """Return whether an effect would change once more what was learnt with it."""
    kind = Effect.registry[effect]
    return ActsOn.SAMPLES in kind.acts_on and kind.evidence not in ('leakage', 'limit', 'bursts')


def _judged(fit: Fit) -> tuple[float, float]:
    """Return the misfits without and with what was found, of what was held out where something was."""
    shown = fit.held_out if math.isfinite(fit.held_out.after) else fit.fitted
    return shown.before, shown.after


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
