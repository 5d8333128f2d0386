"""Whether something else in the lines may be what the noise, the received power, the range or one bin alone shows.

In: an effect of an explanation and what the explanation leaves. Out: the rest of the line's amplitude, or of the phases
over the sweep, over the effect's change; how much of the noise repeats in each sweep, as what an event within the ramp
leaves beside the line does; how much is left at multiples of a line's frequency, and which lines are harmonics.
"""

import dataclasses
import itertools
import math

import numpy as np

from drfmcw_physics.constants import DECIBELS_PER_NEPER, SPEED_OF_LIGHT
from drfmcw_sim.effects import ActsOn

from ..search.fits.fitted import Fitted, FittedEffect
from ..search.fits.fitting import Fitting


@dataclasses.dataclass(frozen=True)
class ReceiverLimits:
    """Which effects the noise, the received power or one line in the spectrum alone shows, and where multiples are."""

    by_noise: float = 0.9  # share of an effect's power in the noise, from which on nothing else shows it [1]; chosen
    by_power: float = 0.9  # the same in the received power [1]; chosen
    by_line: float = 0.8  # the same in a few bins of the spectrum about its strongest one [1]; chosen
    about: int = 3  # such bins to either side; chosen: a Hann window's line
    multiples: int = 9  # highest multiple of a line's frequency that is looked at; chosen
    apart: float = 2.0  # bins by which a multiple may be apart from where it is looked for; chosen
    each: float = 0.15  # such bins for each multiple more; chosen: how well a line's place among the bins is known
    coincident: float = 0.2  # bins by which a harmonic may be apart from a multiple of its fundamental; chosen
    chance: float = 6.0  # standard deviations of chance above which something is left at multiples [1]; chosen


LIMITS = ReceiverLimits()


def of_level(fitting: Fitting, level: str) -> np.ndarray:
    """Return where the numbers of all kinds of a level stand."""
    return fitting.comparison.rows_of_kinds(lambda kind: kind.level == level)


def unexplained_signal(fitting: Fitting, effect: FittedEffect, rest: np.ndarray, added: np.ndarray) -> float:
    """Return the rest of a receiver's amplitude over an effect's change of the noise, both as rms in decibels.

    The larger one of the effect's receivers, 0 where not the noise shows it.

    Args:
        fitting: of the recording.
        effect: of the explanation.
        rest: what the explanation leaves, over standard deviations (n,).
        added: what the effect adds to it, likewise.
    """
    c = fitting.comparison
    if not _by_noise(fitting, effect, added):
        return 0.0
    found = 0.0
    for i in receivers_of(fitting, effect):
        changed = _mean_square(added[c.entries.where(kind='noise', station=i)], c.std.noise[:, i].ravel(), 0.0)
        level = _mean_square(rest[c.entries.where(kind='amplitude', station=i)], c.std.amplitude[:, i].ravel(), 1.0)
        left = max(level, 0.0) + max(_uneven_amplitude(fitting, rest, i), 0.0)
        found = max(found, math.sqrt(left / max(changed, 1e-30)))
    return found


def uneven_power(fitting: Fitting, effect: FittedEffect, rest: np.ndarray, added: np.ndarray) -> float:
    """Return the rest of the amplitude over the sweep over an effect's change of the power, both as rms in decibels.

    The larger one of the effect's receivers, 0 where not the received power shows it; arguments as above.
    """
    c = fitting.comparison
    of_power = added[of_level(fitting, 'amplitude')]
    if float(of_power @ of_power) < LIMITS.by_power * float(added @ added):
        return 0.0
    found = 0.0
    for i in receivers_of(fitting, effect):
        changed = _mean_square(added[c.entries.where(kind='amplitude', station=i)], c.std.amplitude[:, i].ravel(), 0.0)
        found = max(found, math.sqrt(max(_uneven_amplitude(fitting, rest, i), 0.0) / max(changed, 1e-30)))
    return found


def repeated_noise(fitting: Fitting, effect: FittedEffect, added: np.ndarray) -> float:
    """Return the share of what an effect adds to the noise that repeats in each sweep, beside the line.

    0 where not the noise shows it, or where it comes and goes.

    Args:
        fitting: of the recording.
        effect: of the explanation.
        added: what the effect adds, over standard deviations (n,).
    """
    if not _by_noise(fitting, effect, added):
        return 0.0
    c = fitting.comparison
    repeats, total = 0.0, 0.0
    for i in receivers_of(fitting, effect):
        rise = added[c.entries.where(kind='noise', station=i)].reshape(len(c.members), -1)
        std, noise = c.std.noise[:, i], c.measured.noise[:, i]
        ratio = 1.0 - 10.0 ** (-0.1 * rise * np.where(np.isfinite(std), std, 0.0))  # of the noise there, that it adds
        share = c.repeating[:, i]
        weight = np.where((rise > 0.0) & np.isfinite(noise) & np.isfinite(share), rise**2, 0.0)
        repeats += float(np.sum(weight * np.clip(np.nan_to_num(share) / np.maximum(ratio, 1e-6), 0.0, 1.0)))
        total += float(np.sum(weight))
    return repeats / total if total > 0.0 else 0.0


def left_at_multiples(fitting: Fitting, effect: FittedEffect, rest: np.ndarray, added: np.ndarray) -> float:
    """Return what is left of the spectrum at multiples of a line, or of which it is one, over what the line explains.

    What has a period has lines at all its multiples: none of them is a line of its own. 0 of what is no single line.

    Args:
        fitting: of the recording.
        effect: of the explanation.
        rest: what the explanation leaves, whitened (n,).
        added: what the effect adds to it, likewise.
    """
    c, line = fitting.comparison, _line(fitting, effect, added)
    if line is None:
        return 0.0
    multiples = _multiples(line.place, len(line.near)) & ~line.near
    left = rest[line.rows].reshape(len(c.members), -1)[:, multiples]
    count = np.count_nonzero(left)
    excess = float(np.sum(left**2)) - count - LIMITS.chance * math.sqrt(2.0 * count)
    return max(excess, 0.0) / float(added @ added)


def harmonics(fitting: Fitting, fitted: Fitted) -> list[bool]:
    """Return which effects are lines of one receiver of which one is a harmonic of another, stronger one.

    What has a period has them all, so neither is a line of its own. Lines that have nothing to do with each other
    stand so with a chance below one percent.

    Args:
        fitting: of the recording.
        fitted: the explanation.
    """
    pairs = zip(fitted.effects, fitting.added_alone(fitted), strict=True)
    lines = [_line(fitting, effect, added) for effect, added in pairs]
    found = [False] * len(lines)
    for (i, one), (j, other) in itertools.permutations(enumerate(lines), 2):
        if one is None or other is None or one.receiver != other.receiver or one.strength < other.strength:
            continue
        numbers = np.arange(2, LIMITS.multiples + 1)
        apart = np.abs(_folded(numbers * one.place, len(one.near)) - other.place)
        if np.any(apart < LIMITS.coincident):
            found[i] = found[j] = True
    return found


@dataclasses.dataclass(frozen=True)
class _Line:
    """A single line in the spectrum of B bins."""

    receiver: int
    rows: np.ndarray  # where the spectrum's numbers stand
    place: float  # [bins]
    near: np.ndarray  # bins that hold it (B,)
    strength: float  # the larger, the stronger


def _line(fitting: Fitting, effect: FittedEffect, added: np.ndarray) -> _Line | None:
    """Return the line that an effect is, None where it is none; arguments as of `left_at_multiples`."""
    c, total = fitting.comparison, float(added @ added)
    for kind in (k for k in c.kinds if k.sparse):
        for i in receivers_of(fitting, effect):
            rows = c.rows(kind, i)
            shown = np.abs(added[rows].reshape(len(c.members), -1))
            at, bins = int(np.argmax(np.sum(shown**2, axis=0))), np.arange(shown.shape[1])
            near = np.abs(bins - at) <= LIMITS.about
            if float(np.sum(shown[:, near] ** 2)) <= LIMITS.by_line * total:  # also where it adds nothing
                continue
            power = np.sum(shown[:, near] ** 3, axis=0)  # of which numbers are the cube root, as normals
            place = float(np.average(bins[near], weights=power))
            return _Line(i, rows, place, near, float(power.max()))
    return None


def _folded(place: np.ndarray | float, count: int) -> np.ndarray:
    """Return at which of a number of bins frequencies [bins] are sampled."""
    turned = place % (2.0 * (count - 1))
    return np.asarray(np.minimum(turned, 2.0 * (count - 1) - turned))


def _multiples(place: float, count: int) -> np.ndarray:
    """Return which of a number of bins lie at multiples of a place among them, folded, or at parts of it (B,)."""
    found = np.zeros(count, bool)
    for number in range(2, LIMITS.multiples + 1):
        for middle in (_folded(number * place, count), place / number):
            found |= np.abs(np.arange(count) - middle) <= LIMITS.apart + LIMITS.each * number
    return found


def unexplained_course(fitting: Fitting, rest: np.ndarray, added: np.ndarray, weight: np.ndarray) -> float:
    """Return by how much the rest of the phases over the sweep may shift the range, over an effect's change of it.

    Both as rms over the groups, by what the range is known to. A sweep's frequency follows a part of what bends its
    phase: of a straight line of as large a rms, which is the steepest, all.

    Args:
        fitting: of the recording.
        rest: what the explanation leaves, over standard deviations (n,).
        added: what the effect adds to it, likewise.
        weight: of such a rest: one over its rms by chance and by errors of the forward models (n,), 0 where it does
            not count.
    """
    c = fitting.comparison
    channel = c.recorded.phases[0]  # the sum, or the only one
    std = c.std.ramp[:, channel]
    scale = np.where(np.isfinite(std), std, 0.0)
    rows = c.entries.where(kind='ramp', station=channel)
    left, counted = (x[rows].reshape(std.shape) for x in (fitting.without_set_aside(rest), weight))
    usual = np.divide(1.0, counted**2, out=np.zeros_like(counted), where=counted > 0.0)
    left = np.where(counted > 0.0, left, 0.0)
    squares = np.sum((left**2 - usual) * scale**2, axis=1)
    by_chance = np.sqrt(2.0 * np.sum((usual * scale**2) ** 2, axis=1))  # chi-squared
    turned = np.sqrt(np.maximum(squares - by_chance, 0.0) / std.shape[1])  # rms [rad] (G,)
    band = abs(c.data.sweeps[0][0].chirp_rate) * float(c.time[-1] - c.time[0])
    shifted = turned * math.sqrt(12.0) * SPEED_OF_LIGHT / (2.0 * math.pi * band) / c.std.range
    change = added[of_level(fitting, 'range')]
    return float(np.linalg.norm(shifted) / max(float(np.linalg.norm(change)), 1e-30))


def _by_noise(fitting: Fitting, effect: FittedEffect, added: np.ndarray) -> bool:
    """Return whether the noise alone shows an effect, and that it neither comes and goes nor modulates the line."""
    kind = effect.candidate.kind
    if kind.bursts or kind.fluctuates:
        return False
    if kind.acts_on is ActsOn.NOISE:  # it raises lines in the spectrum as well
        return True
    noise = added[of_level(fitting, 'noise')]
    return float(noise @ noise) >= LIMITS.by_noise * float(added @ added)


def receivers_of(fitting: Fitting, effect: FittedEffect) -> list[int]:
    """Return the numbers of the stations with samples at which an effect may show."""
    receivers = fitting.comparison.receivers
    return [i for i, name in enumerate(receivers) if effect.candidate.station in ('', name)]


def _uneven_amplitude(fitting: Fitting, rest: np.ndarray, receiver: int) -> float:
    """Return the mean square of what is left (n,) of a receiver's amplitude over the sweep [dB^2]."""
    # the first channels of the ramp are the stations' log amplitudes, as orthonormal cosine series
    c = fitting.comparison
    std = c.std.ramp[:, receiver].ravel()
    return DECIBELS_PER_NEPER**2 * _mean_square(rest[c.entries.where(kind='ramp', station=receiver)], std, 1.0)


def _mean_square(values: np.ndarray, std: np.ndarray, chance: float) -> float:
    """Return the mean square of numbers that are known over their standard deviations, less that of chance."""
    used = np.isfinite(std)
    squares = (values[used] ** 2 - chance) * std[used] ** 2
    return float(np.sum(squares)) / max(int(np.count_nonzero(used)), 1)
