"""The verdict on a scene: which effects are there, what they leave, and the scenario with them."""

import dataclasses
import math
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from ..finding.result import BeforeAfter, Diagnosis, Explanation, Fit, Location, Remainder, Series
from ..finding.wording import sentences
from ..recording.dataset import Dataset
from .background import Background, background
from .bursts import Bursts, bursts, unpredicted
from .evidence import Evidence, of_background, of_bursts, of_image, of_limit, of_ramp, of_side, shown_by
from .images import Image, image, measured
from .limits import JUDGE
from .lines import limited_fit
from .material import Material, material
from .rails import limit
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
    found: list[Evidence] = []
    unusable = np.zeros(m.parts.shape, bool)
    limited = None if single or shown_by('limit') in without else limit(m)
    if limited is not None:
        found.append(of_limit(limited, m))
        unusable |= limited.at
    bursting = None
    if not single and limited is None and shown_by('bursts') not in without:
        bursting = bursts(m)
    if bursting is not None:
        found.append(of_bursts(bursting, m))
        unusable |= np.concatenate([bursting.at] * 2) if m.iq else bursting.at
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
    found.append(of_side(m))
    if limited is not None:
        fit, said = limited_fit(m, limited)
        found.append(Evidence((), (), (said,)))
    else:
        of_the_ramp = shown_by('window'), shown_by('rate')
        ramped = any(e.effect in of_the_ramp for part in found for e in part.effects)
        fit = _ramp_fit(bent) if bent is not None and ramped else _fit(m, unusable)
    if repeated is not None and repeated.leaks:
        fit = _leakage_fit(m, repeated)
    return _diagnosis(data, m, found, fit, bent, false_alarm_rate, out, command)


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


def _fit(m: Material, unusable: np.ndarray) -> Fit:
    """Return the power of what cannot be predicted over its noise: of all samples, and of those the effects leave."""
    rest, _ = unpredicted(m.signal)
    power = np.abs(rest) ** 2
    noise = float(np.median(power)) / (math.log(2.0) if m.iq else JUDGE.median_of_square)
    noise = max(noise, (2.0 if m.iq else 1.0) / 12.0)
    bad = unusable[: len(m.signal)] | unusable[-len(m.signal) :]
    bad = bad[:, m.signal.shape[1] - rest.shape[1] :]
    at = max(1, round(JUDGE.fitted * len(rest)))
    parts = []
    for rows in (slice(0, at), slice(at, None)):
        each, left = power[rows] / noise, ~bad[rows]
        before = float(each.mean()) if each.size else math.nan
        parts.append(BeforeAfter(before, float(each[left].mean()) if left.any() else math.nan))
    return Fit(parts[0], parts[1])


def _leakage_fit(m: Material, found: Background) -> Fit:
    """Return the power without and with a constant, over the noise."""
    at = max(1, round(JUDGE.fitted * len(m.signal)))
    scale = m.noise**2 * (2.0 if m.iq else 1.0)
    parts = [np.mean(np.abs(m.signal[rows]) ** 2) / scale for rows in (slice(0, at), slice(at, None))]
    after = found.constant**2 / scale
    return Fit(BeforeAfter(float(parts[0]), after), BeforeAfter(float(parts[1]), after))


def _ramp_fit(found: Ramp) -> Fit:
    noise = found.material.noise
    before = (found.nominal / noise) ** 2
    return Fit(BeforeAfter(before, (found.fitted / noise) ** 2), BeforeAfter(before, (found.held_out / noise) ** 2))


def _diagnosis(
    data: Dataset,
    m: Material,
    found: list[Evidence],
    fit: Fit,
    bent: Ramp | None,
    false_alarm_rate: float,
    out: Path | None,
    command: str,
) -> Diagnosis:
    effects = tuple(e for evidence in found for e in evidence.effects)
    after = fit.held_out.after if math.isfinite(fit.held_out.after) else fit.fitted.after
    before = fit.held_out.before if math.isfinite(fit.held_out.before) else fit.fitted.before
    left = after > JUDGE.adequate
    if effects:
        verdict = 'partial' if left else 'explained'
    else:
        verdict = 'unexplained' if left else 'consistent'
    explanation = Explanation(effects, sum(e.log_evidence_gain for e in effects)) if effects else None
    located = tuple(x for evidence in found for x in evidence.locations)
    shares = [x for x in located if math.isfinite(x.share)]
    even = (1.0 - min(sum(x.share for x in shares), 1.0)) / max(len(located) - len(shares), 1)
    located = tuple(x if math.isfinite(x.share) else dataclasses.replace(x, share=even) for x in located)
    everywhere = Location('if_samples', m.station, 'ramp_time', 0.0, m.signal.shape[1] / m.rate, 1.0)
    remainder = None
    if left and effects:
        share = float(np.clip((after - 1.0) / max(before - 1.0, 1e-9), 0.0, 1.0))
        remainder = Remainder(0.0, share, (everywhere,))
    refined = None
    if out is not None and effects:
        Path(out).mkdir(parents=True, exist_ok=True)
        refined = write_refined(Path(out) / 'refined.yaml', data, effects, bent)
    diagnosis = Diagnosis(
        recording=data.path,
        verdict=verdict,
        significance=min((e.p_value for e in effects), default=0.0 if left else 1.0),
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
            'A scene of several lines has no nominal model: its lines are predicted from the samples, and only what '
            'receiver and ramp do to them is searched for.',
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
            np.full(len(straight), m.noise),
            straight - bent,
            'LSB',
            f'IF of {m.station} beside a straight ramp',
        ),
    )
