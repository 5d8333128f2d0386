"""Events at one time of every sweep, a step or a bump, which have no name.

In: an explanation. Out: what each effect that shows over the sweep alone gains beyond the best event in its place, and
the events that are left beside it. No effect of the registry is an event in mid-sweep. Where one fits better than an
effect, the effect is in doubt; where one is left, it is set aside, so that it hides no effect.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping

import numpy as np
from scipy import special, stats

from ..compare.algebra import gain_of
from ..compare.over_sweep import as_shown, over_sweep, ramp_of
from . import courses
from .courses import Law
from .fits.fitted import Fitted, Freedom
from .fits.fitting import Fitting
from .fits.whitening import Whitening
from .limits import EVENTS


def beyond_events(fitting: Fitting, fitted: Fitted) -> list[float]:
    """Return by how much each effect's gain exceeds that of the best event, infinity where no event compares.

    Args:
        fitting: of the recording.
        fitted: the explanation.
    """
    c, whitening = fitting.comparison, fitting.whitening
    slopes = whitening(fitting.slopes(fitted))
    rest = whitening(c.residual - fitted.template)
    of_ramp = c.entries.where(kind='ramp')
    found = []
    for number, own in enumerate(fitted.spans):
        added = whitening(fitting.added_beside(fitted, number))
        if float(np.sum(added[of_ramp] ** 2)) < EVENTS.by_ramp * float(added @ added):
            found.append(np.inf)
            continue
        beside = Freedom(np.delete(slopes, own, axis=0))
        unexplained = beside.left(rest + added)
        gain = float(unexplained @ unexplained - rest @ rest)
        best = max(_events(fitting, whitening, unexplained, beside), key=lambda event: event.gain)
        further = max(own.stop - own.start - EVENTS.of_event, 0)
        if not fitted.effects[number].candidate.recipe.coefficients:
            found.append(gain - best.gain - EVENTS.parameter * further)
            continue
        # many coefficients may follow an event better than one step or bump does: it has all of its freedom then
        directions = beside.left(whitening(_directions(fitting, best)))
        left_by_event = Freedom(directions).left(unexplained)
        by_event = float(unexplained @ unexplained - left_by_event @ left_by_event)
        found.append(gain - by_event - EVENTS.parameter * (own.stop - own.start - len(directions)))
    return found


@dataclasses.dataclass(frozen=True)
class _Event:
    """The best event in some channels of the ramp."""

    gain: float
    size: float
    shape: np.ndarray  # over the sweep (K,)
    at: int  # its time [blocks of the sweep]
    width: float  # of its onset [blocks of the sweep]
    tried: int  # shapes
    channels: Mapping[int, float]  # and their signs
    law: np.ndarray  # its size in each group (G,)
    losing: int  # station with samples that loses some of them, -1 for none


def left(fitting: Fitting, fitted: Fitted | None, as_measured: Whitening) -> np.ndarray:
    """Return what has no name over the sweep beside an explanation: courses of one receiver, else events (k, n).

    Over the numbers' standard deviations and times its prior.

    Args:
        fitting: of the recording.
        fitted: the explanation, None for none.
        as_measured: whitening of what it leaves, nothing of which counts as unknown.
    """
    c = fitting.comparison
    residual = c.residual - (fitted.template if fitted is not None else 0.0)
    derivatives = fitting.slopes(fitted) if fitted is not None else np.zeros((0, len(residual)))
    found = np.zeros((0, len(residual)))
    for _ in range(EVENTS.most):
        whitening = as_measured.beside(found)
        beside = Freedom(whitening(derivatives))
        rest = beside.left(whitening(residual))
        each = list(_events(fitting, whitening, rest, beside))
        best = max(each, key=lambda event: event.gain)
        if not len(found):
            by_event = gain_of(beside.left(whitening(_directions(fitting, best))), rest)
            found = courses.left(fitting, whitening, rest, beside, by_event)
            if len(found):
                continue
        rows = np.isin(c.entries.station, list(best.channels)) & c.entries.where(kind='ramp')
        excess = float(rest[rows] @ rest[rows]) - np.count_nonzero(rest[rows])
        chance = len(each) * best.tried * stats.chi2.sf(best.gain, 1)
        if not (chance <= EVENTS.chance and best.gain >= EVENTS.worth * excess):
            break
        if best.gain < courses.gain_of_curve(fitting, whitening, rest, beside, Law(best.channels, best.law)):
            break  # a step explains three quarters of a slope
        found = np.vstack([found, _directions(fitting, best)])
    return found


def over_set_aside(fitting: Fitting, fitted: Fitted, as_it_is: Whitening, gains: Mapping[int, float]) -> list[float]:
    """Return gains of effects over what is set aside explains, infinity of effects that show in other numbers.

    Args:
        fitting: of the recording.
        fitted: the explanation.
        as_it_is: whitening of what it leaves, nothing of which counts as unknown.
        gains: by the effect's number in it.
    """
    aside = np.any(fitting.set_aside != 0.0, axis=0)
    if not aside.any():
        return [np.inf] * len(gains)
    as_measured = as_it_is.beside(fitting.set_aside)
    residual = fitting.comparison.residual - fitted.template
    explained = float(np.sum(as_it_is(residual) ** 2) - np.sum(as_measured(residual) ** 2))
    found = []
    for number, gain in gains.items():
        added = as_measured(fitting.added_beside(fitted, number))
        beside = 2.0 * float(added[aside] @ added[aside]) > float(added @ added)
        found.append(gain / max(explained, 1e-30) if beside else np.inf)
    return found


def set_aside(fitting: Fitting, fitted: Fitted | None, further: Fitted | None) -> bool:
    """Set events aside where they explain more than the best further effect; return whether they were.

    Several effects would imitate an event, and the true ones beside it would be taken for others.

    Args:
        fitting: of the recording; not changed where numbers already count as noise.
        fitted: the explanation, None for none.
        further: the explanation with one more effect, None where none is credible.
    """
    if fitting.noisier.min() < 1.0:
        return False
    residual = fitting.comparison.residual - (fitted.template if fitted is not None else 0.0)
    as_measured = fitting.whitening_of(fitted, with_unknown=False)
    apart = left(fitting, fitted, as_measured)
    now, then = (as_measured.beside(x)(residual) ** 2 for x in (fitting.set_aside, apart))
    over_sweep = fitting.comparison.entries.where(kind='ramp')  # a shift of the lines is no evidence of an event
    gain = float(np.sum((now - then)[over_sweep]))
    least = EVENTS.clearly if further is None else float(np.sum(now)) - further.misfit + EVENTS.clearly
    explained = fitting.misfit(0.0) - fitted.misfit if fitted is not None else 0.0
    if gain < max(least, EVENTS.clearly, EVENTS.adequate * explained):
        return False
    before, fitting.set_aside = fitting.set_aside, apart
    if fitted is None:
        return True
    # what an event would make uncertain was found without it: something else bends the sweep
    fitting.trust(fitted)
    beside = zip(fitted.effects, fitting.fit(fitted.start, 1).effects, strict=True)
    if all(then.certain or not now.certain for now, then in beside):
        return True
    fitting.set_aside = before
    fitting.trust(fitted)
    return False


def _directions(fitting: Fitting, event: _Event) -> np.ndarray:
    """Return what may be unknown of an event, each times its prior (k, n).

    Its size; its time and its onset to first order; each block about it in each channel; the lines' shift. The more
    distant the other station, the later it hears what happens at the first one, which shows in sum and difference of
    the phases for that long.
    """
    c = fitting.comparison
    _, phases = ramp_of(c)
    ones, far = np.ones_like(c.recorded.distance), c.recorded.distance / c.recorded.distance.max()
    later = np.gradient(event.shape)
    wider = np.gradient(later) * 0.5 * max(event.width, 1.0) ** 2
    count = len(event.shape)
    about = [b for b in range(event.at - EVENTS.about, event.at + EVENTS.about + 1) if 0 <= b < count]
    ways = [
        (EVENTS.prior * event.shape, ones, event.channels),
        (later, ones, event.channels),
        (later, far, event.channels),
        (wider, ones, event.channels),
    ]
    own = phases if set(event.channels) <= set(phases) else list(event.channels)
    ways += [(np.eye(count)[b], along, {i: 1.0}) for b in about for along in (ones, far) for i in own]
    sized = [over_sweep(c, shape, event.size * event.law * along, channels) for shape, along, channels in ways]
    return np.concatenate(
        [
            np.array(sized),
            courses.shifted_lines(c, _turned(event), Law(event.channels, event.law)),
            _earlier_end(fitting, event),
        ]
    )


def _turned(event: _Event) -> float:
    """Return by how much an event of the phases may tilt them over the sweep [rad per block].

    A sweep's frequency follows a part of the event: a line through a step is steeper. How large a part depends on the
    estimator, so any is as likely, which has a mean square of a third.
    """
    block = np.arange(len(event.shape)) - 0.5 * (len(event.shape) - 1)
    return event.size * float(event.shape @ block / (block @ block)) / math.sqrt(3.0)


def _earlier_end(fitting: Fitting, event: _Event) -> np.ndarray:
    """Return what a station that loses samples shows where its signal ends, each times its prior (k, n).

    The last of the record holds no signal then: the end itself, and the last block of the sweep.
    """
    c = fitting.comparison
    ramp, phases = ramp_of(c)
    if event.losing < 0:
        return np.zeros((0, len(c.residual)))
    channels = (event.losing, *phases)
    found = np.zeros((len(channels) + 1, len(c.residual)))
    last = as_shown(np.eye(len(event.shape))[-1:], of_phase=False)
    size = (event.size * event.law)[:, None]
    for row, channel in zip(found, channels, strict=False):
        row[c.rows(ramp, channel)] = np.ravel(size * last / c.std['ramp'][:, channel])
    ends = next(k for k in c.kinds if k.name == 'ends')
    found[-1, c.rows(ends, event.losing)] = np.ravel(np.array([0.0, EVENTS.prior]) / c.std['ends'][:, event.losing])
    return found


def _events(fitting: Fitting, whitening: Whitening, rest: np.ndarray, beside: Freedom) -> Iterator[_Event]:
    """Yield the best event in each channel of the ramp and in both phases, of each law.

    Args:
        fitting: of the recording.
        whitening: of its numbers.
        rest: what is to be explained, beyond what other effects can follow, whitened (n,).
        beside: of the other effects.
    """
    c = fitting.comparison
    kind, phases = ramp_of(c)
    channels = [(c.rows(kind, row), c.std['ramp'][:, row]) for row in range(c.std['ramp'].shape[1])]
    signs = [{i: 1.0} for i in range(len(channels))]
    signs += [{phases[0]: 1.0, phases[1]: sign} for sign in (1.0, -1.0) if len(phases) == 2]
    count = channels[0][1].shape[1]
    each, times, widths = _shapes(count)
    either = [as_shown(each, of_phase) for of_phase in (False, True)]
    for law, losing in _laws(fitting):
        for sign in signs:
            shapes = either[next(iter(sign)) in phases]
            remains, power = np.zeros(len(shapes)), np.zeros(len(shapes))
            imitated = np.zeros((len(shapes), len(beside.slopes)))
            for channel, factor in sign.items():
                rows, std = channels[channel]
                share = factor * law[:, None] * whitening.weight[rows].reshape(std.shape) / std
                remains += shapes @ np.sum(rest[rows].reshape(std.shape) * share, axis=0)
                power += shapes**2 @ np.sum(share**2, axis=0)
                imitated += shapes @ np.einsum('pgk,gk->kp', beside.slopes[:, rows].reshape(-1, *std.shape), share)
            own = power - beside.power(imitated)
            gains = np.where(own > EVENTS.least_power * power, remains**2 / np.maximum(own, 1e-30), 0.0)
            best = int(np.argmax(gains))
            size = float(remains[best] / max(own[best], 1e-30))
            yield _Event(
                float(gains[best]),
                size,
                each[best],
                int(times[best]),
                float(widths[best]),
                len(each),
                sign,
                law,
                losing,
            )


def _laws(fitting: Fitting) -> list[tuple[np.ndarray, int]]:
    """Return how large an event may be in each group (G,): alike, by the distance, by the frequency of a line.

    The last is that of samples which a station loses: what follows comes too early. Its number comes with it, else -1.
    The phase shows by how many turns the line is then ahead, but for whole ones.
    """
    r = fitting.comparison.recorded
    laws = [(np.ones_like(r.distance), -1), (r.distance / r.distance.mean(), -1)]
    for number, station in enumerate(r.heard):
        lines = courses.by_frequency(fitting.comparison, number)
        settings = [r.data.sweeps[r.data.setting[rows[0]]][station] for rows in r.members]
        turns = lines / np.array([sweep.sample_rate for sweep in settings])
        laws.append((lines / np.abs(lines).mean(), number))
        for lost in range(2, EVENTS.lost + 1):
            whole = np.rint(lost * turns)
            if whole.any():
                laws.append((lost * turns - whole, number))
    return laws


def _shapes(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return steps, bumps and kinks over `count` blocks (M, count), their times and their onsets' widths [blocks]."""
    block = np.arange(count)
    at = np.arange(round(EVENTS.edge * count), round((1.0 - EVENTS.edge) * count))[:, None]
    found, widths = [np.maximum(block - at, 0.0) / count], [0.0]
    for width in EVENTS.widths:
        found.append(special.ndtr((block - at + 0.5) / max(width, 1e-3)))
        widths.append(width)
        if width <= EVENTS.longest:
            found.append(np.exp(-0.5 * ((block - at) / max(width, 0.5)) ** 2))
            widths.append(width)
    return np.concatenate(found), np.tile(at.ravel(), len(found)), np.repeat(widths, len(at))
