"""Courses over the sweep of one receiver's line, which have no name: its amplitude or its phase goes up and down.

In: an explanation. Out: by how much effects that show over the sweep alone gain beyond the best course in their place,
and the courses that are left beside it. An effect of a ramp shows in both lines, the other one a path delay later. What
only one receiver does to its own line, a clock of its converter that is pulled or an amplifier that sags, shows in one,
in each group alike or in proportion to the line's frequency. Two settlings, or a ripple, may imitate that. Where one
receiver alone is recorded, nothing separates them.
"""

import dataclasses
import itertools
import math
from collections.abc import Mapping

import numpy as np
from scipy import stats

from drfmcw_physics.constants import SPEED_OF_LIGHT

from ..compare.algebra import gain_of
from ..compare.comparison import Comparison
from ..compare.over_sweep import over_sweep, ramp_of
from .fits.fitted import Fitted, Freedom
from .fits.fitting import Fitting
from .fits.whitening import Whitening
from .limits import EVENTS


@dataclasses.dataclass(frozen=True)
class CourseLimits:
    """When a course is taken for the cause."""

    parameter: float = EVENTS.parameter
    """Gain that each term and each parameter must bring (Akaike 1974)."""

    beaten: float = -10.0
    """Gain of effects beyond that of a course in their place, below which they are in doubt: odds of 150 to 1;
    chosen."""

    worth: float = EVENTS.worth
    """Share of what is left of its channels that a course must explain to be set aside [1]; chosen, as of an event."""

    clearly: float = EVENTS.clearly
    """Gain by which it must exceed that of any ramp and of any event to be set aside [1]; chosen, as of an event."""

    law: float = 0.01
    """Share of its gain by which it must exceed that of a course of both lines [1]; chosen."""

    few: float = 0.005
    """Share of its gain by which it must exceed that of an event or of a smooth curve [1]; chosen: these have fewer
    parameters."""

    chance: float = EVENTS.chance
    """Chance of such a course above which it is not set aside [1]; chosen, as of an event."""

    most: int = 4
    """Courses that are set aside, at most: amplitude and phase of two receivers."""

    prior: float = EVENTS.prior
    """Standard deviation of a term that is set aside, over the rms size found [1]; chosen: any size."""


LIMITS = CourseLimits()


@dataclasses.dataclass(frozen=True)
class Law:
    """Where something without a name shows over the sweep, and how large in each group."""

    channels: Mapping[int, float]  # of the ramp, and their signs
    sizes: np.ndarray  # (G,)


def beyond_courses(fitting: Fitting, fitted: Fitted) -> list[float]:
    """Return by how much effects' gain exceeds that of the best course in their place, infinity where none compares.

    Each effect by itself, each two and all together are compared with a course: several may imitate one. What a course
    explains beside them counts for them.

    Args:
        fitting: of the recording.
        fitted: the explanation.
    """
    c, whitening = fitting.comparison, fitting.whitening
    found = [np.inf] * len(fitted.effects)
    of_ramp = c.entries.where(kind='ramp')
    added = [whitening(fitting.added_beside(fitted, number)) for number in range(len(found))]
    own = [i for i, x in enumerate(added) if float(np.sum(x[of_ramp] ** 2)) >= EVENTS.by_ramp * float(x @ x)]
    if not own or len(c.receivers) < 2:
        return found
    slopes = whitening(fitting.slopes(fitted))
    rest = whitening(c.residual - fitted.template)
    sets = {(*own,), *((i,) for i in own), *itertools.combinations(own, 2)} - {()}
    for numbers in sorted(sets):
        together = added[numbers[0]] if len(numbers) == 1 else whitening(fitting.added_beside(fitted, *numbers))
        spans = np.r_[tuple(fitted.spans[i] for i in numbers)]
        beside = Freedom(np.delete(slopes, spans, axis=0))
        left, unexplained = beside.left(rest), beside.left(rest + together)
        gain = float(unexplained @ unexplained - left @ left) - LIMITS.parameter * len(spans)
        (also, beside_them), (instead, in_their_place) = (_best(c, whitening, x) for x in (left, unexplained))
        beyond = gain + beside_them - in_their_place
        if beyond < LIMITS.beaten:  # terms follow what effects do, and the other way round
            beside_them = _joint(whitening, Freedom(slopes), rest, also)
            beyond = gain + beside_them - _joint(whitening, beside, unexplained, instead)
        for number in numbers:
            found[number] = min(found[number], beyond)
    return found


def _best(c: Comparison, whitening: Whitening, rest: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the terms that are worth it of the best course in a whitened rest (n,), and its worth.

    The terms are of one unit each, over the numbers' standard deviations (k, n).
    """
    tried = [(law, _fitted(c, whitening, rest, law)[1]) for law in _laws(c)]
    law, gains = max(tried, key=lambda one: _worth(one[1]))
    return _units(c, law)[gains > LIMITS.parameter], _worth(gains)


def _joint(whitening: Whitening, beside: Freedom, rest: np.ndarray, terms: np.ndarray) -> float:
    """Return the worth of terms (k, n) together with the freedom of effects; arguments as of `left`."""
    return gain_of(beside.left(whitening(terms)), rest) - LIMITS.parameter * len(terms) if len(terms) else 0.0


def left(fitting: Fitting, whitening: Whitening, rest: np.ndarray, beside: Freedom, by_event: float) -> np.ndarray:
    """Return the courses that are left beside an explanation, over the numbers' standard deviations (k, n).

    Each term of each is times its prior.

    Args:
        fitting: of the recording.
        whitening: of numbers.
        rest: what the explanation leaves, beyond what its parameters can follow, whitened (n,).
        beside: the freedom of these.
        by_event: gain of the best event, with all that is unknown of it.
    """
    c = fitting.comparison
    found = np.zeros((0, len(c.residual)))
    if len(c.receivers) < 2:
        return found
    for _ in range(LIMITS.most):
        tried = [(law, *_fitted(c, whitening, rest, law)) for law in _laws(c)]
        law, sizes, gains = max(tried, key=lambda one: _worth(one[2]))
        total = float(gains.sum())
        rows = c.entries.where(kind='ramp') & np.isin(c.entries.station, list(law.channels))
        excess = float(rest[rows] @ rest[rows]) - np.count_nonzero(rest[rows])
        both = max(_worth(_fitted(c, whitening, rest, other)[1]) for other in _of_both(c, law))
        few = max(gain_of_curve(fitting, whitening, rest, beside, law), 0.0 if len(found) else by_event)
        beyond = _worth(gains) - max(both + LIMITS.law * total, few + LIMITS.few * total)
        chance = len(tried) * stats.chi2.sf(total, np.count_nonzero(gains))
        if beyond < LIMITS.clearly or total < LIMITS.worth * excess or chance > LIMITS.chance:
            break
        units = _units(c, law)
        # a straight line, which each sweep has by itself, may be as large a part of it as all others
        tilt = math.sqrt(12.0 * float(np.mean(sizes**2))) / len(sizes)
        terms = LIMITS.prior * (sizes[:, None] * units)[gains > LIMITS.parameter]
        found = np.concatenate([found, terms, shifted_lines(c, tilt, law)])
        rest = rest - whitening(sizes @ units)
    return found


def gain_of_curve(fitting: Fitting, whitening: Whitening, rest: np.ndarray, beside: Freedom, law: Law) -> float:
    """Return the gain of a smooth curve of two parameters in the place of something else.

    Args:
        fitting: of the recording.
        whitening: of numbers.
        rest: what the explanation leaves, beyond what its parameters can follow, whitened (n,).
        beside: the freedom of these.
        law: by which the curve shows.
    """
    c = fitting.comparison
    _, phases = ramp_of(c)
    place = np.linspace(-1.0, 1.0, c.std['ramp'].shape[-1])
    # each sweep has a level by itself, and its phase a slope
    first = 2 if next(iter(law.channels)) in phases else 1
    shapes = (np.polynomial.Legendre.basis(first + i)(place) for i in range(2))
    curves = np.array([over_sweep(c, shape, law.sizes, law.channels) for shape in shapes])
    return gain_of(beside.left(whitening(curves)), rest)


def shifted_lines(c: Comparison, turned: float, law: Law) -> np.ndarray:
    """Return by how much something of the phases may shift the lines of each sweep, over standard deviations (k, n).

    Of a pair, the sum of the phases shows it in the common part of the beat frequencies, the difference in the range;
    both phases are over sqrt(2).

    Args:
        c: the recording and its model.
        turned: by which it may tilt the phases over the sweep [rad per block].
        law: by which it shows.
    """
    _, phases = ramp_of(c)
    sweep = c.data.sweeps[0][0]
    hertz = turned / (2.0 * np.pi * float(c.time[1] - c.time[0]))
    metres = hertz * SPEED_OF_LIGHT / (2.0 * abs(sweep.chirp_rate))
    if len(phases) == 2:
        shifts = {'beat': hertz * np.sqrt(2.0), 'range': metres / np.sqrt(2.0)}
    else:
        shifts = {'range': metres}
    found = np.zeros((0, len(c.residual)))
    for name, channel in zip(shifts, phases, strict=False):
        kind = next((k for k in c.kinds if k.name == name), None)
        if kind is None or channel not in law.channels:
            continue
        shifted = np.zeros((1, len(c.residual)))
        shifted[0, c.rows(kind)] = shifts[name] * law.sizes / c.std[name]
        found = np.concatenate([found, shifted])
    return found


def _worth(gains: np.ndarray) -> float:
    """Return the gain of a course of as many terms as are worth it (K,), less what these cost."""
    return float(np.sum(np.maximum(gains - LIMITS.parameter, 0.0)))


def _laws(c: Comparison) -> list[Law]:
    """Return the courses that one receiver's line may have: of its amplitude, and of its phase by either law."""
    _, phases = ramp_of(c)
    found = []
    for number in range(len(c.receivers)):
        alike = np.ones(len(c.members))
        found.append(Law({number: 1.0}, alike))
        of_phase = {phases[0]: 1.0} | {channel: 1.0 - 2.0 * number for channel in phases[1:]}
        frequency = by_frequency(c, number)
        found += [Law(of_phase, alike), Law(of_phase, frequency / np.abs(frequency).mean())]
    return found


def _of_both(c: Comparison, law: Law) -> list[Law]:
    """Return the courses of the same quantity that both lines have, alike in all groups.

    Ramps of any shape make one of the difference of a pair's phases, second paths one of their sum, and one of both
    amplitudes.
    """
    _, phases = ramp_of(c)
    alike = np.ones(len(c.members))
    if set(law.channels) <= set(phases):
        return [Law({channel: 1.0}, alike) for channel in phases]
    return [Law(dict.fromkeys(range(len(c.receivers)), 1.0), alike)]


def by_frequency(c: Comparison, number: int) -> np.ndarray:
    """Return the frequency of a receiver's line in each group, with the sign by which its phase counts (G,) [Hz]."""
    r = c.recorded
    lines = np.array([sweeps.line[:, number].mean() for sweeps in r.sweeps])
    signs = np.array([r.data.sweeps[r.data.setting[rows[0]]][r.heard[number]].line_sign() for rows in r.members])
    frequency: np.ndarray = signs * lines
    return frequency


def _units(c: Comparison, law: Law) -> np.ndarray:
    """Return one unit of each term of a course, over the numbers' standard deviations (K, n)."""
    ramp, _ = ramp_of(c)
    found = np.zeros((c.std['ramp'].shape[-1], len(c.residual)))
    for channel, factor in law.channels.items():
        rows = c.rows(ramp, channel)
        found[c.entries.position[rows], rows] = np.ravel(factor * law.sizes[:, None] / c.std['ramp'][:, channel])
    return found


def _fitted(c: Comparison, whitening: Whitening, rest: np.ndarray, law: Law) -> tuple[np.ndarray, np.ndarray]:
    """Return the size of each term of a course that fits a whitened rest (n,) best, and what it explains (K,)."""
    ramp, _ = ramp_of(c)
    along, power = np.zeros((2, c.std['ramp'].shape[-1]))
    for channel, factor in law.channels.items():
        rows, std = c.rows(ramp, channel), c.std['ramp'][:, channel]
        unit = factor * law.sizes[:, None] * whitening.weight[rows].reshape(std.shape) / std
        along += np.sum(rest[rows].reshape(std.shape) * unit, axis=0)
        power += np.sum(unit**2, axis=0)
    sizes = along / np.maximum(power, 1e-30)
    return sizes, sizes * along
