"""Effects of a scene in the words of a finding: parameters with standard deviations, where they show, their gain."""

import dataclasses
import math
from typing import Any

import numpy as np
from scipy import stats

from drfmcw_physics.constants import DECIBELS_PER_NEPER, SPEED_OF_LIGHT
from drfmcw_physics.settings import declared_parameters
from drfmcw_sim.effects import Effect

from ..finding.result import Estimate, Explanation, FoundEffect, Location
from ..search.starts.bank import Candidate
from .background import Background, gain
from .bursts import Bursts
from .forward.misfit import bounded
from .forward.model import Scene, Straight
from .forward.naming import Named
from .forward.tracks import Tracks, solve
from .images import Image
from .limits import JUDGE, SIDES
from .material import Material
from .rails import Limit
from .ramps.ramp import Ramp
from .track import Track


@dataclasses.dataclass(frozen=True)
class Evidence:
    """What one look at a scene brings."""

    effects: tuple[FoundEffect, ...]
    locations: tuple[Location, ...]
    sentences: tuple[str, ...]
    undetermined: tuple[str, ...] = ()
    figures: dict[str, Any] = dataclasses.field(default_factory=dict)  # JSON-ready


def shown_by(evidence: str) -> str:
    """Return the name of the effect whose evidence that is."""
    (name,) = (name for name, kind in Effect.registry.items() if kind.evidence == evidence)
    return name


def of_ramp(found: Ramp) -> Evidence:
    """Return window, shape and amplitude slope, as far as they are there."""
    m, w = found.material, found.window
    effects, locations = [], []
    held = int(sum(line.held.sum() for line in found.lines))
    straight = float(np.sqrt(np.mean([s.held_out**2 for s in found.straight])))
    later, earlier = found.narrower
    if later or earlier:
        beyond, samples = found.beyond
        parameters = {}
        if later:
            parameters['start'] = Estimate(w.first / m.rate, 2.0 / m.rate, 's')
        if earlier:
            parameters['end'] = Estimate(w.last / m.rate, 4.0 / m.rate, 's')
        effects.append(_effect('window', m, parameters, *_lowered(beyond, found.held_out, samples, held)))
        if later:
            locations.append(Location('if_samples', m.station, 'ramp_time', 0.0, w.first / m.rate, math.nan))
        if earlier:
            locations.append(
                Location('if_samples', m.station, 'ramp_time', w.last / m.rate, m.nominal_end / m.rate, math.nan)
            )
    sentences: list[str] = []
    undetermined: list[str] = []
    if found.bends:
        coefficients, stds, longer = found.over_nominal()
        parameters = {
            f'relative_rate[{i}]': Estimate(float(v), float(s), '')
            for i, (v, s) in enumerate(zip(coefficients, stds, strict=True))
        }
        effects.append(_effect('rate', m, parameters, *_lowered(straight, found.held_out, held, held)))
        locations.append(Location('if_samples', m.station, 'ramp_time', w.first / m.rate, w.last / m.rate, math.nan))
        slope, slope_std = found.slope
        if abs(slope) > 4.0 * slope_std:
            effects.append(_effect('slope', m, {'slope': Estimate(slope, slope_std, 'dB')}, *_apart(slope, slope_std)))
        delay = float(found.shape.delay[0])
        std = convention(found) * delay
        sentences += [
            f"The ramp's rate differs from its mean by {100.0 * float(np.std(found.rate())):.1f} % rms over the band. "
            f'What is left on blocks of samples that were held out: {found.nominal:.1f} LSB rms beside a straight '
            f'nominal ramp, {straight:.1f} beside a straight one within its window, {found.held_out:.1f} beside the '
            f'shape; white noise has {found.white:.1f}.',
            f'Delay of the line: {1e9 * delay:.2f} ± {1e9 * std:.2f} ns, if the stated band is covered from '
            f'{1e3 * w.begins / m.rate:.4f} to {1e3 * w.ends / m.rate:.4f} ms.',
            f'A constant that varies slowly over the sweep by {found.constant:.0f} LSB peak to peak was fitted beside '
            'the line; no effect of the registry describes it.',
        ]
        undetermined.append(
            'The overall rate of the ramp cannot be separated from the length of the path without a known length: the '
            'delay holds if the stated band is covered within the window; a ramp as long as nominal would make the '
            f'delay {100.0 * (longer - 1.0):.1f} % longer.'
        )
    figures = {
        'delays': [float(d) for d in found.shape.delay],
        'delay_std': [float(d) * convention(found) for d in found.shape.delay],
        'convention': 'the stated band is covered from window.begins to window.ends',
        'window': {'begins': w.begins / m.rate, 'ends': w.ends / m.rate},
        'misfit': {'nominal': found.nominal, 'held_out': found.held_out, 'noise': found.white, 'unit': 'LSB'},
        'constant': found.constant,
    }
    return Evidence(tuple(effects), tuple(locations), tuple(sentences), tuple(undetermined), {'ramp': figures})


def convention(found: Ramp) -> float:
    """Return the relative standard deviation of the scale of delays: where the stated band begins and ends [1]."""
    edges = math.sqrt(2.0) * 4.0 / found.window.length
    return math.hypot(edges, float(np.std(found.rate())) / math.sqrt(len(found.shape.std)))


def of_limit(found: Limit, m: Material, gain: float) -> Evidence:
    """Return clipping, which is counted and gains so much in what is held out, and the high-pass behind it."""
    std = DECIBELS_PER_NEPER * found.level_std / found.level
    parameters = {'level': Estimate(m.decibels(found.level), max(std, 0.05), 'dBFS')}
    effects = [_effect('limit', m, parameters, gain, found.probability)]
    sentences = [f'{100.0 * found.share:.1f} % of the samples stand at a limit of ±{found.level:.0f} LSB.']
    if found.pole is not None:
        pole, pole_std = found.pole
        effects.append(_effect('droop', m, {'pole': Estimate(pole, pole_std, 'Hz')}, *_apart(pole, pole_std)))
        sentences.append('The plateaus of the limit droop: the receiver limits in front of a high-pass.')
    at = Location('if_samples', m.station, 'adc_code', found.level, float(np.abs(m.parts).max()), math.nan)
    return Evidence(tuple(effects), (at,), tuple(sentences))


def of_bursts(found: Bursts, m: Material, gain: float) -> Evidence:
    """Return bursts of another transmitter, which gain so much in what is held out."""
    count = len(found.hit)
    std = math.sqrt(found.probability * (1.0 - found.probability) / count)
    parameters = {
        'probability': Estimate(found.probability, math.hypot(std, 0.05 * found.probability), '1'),
        'level': Estimate(m.decibels(found.amplitude), 2.0, 'dBFS'),
        'duration': Estimate(found.duration, 0.25 * found.duration, 's'),
    }
    times = np.flatnonzero(found.at.any(axis=0))
    at = Location('noise', m.station, 'ramp_time', times[0] / m.rate, (times[-1] + 1) / m.rate, math.nan)
    text = (
        f'In {int(found.hit.sum())} of {count} sweeps, {100.0 * found.share:.1f} % of the samples, the power that no '
        f'line predicts is {10.0 * math.log10(found.excess):.1f} dB above that of the others.'
    )
    chance = max(found.chance, bounded(gain))
    return Evidence((_effect('bursts', m, parameters, gain, chance),), (at,), (text,))


def of_image(found: Image, m: Material) -> Evidence:
    """Return the imbalance of I and Q."""
    std = 2.0 * found.std
    parameters = {
        'gain': Estimate(found.gain, DECIBELS_PER_NEPER * std, 'dB'),
        'phase': Estimate(found.phase, math.degrees(std), 'deg'),
    }
    gained = 0.5 * (abs(found.ratio) / found.std) ** 2
    at = Location('if_spectrum', m.station, 'if_frequency', -0.5 * m.rate, 0.5 * m.rate, math.nan)
    text = f'{found.lines} cells of range and velocity have an image of {20.0 * math.log10(abs(found.ratio)):.1f} dB.'
    return Evidence((_effect('image', m, parameters, gained),), (at,), (text,))


def of_named(found: Named, alone: Straight, m: Material) -> Evidence:
    """Return the effects that the forward model of all lines demands."""
    kinds = zip(found.fitted.candidates, found.fitted.std, found.gains, found.chances, strict=True)
    effects = tuple(_of_candidate(c, std, gain, chance, m) for c, std, gain, chance in kinds)
    before, after = alone.held_out.per_freedom, found.outside.per_freedom
    share = float(np.clip((before - after) / max(before - 1.0, 1e-9), 0.0, 1.0))
    at = Location('if_samples', m.station, 'ramp_time', 0.0, m.nominal_end / m.rate, share)
    text = (
        f'{len(alone.tracks)} lines of a straight ramp leave {before:.3g} times the noise of what was held out; '
        f'{len(found.fitted.tracks)} lines with what is named leave {after:.3g} times. All lines show the same effect, '
        'each by its delay.'
    )
    return Evidence(effects, (at,), (text,))


def alternatives(found: Named, m: Material) -> tuple[Explanation, ...]:
    """Return the explanations that are not much worse."""
    return tuple(
        Explanation(
            tuple(
                _of_candidate(c, std, gain, chance, m)
                for c, std, gain, chance in zip(x.candidates, x.std, found.gains, found.chances, strict=True)
            ),
            sum(found.gains) - worse,
        )
        for x, worse in found.rivals
    )


def _of_candidate(c: Candidate, std: dict[str, float], gain: float, chance: float, m: Material) -> FoundEffect:
    units = {name: declared.unit for name, (_, declared) in declared_parameters(c.kind).items()}
    parameters = {
        name: Estimate(value, std.get(name, math.nan), units[name.partition('[')[0]])
        for name, value in c.values.items()
    }
    return FoundEffect(c.effect, m.station, parameters, max(gain, 0.0), max(chance, JUDGE.certain))


def of_lines(s: Scene, tracks: Tracks) -> Evidence:
    """Say where the lines stand that describe a scene, by their frequencies in the middle of the recording."""
    if not len(tracks):
        return Evidence((), (), ())
    m = s.material
    middle = solve(s.fitted, tracks).phasor  # (n, L) lines within a cell of each other are one
    order = np.argsort(tracks.frequency[:, 0])
    apart = np.diff(tracks.frequency[order, 0]) > 1.0 / len(s.held)
    groups = np.split(order, np.flatnonzero(apart) + 1)
    sign = 1.0 if m.bandwidth > 0.0 or not m.iq else -1.0
    scale = sign * m.rate / abs(m.bandwidth) * m.duration * SPEED_OF_LIGHT
    figures = []
    for group in groups:
        weight = np.mean(np.abs(middle[:, group]), axis=0)
        level = m.decibels(float(np.sqrt(np.mean(np.abs(middle[:, group].sum(axis=1)) ** 2))))
        path = float(scale * np.average(tracks.frequency[group, 0], weights=weight))
        figures.append({'path': path, 'level': level, 'cell': abs(scale) / len(s.held)})
    figures.sort(key=lambda x: -x['level'])
    shown = ', '.join(f'{x["path"]:.3g} m ({x["level"]:.0f} dBFS)' for x in figures[: JUDGE.shown])
    text = f'The strongest of {len(figures)} lines stand at paths of {shown}.'
    return Evidence((), (), (text,), (), {'lines': figures})


def of_moving(static: Straight, alone: Straight) -> Evidence:
    """Say what lines leave where all that repeats with the ramp was taken away."""
    text = (
        f'{len(static.tracks)} lines leave {static.held_out.per_freedom:.3g} times the noise of what was held out. '
        f'Without what repeats with the ramp, as the sweeps fitted show it, {len(alone.tracks)} lines that move leave '
        f'{alone.held_out.per_freedom:.3g} times.'
    )
    return Evidence((), (), (text,))


def of_multiples() -> Evidence:
    """Say what lines at multiples of the strongest one may be."""
    said = (
        'The weaker lines stand at multiples of the frequency of the strongest one: a receiver that is not linear, or '
        'returns from multiples of its distance. No effect of the registry describes them better than such lines.'
    )
    return Evidence((), (), (said,))


def of_background(found: Background, moving: Track | None, m: Material) -> Evidence:
    """Return leakage, and what repeats and moves in sentences: no effect of the registry describes it."""
    effects: tuple[FoundEffect, ...] = ()
    locations: tuple[Location, ...] = ()
    if found.leaks:
        parameters = {'level': Estimate(m.decibels(found.leakage), 0.1, 'dBFS')}
        std = math.sqrt(m.floor.mean / m.signal.size)
        effects = (_effect('leakage', m, parameters, *_apart(found.leakage, std)),)
        locations = (Location('if_spectrum', m.station, 'if_frequency', 0.0, 2.0 * m.rate / m.signal.shape[1], 1.0),)
    said = [
        'What repeats with the ramp lowers the misfit of the last third of the sweeps from '
        f'{found.constant:.1f} LSB rms beside a constant to {found.repeating:.1f}; {len(found.patterns)} patterns over '
        f'the ramp with an amplitude of their own in each sweep lower it to {found.varying:.1f}, '
        f'{gain(found.constant, found.varying):.1f} dB in all. These are measured, not explained.'
    ]
    if moving is not None:
        near, far = np.nanquantile(moving.path, [0.05, 0.95])
        said.append(
            f'The strongest line that moves stands at paths of {near:.1f} to {far:.1f} m nine tenths of the time; a '
            'target is at half of it.'
        )
    misfit = {'constant': found.constant, 'repeating': found.repeating, 'varying': found.varying, 'unit': 'LSB'}
    figures: dict[str, Any] = {'background': misfit | {'patterns': len(found.patterns)}}
    if moving is not None:
        paths = [None if math.isnan(p) else float(p) for p in moving.path]
        figures['track'] = {'sweep': moving.sweep.tolist(), 'path': paths}
    return Evidence(effects, locations, tuple(said), (), figures)


def of_side(m: Material) -> Evidence:
    """Say where the lines of a quadrature receiver stand on the side on which no rising ramp has echoes."""
    if not m.iq:
        return Evidence((), (), ())
    flat = m.signal - m.signal.mean(axis=1, keepdims=True)
    count = m.signal.shape[1]
    power = np.mean(np.abs(np.fft.fft(flat * np.hanning(count), axis=1)) ** 2, axis=0)
    half = slice(SIDES.cells, count // 2)
    expected, other = float(power[half].max()), float(power[::-1][half].max())
    if m.bandwidth < 0.0:
        expected, other = other, expected
    mirrored = other > expected * 10.0 ** (SIDES.above / 10.0)
    said = (
        'The strongest line stands at the frequency of the opposite sign: I and Q may be swapped, or the ramp may have '
        'the other direction.',
    )
    return Evidence((), (), said if mirrored else (), (), {'mirrored': True} if mirrored else {})


def _lowered(before: float, after: float, count: int, of_after: int) -> tuple[float, float]:
    """Return gain and chance of one root mean square above another one, of so many samples that were not fitted."""
    gain = count * math.log(max(before, 1e-12) / max(after, 1e-12))
    return gain, float(stats.f.sf((before / after) ** 2, count, of_after)) if count else 1.0


def _apart(value: float, std: float) -> tuple[float, float]:
    """Return gain and chance of a number that differs from zero."""
    return 0.5 * (value / std) ** 2, 2.0 * float(stats.norm.sf(abs(value) / std))


def _effect(
    shown: str, m: Material, parameters: dict[str, Estimate], gain: float, probability: float | None = None
) -> FoundEffect:
    chance = bounded(gain) if probability is None else probability
    return FoundEffect(shown_by(shown), m.station, parameters, max(gain, 0.0), max(chance, JUDGE.certain))
