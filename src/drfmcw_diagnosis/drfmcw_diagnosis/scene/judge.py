"""The verdict on a scene: which effects are there, what they leave, and the scenario with them."""

import dataclasses
import math
from collections.abc import Collection
from pathlib import Path

import numpy as np

from ..finding.result import BeforeAfter, Diagnosis, Explanation, Fit, Location, Remainder, Series
from ..finding.wording import sentences
from ..recording.dataset import Dataset
from .bursts import bursts, unpredicted
from .censored import limited_fit
from .evidence import Evidence, of_bursts, of_image, of_limit, of_ramp
from .images import image
from .limits import JUDGE
from .material import Material, material
from .rails import limit
from .ramp import Ramp, ramp
from .refining import write_refined


def examine(
    data: Dataset, false_alarm_rate: float, out: Path | None = None, command: str = '', without: Collection[str] = ()
) -> Diagnosis | None:
    """Return what the samples of a station that hears itself show, None where comparing features says more.

    That is so for one line on a ramp that is nearly straight. Arguments as `engine.diagnose_dataset`.
    """
    m = material(data)
    single = _single(m)
    found: list[Evidence] = []
    unusable = np.zeros(m.parts.shape, bool)
    limited = None if single or 'clipping' in without else limit(m)
    if limited is not None:
        found.append(of_limit(limited, m))
        unusable |= limited.at
    bursting = None
    if not single and limited is None and 'interference_burst' not in without:
        bursting = bursts(m)
    if bursting is not None:
        found.append(of_bursts(bursting, m))
        unusable |= np.concatenate([bursting.at] * 2) if m.iq else bursting.at
    bent = ramp(m) if limited is None and bursting is None else None
    if bent is not None and (bent.bends or any(bent.narrower)):
        found.append(_kept(of_ramp(bent), without))
    imaged = image(m) if 'iq_imbalance' not in without else None
    if imaged is not None:
        found.append(of_image(imaged, m))
    found = [e for e in found if e.effects]
    if single and not found:
        return None
    if limited is not None:
        fit = limited_fit(m, limited)
    else:
        fit = _ramp_fit(bent) if bent is not None and found and bursting is None else _fit(m, unusable)
    return _diagnosis(data, m, found, fit, bent, false_alarm_rate, out, command)


def _kept(evidence: Evidence, without: Collection[str]) -> Evidence:
    return dataclasses.replace(evidence, effects=tuple(e for e in evidence.effects if e.effect not in without))


def _single(m: Material) -> bool:
    """Return True where one line holds nearly all power beside 0 Hz: the comparison of features is made for it."""
    signal = m.signal[: JUDGE.sweeps]
    count = signal.shape[1]
    flat = signal - signal.mean(axis=1, keepdims=True)
    power = np.mean(np.abs(np.fft.fft(flat * np.hanning(count), axis=1)) ** 2, axis=0)
    near = np.minimum(np.arange(count), count - np.arange(count)) <= JUDGE.skirt
    power[near] = 0.0
    peaks = np.abs(np.fft.fft(flat * np.hanning(count), axis=1)) ** 2
    peaks[:, near] = 0.0
    held = 0.0
    for row in peaks:
        at = int(np.argmax(row))
        around = np.arange(at - JUDGE.skirt, at + JUDGE.skirt + 1) % count
        held += float(row[around].sum()) * (1.0 if m.iq else 2.0)
    whole = float(np.sum(np.abs(np.fft.fft(flat * np.hanning(count), axis=1)) ** 2))
    return count >= JUDGE.fewest_samples and held > JUDGE.single * whole


def _fit(m: Material, unusable: np.ndarray) -> Fit:
    """Return the power of what cannot be predicted over its noise: of all samples, and of those the effects leave."""
    rest = unpredicted(m.signal)
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
            *(text for evidence in found for text in evidence.untold),
            'A scene of several lines has no nominal model: its lines are predicted from the samples, and only what '
            'receiver and ramp do to them is searched for.',
        ),
        sentences=tuple(text for evidence in found for text in evidence.sentences),
        series=_series(bent) if bent is not None and bent.bends else (),
        command=command,
        remainder=remainder,
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
