"""Curves and steps without a name in range and beat frequency, over distance, time, temperature or speed.

In: an explanation. Out: of each effect that shows there alone, what a freer curve of the same condition explains beside
it, and by how much it explains more than a step over any condition in its place. A bent rail resembles a scale, a
crystal that jumps resembles several drifts, what follows a temperature late resembles what follows it at once: such an
effect is in doubt.
"""

import dataclasses
import itertools
from collections.abc import Collection

import numpy as np
from scipy import stats

from drfmcw_sim.effects import ActsOn, Effect, Stated

from ..compare.algebra import gain_of, sizes_of
from ..compare.kinds import Kind
from ..recording.dataset import Dataset
from ..search.fits.fitted import Fitted, Freedom
from ..search.fits.fitting import Fitting
from ..search.fits.whitening import Whitening
from ..search.path_sets import LIMITS as PATH
from ..search.search import Search
from ..search.starts.bank import Candidate, recipes


@dataclasses.dataclass(frozen=True)
class CurveLimits:
    """When a curve or a step is taken for the cause."""

    degrees: tuple[int, ...] = (0, 2, 3)
    """Degrees of the freer curve beside a slope; chosen: of a rail that bends, no constant need be known."""

    cubic: tuple[int, ...] = (0, 1, 2, 3)
    """Degrees of a curve that is set aside, or that follows an effect of one condition; chosen."""

    lags: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.5)
    """Time constants with which something may follow a temperature, over the recording's length [1]; chosen."""

    longest: float = 1.5
    """Period of a wave over the time, over the recording's length [1], at most; chosen: a longer one is a curve."""

    fastest: float = 2.5
    """Mean distance in time of two groups of sweeps over which its period is, at least [1]; chosen: Nyquist's 2."""

    per_wave: int = 4
    """Periods that are tried for each wave more or less in the recording; chosen."""

    of_condition: float = 0.995
    """Share of an effect's squares that a cubic curve of a condition follows, from which on it is one; chosen."""

    chance: float = 1e-3
    """Of what the freer curve explains, above which it is no evidence; chosen."""

    nearly_best: float = 0.5
    """Of what the best condition's curve explains, from which on another condition may as well be the cause; chosen."""

    by_path: float = 0.3
    """Share of an effect's power in range and beat frequency, above which a step may stand for it [1]; chosen."""

    parameter: float = 2.0
    """Gain that each parameter must bring (Akaike 1974)."""

    worth: float = 0.6
    """Share of what is left of a kind of number that a curve must explain to be set aside [1]; chosen."""

    unlikely: float = 1e-6
    """Chance of a curve above which it is not set aside [1]; chosen."""

    clearly: float = 30.0
    """Gain by which a curve must exceed that of any effect to be set aside [1]; chosen."""

    prior: float = 3.0
    """Standard deviation of a curve's coefficients that is set aside, over those found [1]; chosen: what is far larger
    is no part of it."""

    beaten: float = 0.0
    """By how much an effect's gain must exceed that of a step in its place, at least [1]; chosen."""

    least_power: float = 0.1
    """Share of a step's power that the other effects must leave of it [1]; chosen."""

    needed: float = 0.9
    """Share of its gain that an effect keeps beside a step, from which on the step is of something else [1]; chosen."""


LIMITS = CurveLimits()


def conditions(fitting: Fitting) -> dict[str, np.ndarray]:
    """Return what may change from group to group, those that do: by name, in each group (G,)."""
    c, data = fitting.comparison, fitting.comparison.data

    def mean(values: np.ndarray) -> np.ndarray:
        return np.array([float(np.mean(values[m])) for m in c.members])

    found = {'distance': c.recorded.distance, 'time': mean(data.time)}
    if not c.standing.all():
        found['speed'] = c.slope
    found |= {name: mean(temperature) for name, temperature in _temperatures(data).items()}
    return {name: x for name, x in found.items() if np.isfinite(x).all() and np.ptp(x) > 0.0}


def _temperatures(data: Dataset) -> dict[str, np.ndarray]:
    """Return the temperatures of a recording by the names of conditions, in each sweep (n,) [degC]."""
    return {'air': data.temperature} | {f'board {i}': board for i, board in enumerate(data.board_temperature)}


def _leads(fitting: Fitting, names: Collection[str]) -> dict[str, np.ndarray]:
    """Return by how much temperatures lead what follows them with time constants (T,): by condition, (T, G) [K].

    Args:
        fitting: of the recording.
        names: of the conditions wanted, whether temperatures or not.
    """
    c, data = fitting.comparison, fitting.comparison.data
    order = np.argsort(data.time)
    steps = np.diff(data.time[order])
    constants = np.array(LIMITS.lags) * max(float(np.ptp(data.time)), 1e-9)
    kept = np.exp(-steps[:, None] / constants)
    found = {}
    for name, temperature in _temperatures(data).items():
        if name not in names:
            continue
        course = temperature[order]
        follows = np.empty((len(course), len(constants)))
        follows[0] = course[0]
        for n, share in enumerate(kept):
            follows[n + 1] = share * follows[n] + (1.0 - share) * course[n + 1]
        ahead = np.empty_like(follows)
        ahead[order] = course[:, None] - follows
        found[name] = np.array([ahead[m].mean(axis=0) for m in c.members]).T
    return found


def bent(
    fitting: Fitting, fitted: Fitted, slopes: np.ndarray, rest: np.ndarray, as_it_is: Whitening
) -> list[float | None]:
    """Return of each effect what a freer curve of its own condition explains of the range's error beside it.

    Of a temperature also what follows it late, if that explains more than a curve of any condition: also of what such
    a curve, set aside, stands for. None where an effect depends on no condition alone, or is no effect on the range
    alone. Zero where chance explains as much, or where a curve of another condition explains far more.

    Args:
        fitting: of the recording.
        fitted: the explanation.
        slopes: of its parameters, whitened (P, n).
        rest: what it leaves, whitened (n,).
        as_it_is: whitening of what is measured, nothing of which counts as unknown.
    """
    c = fitting.comparison
    over = conditions(fitting)
    kind = next(k for k in c.kinds if k.name == 'range')
    curves = {name: _curves(fitting, kind, x, LIMITS.degrees) for name, x in over.items()}
    leads = {name: _in_numbers(fitting, kind, x) for name, x in _leads(fitting, over).items()}

    def gained(whitening: Whitening, beside: Freedom, rest: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
        """Return what curves of each condition explain of the range's error, and what follows each temperature late."""
        at_once = {name: gain_of(beside.left(whitening(shapes)), rest) for name, shapes in curves.items()}
        apart = {name: beside.left(whitening(shapes)) for name, shapes in leads.items()}
        return at_once, {name: max(gain_of(one[None], rest) for one in shapes) for name, shapes in apart.items()}

    gains, late = gained(fitting.whitening, Freedom(slopes), rest)
    most = max(gains.values(), default=0.0)
    if len(fitting.set_aside):
        beside = Freedom(as_it_is(fitting.slopes(fitted)))
        at_once, as_late = gained(as_it_is, beside, as_it_is(c.residual - fitted.template))
        late |= {name: gain for name, gain in as_late.items() if gain > max(at_once.values())}
    found: list[float | None] = []
    for effect in fitted.effects:
        added = c.predict((effect.build(),)).range - c.plain.range  # in each group (G,) [m]
        own = [name for name, x in over.items() if _follows(added, x)]
        if not own:
            found.append(None)
            continue
        gain = max(gains[name] for name in own)
        by_chance = float(stats.chi2.sf(gain, len(LIMITS.degrees))) > LIMITS.chance
        curve = 0.0 if by_chance or gain < LIMITS.nearly_best * most else gain
        later = max((late[name] for name in own if name in late), default=0.0)
        unlikely = len(LIMITS.lags) * float(stats.chi2.sf(later, 1)) < LIMITS.chance
        found.append(max(curve, later) if unlikely and later > most else curve)
    return found


def left(search: Search, fitted: Fitted | None, as_measured: Whitening) -> np.ndarray:
    """Return curves and steps over a condition beside an explanation that no effect describes, times priors (k, n).

    Args:
        search: of the recording.
        fitted: the explanation, None for none.
        as_measured: whitening of what it leaves, nothing of which counts as unknown.
    """
    c = search.comparison
    residual = c.residual - (fitted.template if fitted is not None else 0.0)
    rest = as_measured(residual)
    beside = Freedom(as_measured(search.slopes(fitted)) if fitted is not None else np.zeros((0, len(rest))))
    found = np.zeros((0, len(rest)))
    named = -1.0
    for kind in (k for k in c.kinds if k.name in PATH.kinds):
        rows = c.rows(kind)
        excess = float(rest[rows] @ rest[rows]) - len(rows)
        if excess < LIMITS.clearly:
            continue
        curves = (_curves(search, kind, x, LIMITS.cubic) for x in conditions(search).values())
        best = max((_fitted(x, rest, as_measured, beside) for x in curves), key=lambda one: one.gain, default=None)
        step = _best_step(search, kind, rest, as_measured, beside)
        wave = _best_wave(search, kind, rest, as_measured, beside)
        best = max((x for x in (best, step, wave) if x is not None), key=lambda one: one.worth, default=None)
        if best is None or best.gain < LIMITS.worth * excess or best.chance > LIMITS.unlikely:
            continue
        if named < 0.0:  # what the best effect would explain, of these numbers and of all others
            named = search.most_by_one(fitted, as_measured, rest, scanned=False)
        if named < best.gain - LIMITS.clearly:
            found = np.concatenate([found, LIMITS.prior * best.size * best.shapes])
    return found


@dataclasses.dataclass(frozen=True)
class _Unnamed:
    """Shapes without a name that fit what is left."""

    shapes: np.ndarray  # over the numbers' standard deviations (k, n)
    gain: float
    size: float  # of the largest
    chance: float  # of as large a gain

    @property
    def worth(self) -> float:
        """Gain less what the sizes cost."""
        return self.gain - LIMITS.parameter * len(self.shapes)


def _fitted(shapes: np.ndarray, rest: np.ndarray, as_measured: Whitening, beside: Freedom) -> _Unnamed:
    """Return how shapes (k, n) fit what is left (n,) beside an explanation's freedom."""
    followed = beside.left(as_measured(shapes))
    sizes = sizes_of(followed, rest)
    gain = float(sizes @ (followed @ rest))
    return _Unnamed(shapes, gain, float(np.abs(sizes).max()), float(stats.chi2.sf(gain, len(shapes))))


def _best_step(
    search: Search, kind: Kind, rest: np.ndarray, as_measured: Whitening, beside: Freedom
) -> _Unnamed | None:
    """Return the best step over a condition, None without conditions: in one kind of number, or of a clock.

    A clock's error shows in more than one kind: it is tried with that which shows most of it.
    """
    c = search.comparison
    steps, group, rows = _steps(search), c.entries.group, c.rows(kind)
    of_path = c.entries.where(kind=PATH.kinds)
    clocks = [x for x in _of_clocks(search) if float(x[rows] @ x[rows]) > 0.5 * float(x[of_path] @ x[of_path])]
    best = None
    for shape in (_alike(search, kind), *clocks):
        tried = steps[:, group] * shape
        followed = beside.left(as_measured(tried))
        power = np.einsum('mn,mn->m', followed, followed)
        gains = (followed @ rest) ** 2 / np.maximum(power, 1e-30)
        if len(gains) and (best is None or gains.max() > best.gain):
            one = _fitted(tried[[int(np.argmax(gains))]], rest, as_measured, beside)
            best = dataclasses.replace(one, chance=one.chance * len(gains))
    return best


def _best_wave(
    search: Search, kind: Kind, rest: np.ndarray, as_measured: Whitening, beside: Freedom
) -> _Unnamed | None:
    """Return the best wave over the time, of any period and phase, None where groups are too few to show one."""
    time = conditions(search).get('time')
    if time is None:
        return None
    length = float(np.ptp(time))
    most = (len(time) - 1) / LIMITS.fastest  # waves in the recording
    best = None
    waves = np.arange(1.0 / LIMITS.longest, most, 1.0 / LIMITS.per_wave)
    for number in waves:
        turn = 2.0 * np.pi * number * (time - time.min()) / length
        wave = _in_numbers(search, kind, np.stack([np.cos(turn), np.sin(turn)]))
        one = _fitted(wave, rest, as_measured, beside)
        if best is None or one.gain > best.gain:
            best = one
    return best and dataclasses.replace(best, chance=best.chance * len(waves))


def _curves(fitting: Fitting, kind: Kind, x: np.ndarray, degrees: tuple[int, ...]) -> np.ndarray:
    """Return polynomials of a condition (G,) in the numbers of one kind, over their standard deviations (k, n)."""
    scaled = 2.0 * (x - x.min()) / np.ptp(x) - 1.0
    return _in_numbers(fitting, kind, np.stack([np.polynomial.Chebyshev.basis(n)(scaled) for n in degrees]))


def _in_numbers(fitting: Fitting, kind: Kind, values: np.ndarray) -> np.ndarray:
    """Return values of each group (k, G) in the numbers of one kind, over their standard deviations (k, n)."""
    c = fitting.comparison
    rows = c.rows(kind)
    found = np.zeros((len(values), len(c.residual)))
    found[:, rows] = values[:, c.entries.group[rows]] / np.asarray(c.std[kind.name]).ravel()
    return found


def _follows(values: np.ndarray, x: np.ndarray) -> bool:
    """Return whether values follow a cubic curve of a condition, and are no constant."""
    if len(x) <= 5 or np.ptp(values) < 1e-9 * max(float(np.abs(values).max()), 1e-30):
        return False
    scaled = 2.0 * (x - x.min()) / np.ptp(x) - 1.0
    basis = np.polynomial.chebyshev.chebvander(scaled, 3)
    left = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    about = values - values.mean()
    return float(left @ left) < (1.0 - LIMITS.of_condition) * float(about @ about)


def beyond_steps(fitting: Fitting, fitted: Fitted) -> list[float]:
    """Return by how much each effect's gain exceeds that of the best step in its place, less what parameters cost.

    Infinity for effects that show elsewhere. A step is at one value of a condition: in range and beat frequency, of
    free sizes, or of a station's clock. How many steps are tried counts against it. Two effects may imitate one step
    together, so it is tried in the place of each two as well. A step of something else, beside which they are needed
    as much as without it, may explain more than they do: it is there beside either.

    Args:
        fitting: of the recording.
        fitted: the explanation.
    """
    c, whitening = fitting.comparison, fitting.whitening
    slopes = whitening(fitting.slopes(fitted))
    rest = whitening(c.residual - fitted.template)
    of_path = c.entries.where(kind=PATH.kinds)
    tried = _steps(fitting)
    found = [np.inf] * len(fitted.effects)

    def added_by(numbers: tuple[int, ...]) -> np.ndarray | None:
        """Return what effects add, whitened (n,); None where they show elsewhere than a step does."""
        added = whitening(fitting.added_beside(fitted, *numbers))
        of_clock = all(fitted.effects[i].candidate.kind.acts_on is ActsOn.CLOCK for i in numbers)
        by_path = float(np.sum(added[of_path] ** 2)) >= LIMITS.by_path * float(added @ added)
        return added if of_clock or by_path else None

    singly = [(i,) for i in range(len(found)) if added_by((i,)) is not None]
    if not singly or not len(tried):
        return found
    steps = _templates(fitting, tried)
    power = np.einsum('kmn,kmn->km', steps, steps)
    for numbers in (*singly, *((i, j) for (i,), (j,) in itertools.combinations(singly, 2))):
        added = added_by(numbers)
        if added is None:
            continue
        own = np.r_[tuple(fitted.spans[i] for i in numbers)]
        beside = Freedom(np.delete(slopes, own, axis=0))
        left_over, shown, seen = beside.left(rest), beside.left(added), beside.left(steps)
        other = Freedom(_of_something_else(seen, power, left_over + shown, shown))
        left_over, unexplained, seen = other.left(left_over), other.left(left_over + shown), other.left(seen)
        gain = float(unexplained @ unexplained - left_over @ left_over) - LIMITS.parameter * len(own)
        beyond = gain - (_best(seen, power, unexplained) - 2.0 * np.log(len(tried)))
        for number in numbers:
            found[number] = min(found[number], beyond)
    return found


def _steps(fitting: Fitting) -> np.ndarray:
    """Return distinct steps from group to group over any condition (M, G)."""
    found = {tuple((x > at).tolist()) for x in conditions(fitting).values() for at in np.unique(x)[:-1]}
    return np.array(sorted(found), float).reshape(len(found), len(fitting.comparison.members))


def _templates(fitting: Fitting, tried: np.ndarray) -> np.ndarray:
    """Return steps (M, G), whitened (J, M, n): of range and beat frequency each by itself, then of each clock."""
    c = fitting.comparison
    alike = [_alike(fitting, kind) for kind in c.kinds if kind.name in PATH.kinds] + _of_clocks(fitting)
    return fitting.whitening(tried[:, c.entries.group] * np.array(alike)[:, None])


def _alike(fitting: Fitting, kind: Kind) -> np.ndarray:
    """Return a change of all numbers of a kind by one unit, over their standard deviations (n,)."""
    c = fitting.comparison
    own = np.zeros(len(c.residual))
    own[c.rows(kind)] = 1.0 / np.asarray(c.std[kind.name]).ravel()
    return own


def _of_clocks(fitting: Fitting) -> list[np.ndarray]:
    """Return what an error of each clock changes, over the numbers' standard deviations (n,)."""
    c = fitting.comparison
    return [
        c.template((Candidate(effect, station, recipe, dict(recipe.start)).build(),))
        for effect, recipe in recipes()
        if Effect.registry[effect].error_of is Stated.CLOCK
        for station in c.data.stations
    ]


def _of_something_else(steps: np.ndarray, power: np.ndarray, unexplained: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return the step that explains most of what effects are needed beside (1, n); none, (0, n), of less than they do.

    Args:
        steps: what the other effects leave of them, whitened (J, M, n), see `_templates`.
        power: of the whole steps (J, M).
        unexplained: by the other effects, whitened (n,).
        shown: what these leave of what the effects in question add, whitened (n,).
    """
    own = np.einsum('kmn,kmn->km', steps, steps)
    length = np.sqrt(np.where(own > LIMITS.least_power * power, own, np.inf))
    along, shared = (steps @ unexplained) / length, (steps @ shown) / length
    explained, size = float(shown @ unexplained), max(float(shown @ shown), 1e-30)
    gain = explained**2 / size
    beside_step = np.maximum(explained - shared * along, 0.0) ** 2 / np.maximum(size - shared**2, 1e-9 * size)
    gains = np.where(beside_step >= LIMITS.needed * gain, along**2, 0.0)
    best = np.unravel_index(int(np.argmax(gains)), gains.shape)
    return steps[best][None] if gains[best] > gain else steps[0, :0]


def _best(steps: np.ndarray, whole: np.ndarray, unexplained: np.ndarray) -> float:
    """Return the largest gain of a step of one kind, or in range and beat frequency, less what its parameters cost.

    Args:
        steps: what the other effects leave of them, whitened (J, M, n), see `_templates`.
        whole: power of the whole steps (J, M).
        unexplained: by the other effects, whitened (n,).
    """
    power = np.einsum('kmn,kmn->km', steps, steps)
    seen = power > LIMITS.least_power * whole
    along = np.where(seen, steps @ unexplained, 0.0)
    alone = along**2 / np.maximum(power, 1e-30)  # (J, M)
    # the step's place and its size in each kind
    single = float(alone.max()) - 2.0 * LIMITS.parameter
    cross = np.einsum('mn,mn->m', steps[0], steps[1])
    determinant = np.maximum(power[0] * power[1] - cross**2, 1e-9 * power[0] * power[1] + 1e-30)
    both = (power[1] * along[0] ** 2 - 2.0 * cross * along[0] * along[1] + power[0] * along[1] ** 2) / determinant
    return max(single, float(np.where(seen[:2].all(axis=0), both, 0.0).max()) - 3.0 * LIMITS.parameter)
