"""Events at one time of every sweep, a step or a bump, which have no name.

In: an explanation. Out: what each effect that shows over the sweep alone gains beyond the best event in its place, and
the events that are left beside it. No effect of the registry is an event in mid-sweep. Where one fits better than an
effect, the effect is in doubt; where one is left, it is set aside, so that it hides no effect.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy import special, stats

from drfmcw_physics.constants import SPEED_OF_LIGHT

from ..compare.algebra import scaled_inverse
from ..compare.over_sweep import as_shown, over_sweep, ramp_of
from .fits.fitted import Fitted, Freedom
from .fits.fitting import Fitting
from .fits.whitening import Whitening


@dataclasses.dataclass(frozen=True)
class EventLimits:
    """Which events take the place of an effect."""

    by_ramp: float = 0.9
    """Share of an effect's power over the sweep, above which an event may stand for it [1]; chosen."""

    edge: float = 0.1
    """Share of the sweep at either end in which an event may be what settles there [1]; chosen."""

    widths: tuple[float, ...] = (0.0, 2.0, 5.0)
    """Standard deviations of an event's onset [blocks of the sweep]; chosen."""

    longest: float = 2.0
    """Standard deviation of a bump, at most: wider ones resemble a curved ramp [blocks]; chosen."""

    beaten: float = -6.0
    """Gain of an effect beyond that of the best event, below which it is in doubt: odds of 20 to 1; chosen."""

    parameter: float = 2.0
    """Gain that each parameter must bring which an effect has more than an event (Akaike 1974)."""

    of_event: int = 2
    """Parameters of an event: its time and its size."""

    least_power: float = 0.1
    """Share of an event's power that the other effects must leave of it [1]; chosen."""

    about: int = 2
    """Blocks before and behind an event of which nothing is known [blocks of the sweep]; chosen."""

    most: int = 4
    """Events that are set aside, at most; chosen."""

    worth: float = 0.6
    """Share of what is left of its channels that an event must explain to be set aside [1]; chosen: a smooth curve that
    nobody knows is no event."""

    chance: float = 1e-6
    """Chance of an event, of all times and shapes, above which it is not set aside [1]; chosen."""

    clearly: float = 30.0
    """Gain by which events that are set aside must exceed that of the best further effect [1]; chosen."""

    lost: int = 4
    """Samples that a station loses at once, at most, whose turns of the line may exceed half a turn [1]; chosen."""

    adequate: float = 1e-3
    """Gain over what an explanation explains [1], below which an event may be its inaccuracy; as of a remainder."""

    faint: float = 1e-3
    """Gain of an effect over what is set aside of the same numbers explains, from which on it counts [1]; chosen: that
    is known to first order only."""

    prior: float = 30.0
    """Standard deviation of the size of an event that is set aside, over the size found [1]; chosen: any size."""


LIMITS = EventLimits()


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
        if float(np.sum(added[of_ramp] ** 2)) < LIMITS.by_ramp * float(added @ added):
            found.append(np.inf)
            continue
        beside = Freedom(np.delete(slopes, own, axis=0))
        unexplained = beside.left(rest + added)
        gain = float(unexplained @ unexplained - rest @ rest)
        best = max(_events(fitting, whitening, unexplained, beside), key=lambda event: event.gain)
        further = max(own.stop - own.start - LIMITS.of_event, 0)
        if not fitted.effects[number].candidate.recipe.coefficients:
            found.append(gain - best.gain - LIMITS.parameter * further)
            continue
        # many coefficients may follow an event better than one step or bump does: it has all of its freedom then
        directions = beside.left(whitening(_directions(fitting, best)))
        left_by_event = Freedom(directions).left(unexplained)
        by_event = float(unexplained @ unexplained - left_by_event @ left_by_event)
        found.append(gain - by_event - LIMITS.parameter * (own.stop - own.start - len(directions)))
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
    """Return the events beside an explanation, each over the numbers' standard deviations and times its prior (k, n).

    Args:
        fitting: of the recording.
        fitted: the explanation, None for none.
        as_measured: whitening of what it leaves, nothing of which counts as unknown.
    """
    c = fitting.comparison
    residual = c.residual - (fitted.template if fitted is not None else 0.0)
    derivatives = fitting.slopes(fitted) if fitted is not None else np.zeros((0, len(residual)))
    found = np.zeros((0, len(residual)))
    for _ in range(LIMITS.most):
        whitening = as_measured.beside(found)
        beside = Freedom(whitening(derivatives))
        rest = beside.left(whitening(residual))
        each = list(_events(fitting, whitening, rest, beside))
        best = max(each, key=lambda event: event.gain)
        rows = np.isin(c.entries.station, list(best.channels)) & c.entries.where(kind='ramp')
        excess = float(rest[rows] @ rest[rows]) - np.count_nonzero(rest[rows])
        chance = len(each) * best.tried * stats.chi2.sf(best.gain, 1)
        if not (chance <= LIMITS.chance and best.gain >= LIMITS.worth * excess):
            break
        if best.gain < _gain_of_curve(fitting, whitening, rest, beside, best):
            break
        found = np.vstack([found, _directions(fitting, best)])
    return found


def _gain_of_curve(fitting: Fitting, whitening: Whitening, rest: np.ndarray, beside: Freedom, event: _Event) -> float:
    """Return the gain of a smooth curve of as many parameters in an event's place; arguments as of `_events`.

    A step explains three quarters of a slope.
    """
    c = fitting.comparison
    _, phases = ramp_of(c)
    place = np.linspace(-1.0, 1.0, len(event.shape))
    # each sweep has a level by itself, and its phase a slope
    first = 2 if next(iter(event.channels)) in phases else 1
    shapes = [np.polynomial.Legendre.basis(first + i)(place) for i in range(LIMITS.of_event)]
    curves = [over_sweep(c, shape, event.law, event.channels) for shape in shapes]
    own = np.array([beside.left(whitening(curve)) for curve in curves])
    along = own @ rest
    return float(along @ scaled_inverse(own @ own.T) @ along)


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
    least = LIMITS.clearly if further is None else float(np.sum(now)) - further.misfit + LIMITS.clearly
    explained = fitting.misfit(0.0) - fitted.misfit if fitted is not None else 0.0
    if gain < max(least, LIMITS.clearly, LIMITS.adequate * explained):
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
    about = [b for b in range(event.at - LIMITS.about, event.at + LIMITS.about + 1) if 0 <= b < count]
    ways = [
        (LIMITS.prior * event.shape, ones, event.channels),
        (later, ones, event.channels),
        (later, far, event.channels),
        (wider, ones, event.channels),
    ]
    own = phases if set(event.channels) <= set(phases) else list(event.channels)
    ways += [(np.eye(count)[b], along, {i: 1.0}) for b in about for along in (ones, far) for i in own]
    sized = [over_sweep(c, shape, event.size * event.law * along, channels) for shape, along, channels in ways]
    return np.concatenate([np.array(sized), _shifted_lines(fitting, event, phases), _earlier_end(fitting, event)])


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
    found[-1, c.rows(ends, event.losing)] = np.ravel(np.array([0.0, LIMITS.prior]) / c.std['ends'][:, event.losing])
    return found


def _shifted_lines(fitting: Fitting, event: _Event, phases: Sequence[int]) -> np.ndarray:
    """Return by how much an event of the phases may shift the lines of each sweep, each times its prior (k, n).

    A sweep's frequency follows a part of the event: a line through a step is steeper. How large a part depends on the
    estimator, so any is as likely, which has a mean square of a third. Of a pair, the sum of the phases shows it in the
    common part of the beat frequencies, the difference in the range; both phases are over sqrt(2).
    """
    c = fitting.comparison
    sweep, block = c.data.sweeps[0][0], np.arange(len(event.shape)) - 0.5 * (len(event.shape) - 1)
    turned = event.size * float(event.shape @ block / (block @ block)) / np.sqrt(3.0)  # [rad per block]
    hertz = turned / (2.0 * np.pi * float(c.time[1] - c.time[0]))
    metres = hertz * SPEED_OF_LIGHT / (2.0 * abs(sweep.chirp_rate))
    if len(phases) == 2:
        shifts = {'beat': hertz * np.sqrt(2.0), 'range': metres / np.sqrt(2.0)}
    else:
        shifts = {'range': metres}
    found = np.zeros((0, len(c.residual)))
    for name, channel in zip(shifts, phases, strict=False):
        kind = next((k for k in c.kinds if k.name == name), None)
        if kind is None or channel not in event.channels:
            continue
        shifted = np.zeros((1, len(c.residual)))
        shifted[0, c.rows(kind)] = shifts[name] * event.law / c.std[name]
        found = np.concatenate([found, shifted])
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
            gains = np.where(own > LIMITS.least_power * power, remains**2 / np.maximum(own, 1e-30), 0.0)
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
        lines = np.array([sweeps.line[:, number].mean() for sweeps in r.sweeps])
        settings = [r.data.sweeps[r.data.setting[rows[0]]][station] for rows in r.members]
        signs = np.array([sweep.line_sign() for sweep in settings])
        turns = lines / np.array([sweep.sample_rate for sweep in settings])
        laws.append((signs * lines / lines.mean(), number))
        for lost in range(2, LIMITS.lost + 1):
            whole = np.rint(lost * turns)
            if whole.any():
                laws.append((signs * (lost * turns - whole), number))
    return laws


def _shapes(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return steps, bumps and kinks over `count` blocks (M, count), their times and their onsets' widths [blocks]."""
    block = np.arange(count)
    at = np.arange(round(LIMITS.edge * count), round((1.0 - LIMITS.edge) * count))[:, None]
    found, widths = [np.maximum(block - at, 0.0) / count], [0.0]
    for width in LIMITS.widths:
        found.append(special.ndtr((block - at + 0.5) / max(width, 1e-3)))
        widths.append(width)
        if width <= LIMITS.longest:
            found.append(np.exp(-0.5 * ((block - at) / max(width, 0.5)) ** 2))
            widths.append(width)
    return np.concatenate(found), np.tile(at.ravel(), len(found)), np.repeat(widths, len(at))
