"""Which effects of the registry, with the lines on which they act, describe what is held out beyond chance."""

import dataclasses
import math
from collections.abc import Collection

import numpy as np
from scipy.interpolate import BSpline

from drfmcw_physics.settings import declared_parameters
from drfmcw_sim.effects import ActsOn, Effect, Of, Recipe

from ...search.starts.bank import Candidate, recipes
from .agreement import agreement
from .joint import Fitted, bounds_of, curve, fit, heard_by, judged, modelled, simulated, with_lines
from .limits import NAMING, WARPS
from .misfit import Misfit, bounded, of_sweeps
from .model import Scene, Straight
from .tracks import Sweeps, Tracks, lines, slopes, solve
from .warps import Start, resampled, starting_values, starts


@dataclasses.dataclass(frozen=True)
class Named:
    """Effects that describe what is held out better than lines alone, beyond chance."""

    fitted: Fitted
    gains: tuple[float, ...]  # of each effect, of the logarithm of the likelihood of what is held out
    chances: tuple[float, ...]  # of gains as large
    inside: Misfit
    outside: Misfit
    rivals: tuple[tuple[Fitted, float], ...]  # others in place of the last effect, and by how much less likely


def searched(without: Collection[str] = ()) -> list[str]:
    """Return the effects that are searched for here."""
    return sorted({name for name, r in recipes(without) if _tried(Effect.registry[name], r)})


def _tried(kind: type[Effect], recipe: Recipe) -> bool:
    if kind.of is not Of.STATION or kind.bursts or kind.fluctuates or recipe.per_group or recipe.each_sweep:
        return False
    if kind.shapes_chirp:
        return bool(recipe.coefficients) or recipe.scan in ('', 'ripple')
    if ActsOn.SAMPLES in kind.acts_on:
        return not kind.evidence and (bool(recipe.size) and not recipe.scan or kind.distorts)
    return ActsOn.AMPLITUDE in kind.acts_on and bool(recipe.size) and bool(kind.evidence)


def named(found: Straight, accepted: float, without: Collection[str] = ()) -> Named | None:
    """Return the effects that the sweeps demand, None where none is beyond chance.

    Kinds are compared on some of the sweeps that are fitted; the best ones are fitted to all of them and tried on what
    is held out. There they must have a likelihood above that of lines alone by more than chance: the inverse of the
    likelihood's ratio bounds it, once for each kind that was tried there. What bends the ramp must have one size by
    all lines; what has not several lines to show that, and a free curve, must leave half of the excess misfit and less.
    """
    s = found.scene
    best: Named | None = None
    current = Fitted(found.tracks, (), found.fitted.per_freedom)
    misfit, extra = found.held_out, len(found.tracks)
    while len(current.candidates) < NAMING.effects:
        chosen = _best(s, current, without)
        if not chosen:
            break
        standing = [x for x in ((x, *judged(s, x)) for x in chosen) if _stands(s, x[0], x[2], misfit, accepted)]
        # what leaves noise alone comes first
        standing.sort(key=lambda x: (x[2].probability < accepted, _score(x[2], len(x[0].tracks), s)))
        if not standing:
            break
        first, inside, outside = standing[0]
        gain = 0.5 * (_score(misfit, extra, s) - _score(outside, len(first.tracks), s))
        chance = min(1.0, len(chosen) * bounded(gain))
        passing = outside.probability >= accepted
        if chance >= accepted or (best is not None and not passing):
            break
        worse = [
            (x, 0.5 * (_score(other, len(x.tracks), s) - _score(outside, len(first.tracks), s)))
            for x, _, other in standing[1:]
        ]
        rivals = tuple((x, loss) for x, loss in worse if loss < NAMING.rival and _free(x) <= _free(first))
        gains = (*(best.gains if best else ()), gain)
        best = Named(first, gains, (*(best.chances if best else ()), chance), inside, outside, rivals)
        current, misfit, extra = first, outside, len(first.tracks)
        if passing:
            break
    return best


def _stands(s: Scene, x: Fitted, outside: Misfit, before: Misfit, accepted: float) -> bool:
    """Return whether an effect stands by itself, whatever else the sweeps hold."""
    if any(_at_bound(s, x.candidates[-1], name) for name in x.candidates[-1].free):
        return False
    excess = max(before.per_freedom - 1.0, 0.0)
    halved = outside.per_freedom - 1.0 < NAMING.halved * excess
    sizes = agreement(s, x)
    if sizes is not None and (sizes.testable or s.moving):
        free_curve = bool(x.candidates[-1].recipe.coefficients) and s.moving
        return sizes.agrees and (halved or not free_curve)
    return halved or (outside.probability >= accepted and not s.moving)


def _at_bound(s: Scene, candidate: Candidate, name: str) -> bool:
    """Return whether a fit ended where a parameter may not go further; angles go round."""
    if declared_parameters(candidate.kind)[name.partition('[')[0]][1].unit == 'rad':
        return False
    low, high = bounds_of(s, candidate, name)
    value = candidate.values[name]
    near = NAMING.edge * abs(value)
    return not low + near < value < high - near


def _halved(x: Fitted, plain: Fitted) -> bool:
    """Return whether effects halve the excess misfit of lines alone, or take the place of some of them."""
    return len(x.tracks) < len(plain.tracks) or x.misfit - 1.0 < NAMING.halved * (plain.misfit - 1.0)


def _matters(s: Scene, some: Sweeps, x: Fitted) -> bool:
    """Return whether as many lines describe less without the last effect: not what only moves lines."""
    order = x.tracks.frequency.shape[1]
    empty = Fitted(Tracks(np.zeros((0, order))), x.candidates[:-1], np.inf)
    again = with_lines(s, some, empty, len(x.tracks))
    without = fit(s, some, again.tracks, again.candidates, NAMING.rounds)
    return float(some.used.sum()) * math.log(without.misfit / x.misfit) > 2.0 * NAMING.gain * len(x.candidates[-1].free)


def _free(x: Fitted) -> int:
    """Return how many parameters effects have: a curve with more of them always describes as much."""
    return sum(len(c.free) for c in x.candidates)


def _score(misfit: Misfit, lines_: int, s: Scene) -> float:
    """Return minus twice the logarithm of the likelihood that lines fitted in these sweeps would have in others."""
    count = len(s.held_out.place) if s.by_sweeps else 0
    level = max(misfit.per_freedom, 1e-3)
    return misfit.freedom * (math.log(level) if level > 1.0 else level - 1.0) + 4.0 * lines_ * count


def _best(s: Scene, current: Fitted, without: Collection[str]) -> list[Fitted]:
    """Return the kinds that describe the sweeps fitted best with one more effect, fitted to all of them."""
    count = max(NAMING.values // len(s.held), min(2, len(s.fitted.place)))
    rows = np.unique(np.round(np.linspace(0, len(s.fitted.place) - 1, count)).astype(int))
    some = s.fitted.rows(rows)
    order = current.tracks.frequency.shape[1]
    known = {c.effect for c in current.candidates}
    plain = with_lines(s, some, Fitted(Tracks(np.zeros((0, order))), current.candidates, np.inf), NAMING.lines)
    tried: list[Fitted] = []
    looked = rows[np.unique(np.round(np.linspace(0, len(rows) - 1, max(WARPS.values // len(s.held), 1))).astype(int))]
    bends = starts(s, looked, set(without) | known)
    for candidate in _candidates(s, some, plain, bends, set(without) | known):
        try:
            tried.append(_compared(s, some, current, candidate))
        except (ValueError, np.linalg.LinAlgError):
            continue
    size = float(some.used.sum())

    def cost(x: Fitted) -> float:
        free = _free(x) + (1 + 2 * len(rows)) * len(x.tracks)
        return size * math.log(max(x.misfit, 1e-3)) + math.log(size) * free

    one_each: dict[str, Fitted] = {}
    for x in sorted(tried, key=cost):
        one_each.setdefault(x.candidates[-1].effect, x)
    found = []
    # what does not help among some sweeps is not tried on all, which takes a minute
    helping = [x for x in one_each.values() if cost(x) < cost(plain) and _halved(x, plain) and _matters(s, some, x)]
    least = min(map(cost, helping), default=0.0)
    for x in [x for x in helping if cost(x) < least + NAMING.near][: NAMING.finalists]:
        whole = fit(s, s.fitted, x.tracks, x.candidates, NAMING.rounds)
        whole = with_lines(s, s.fitted, whole, max(len(current.tracks), NAMING.lines), 1)
        found.append(fit(s, s.fitted, whole.tracks, whole.candidates, NAMING.final))
    if len(current.tracks) > NAMING.lines:
        found += _crowded(s, current, bends)
    return found


def _crowded(s: Scene, current: Fitted, bends: list[Start]) -> list[Fitted]:
    """Return what bends the ramp of a scene of so many lines that a few of them describe nothing.

    A fit of the first lines goes astray there. So the lines of the sharpest spectrum are found over the time in which
    it makes them straight, and fitted together with the bend from there.
    """
    found = []
    for start in bends[: NAMING.crowded]:
        candidates = (*current.candidates, start.candidate)
        bend = curve(s, candidates)
        if bend is None:
            continue
        straightened = Sweeps(
            resampled(s.fitted.signal * s.fitted.used, bend), s.fitted.place, np.ones_like(s.fitted.used)
        )
        tracks = lines(straightened, s.floor, current.tracks.frequency.shape[1])
        left = straightened.signal - solve(straightened, tracks).model
        if of_sweeps(straightened, left, 0.0, s.floor).per_freedom > NAMING.better * current.misfit:
            continue
        frequency = tracks.frequency / (1.0 + (bend[-1] - bend[0]) / (len(bend) - 1.0))
        found.append(fit(s, s.fitted, Tracks(frequency), candidates, NAMING.final))
    return found


def _compared(s: Scene, some: Sweeps, current: Fitted, candidate: Candidate) -> Fitted:
    """Return lines found anew with one more effect, twice: then it is nearly right from the first line on."""
    found = Fitted(current.tracks, (*current.candidates, candidate), np.inf)
    nothing = Tracks(np.zeros((0, current.tracks.frequency.shape[1])))
    for _ in range(NAMING.twice):
        again = with_lines(s, some, Fitted(nothing, found.candidates, np.inf), NAMING.lines)
        again = fit(s, some, again.tracks, again.candidates, NAMING.rounds)
        if not again.misfit < NAMING.better * found.misfit:
            break
        found = again
    return found


def _candidates(s: Scene, some: Sweeps, plain: Fitted, bends: list[Start], without: set[str]) -> list[Candidate]:
    """Return where fits begin."""
    found = [x.candidate for x in bends]
    few = _strong(s, some, plain)
    for name, recipe in recipes(without):
        kind = Effect.registry[name]
        if not _tried(kind, recipe) or (s.moving and kind.distorts):  # what is not linear acts on what is at rest, too
            continue
        if recipe.coefficients:
            found += [_spline(s, name, recipe, n, bends) for n in recipe.coefficients[: NAMING.curves]]
        else:
            own = _template(s, some, few, name, recipe)
            if own is not None:
                found.append(own)
    return found


def _strong(s: Scene, some: Sweeps, plain: Fitted) -> Fitted:
    """Return the strong lines alone: weak ones may be what an effect does to them."""
    window = np.hanning(len(s.held) + 2)[1:-1]
    waves = np.exp(-2j * np.pi * plain.tracks.at(some.place)[..., None] * some.time)
    level = np.matmul(waves, (some.signal * some.used * window)[..., None])[..., 0]
    size = np.sqrt(np.mean(np.abs(level) ** 2, axis=0))
    kept = size > NAMING.weak * size.max(initial=0.0)
    return fit(s, some, Tracks(plain.tracks.frequency[kept]), plain.candidates, NAMING.rounds)


def _spline(s: Scene, name: str, recipe: Recipe, count: int, bends: list[Start]) -> Candidate:
    """Return coefficients of a free curve of the ramp's rate that begins as the sharpest bend."""
    (base,) = recipe.start
    values = np.ones(count)
    if bends:
        rate = 1.0 + np.gradient(bends[0].later)
        place = np.linspace(0.0, 1.0, len(rate))
        design = np.stack([_unit(count, i, place) for i in range(count)], axis=1)
        values = np.clip(np.linalg.lstsq(design, rate / rate.mean(), rcond=None)[0], 0.05, 20.0)
    return Candidate(name, s.material.station, recipe, {f'{base}[{i}]': float(v) for i, v in enumerate(values)})


def _unit(count: int, number: int, place: np.ndarray) -> np.ndarray:
    """Return one cubic B-spline of a uniform, clamped set."""
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, count - 2), np.ones(3)])
    values: np.ndarray = BSpline(knots, np.eye(count)[number], 3)(place)
    return values


def _template(s: Scene, some: Sweeps, plain: Fitted, name: str, recipe: Recipe) -> Candidate | None:
    """Return the start at which the template of an effect describes most of what lines leave, sized to it."""
    size = recipe.size or recipe.scanned
    kind = Effect.registry[name]
    own, whole = modelled(some, plain.tracks, simulated(s, plain.candidates))
    left = (some.signal - whole) * some.used
    columns = np.concatenate([own.design, slopes(some, own) * some.used[:, None, :]], axis=1)
    normal = np.matmul(columns.conj(), columns.swapaxes(1, 2))
    scale = np.einsum('nkk->nk', normal).real
    inverse = np.linalg.inv(normal + np.einsum('nk,kl->nkl', 1e-9 * scale + 1e-12, np.eye(normal.shape[1])))

    def beside(values: np.ndarray) -> np.ndarray:
        weights = np.matmul(inverse, np.matmul(columns.conj(), (values * some.used)[..., None]))[..., 0]
        result: np.ndarray = values * some.used - np.matmul(weights[:, None, :], columns)[:, 0]
        return result

    rest = beside(left)
    axes = starting_values(s, kind, recipe)
    names, grids = list(axes), list(axes.values())
    best: tuple[float, Candidate] | None = None
    for index in np.ndindex(*(len(g) for g in grids)):
        start = dict(recipe.start) | {n: g[i] for n, g, i in zip(names, grids, index, strict=True)}
        start.setdefault(size, {**recipe.steps, **recipe.least_steps}.get(size, 0.01))
        candidate = Candidate(name, s.material.station, recipe, start)
        acting = simulated(s, (*plain.candidates, candidate))
        template = beside(heard_by(some, plain.tracks, acting, own.phasor, own.constant) - whole)
        power = float(np.sum(np.abs(template) ** 2))
        if not power > 0.0:
            continue
        factor = float(np.sum((template.conj() * rest).real)) / power
        if recipe.decibel and factor <= 0.0:
            continue
        value = start[size] + 20.0 * math.log10(factor) if recipe.decibel else start[size] * factor
        if best is None or factor**2 * power > best[0]:
            best = factor**2 * power, candidate.moved(**{size: value})
    if best is None or best[0] < 2.0 * NAMING.gain * s.floor.mean:
        return None
    return best[1]
