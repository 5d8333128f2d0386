"""Effects fitted together with the lines on which they act."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from drfmcw_physics.settings import declared_parameters

from ...search.starts.bank import Candidate
from .limits import FORWARD
from .misfit import Misfit
from .model import Scene, judged_by
from .simulated import Simulated
from .tracks import Solved, Sweeps, Tracks, assembled, basis, slopes, solve, strongest, waves
from .warps import later as later_by
from .warps import resampled


@dataclasses.dataclass(frozen=True)
class Fitted:
    """Lines and effects."""

    tracks: Tracks
    candidates: tuple[Candidate, ...]  # with the values fitted
    misfit: float  # mean square left of the samples fitted over that of noise
    std: tuple[dict[str, float], ...] = ()  # of each effect's parameters


def simulated(s: Scene, candidates: Sequence[Candidate]) -> Simulated:
    """Return the effects with their values."""
    return Simulated(s.simulated_lines, [c.build() for c in candidates])


def modelled(sweeps: Sweeps, tracks: Tracks, acting: Simulated) -> tuple[Solved, np.ndarray]:
    """Return the lines with their amplitudes, and what the receiver makes of them (n, N)."""
    shaping = acting.factors if acting.shaping else None
    found = solve(sweeps, tracks, shaping)
    if not acting.receiving:
        return found, found.model
    whole = acting.received(found.model)
    for _ in range(FORWARD.fixed_points):
        found = solve(sweeps, tracks, shaping, sweeps.signal - (whole - found.model))
        whole = acting.received(found.model)
    return found, whole


def fit(s: Scene, sweeps: Sweeps, tracks: Tracks, candidates: Sequence[Candidate], rounds: int) -> Fitted:
    """Return lines and all free parameters of effects fitted together (Levenberg and Marquardt)."""
    names = [(i, name) for i, c in enumerate(candidates) for name in c.free if name in c.values]
    point = np.array([candidates[i].values[name] for i, name in names])
    order = tracks.frequency.shape[1]
    b = basis(sweeps.place, order)
    most = FORWARD.step / sweeps.signal.shape[1]

    def with_values(values: np.ndarray) -> list[Candidate]:
        changed = [dict(c.values) for c in candidates]
        for (i, name), value in zip(names, values, strict=True):
            changed[i][name] = float(value)
        return [c.moved(**v) for c, v in zip(candidates, changed, strict=True)]

    def attempt(values: np.ndarray, at: Tracks) -> tuple[float, Solved, np.ndarray] | None:
        try:
            found, whole = modelled(sweeps, at, simulated(s, with_values(values)))
        except (ValueError, FloatingPointError):
            return None
        cost = float(np.sum(np.abs((sweeps.signal - whole)[sweeps.used]) ** 2))
        return (cost, found, whole) if np.isfinite(cost) else None

    bounds = [bounds_of(s, candidates[i], name) for i, name in names]
    low, high = (np.array([x[k] for x in bounds]) for k in (0, 1))
    first = attempt(point, tracks)
    if first is None:
        return Fitted(tracks, tuple(candidates), np.inf)
    cost, found, whole = first
    steps = [candidates[i].recipe.step(name, x) * FORWARD.gentle for (i, name), x in zip(names, point, strict=True)]
    damping, covariance = FORWARD.damping, np.zeros((len(names), len(names)))
    lines = len(tracks)
    for _ in range(rounds):

        def made(values: np.ndarray, at: Tracks = tracks, solved: Solved = found) -> np.ndarray:
            return heard_by(sweeps, at, simulated(s, with_values(values)), solved.phasor, solved.constant)

        columns = [_derivative(made, whole, point, k, steps, bounds[k]) for k in range(len(names))]
        jacobian = slopes(sweeps, found)
        if columns:
            jacobian = np.concatenate([jacobian, np.stack(columns, axis=1)], axis=1)
        normal = assembled(sweeps, found, whole, jacobian, b)
        improved = False
        for _ in range(FORWARD.trials):
            step_all = normal.step(damping)
            change = np.clip(step_all[: lines * order].reshape(lines, order), -most, most)
            values = np.clip(point + step_all[lines * order :], low, high)
            trial = attempt(values, Tracks(tracks.frequency + change))
            if trial is not None and trial[0] < cost:
                improved = True
                break
            damping *= 10.0
        covariance = normal.inverse(1e-12)[lines * order :, lines * order :]
        if not improved or trial is None:
            break
        settled = cost - trial[0] < FORWARD.settled * cost
        tracks, point = Tracks(tracks.frequency + change), values
        cost, found, whole = trial
        damping = max(damping / 10.0, 1e-7)
        if settled:
            break
    parts = 2.0 if sweeps.iq else 1.0
    each = s.floor.mean / parts
    count = parts * float(sweeps.used.sum())
    misfit = cost / each / count
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0) * each * max(misfit, 1.0))
    std: list[dict[str, float]] = [{} for _ in candidates]
    for (i, name), value in zip(names, spread, strict=True):
        std[i][name] = float(value)
    return Fitted(tracks, tuple(with_values(point)), misfit, tuple(std))


def _derivative(
    made: Callable[[np.ndarray], np.ndarray],
    whole: np.ndarray,
    point: np.ndarray,
    number: int,
    steps: list[float],
    bounds: tuple[float, float],
) -> np.ndarray:
    """Return by how much the samples `whole` (n, N) that are `made` at a point change with one of its parameters.

    Its step grows until the change stands out of the simulation's rounding, and is kept.
    """
    low, high = bounds
    least = FORWARD.seen * float(np.sqrt(np.sum(np.abs(whole) ** 2)))
    while True:
        step = steps[number] if point[number] + steps[number] <= high else -steps[number]
        moved = point.copy()
        moved[number] += step
        change = made(moved) - whole
        wider = 10.0 * steps[number]
        inside = low < point[number] - wider and point[number] + wider < high
        if not inside or float(np.sqrt(np.sum(np.abs(change) ** 2))) > least:
            result: np.ndarray = change / step
            return result
        steps[number] = wider


def heard_by(sweeps: Sweeps, tracks: Tracks, acting: Simulated, phasor: np.ndarray, constant: np.ndarray) -> np.ndarray:
    """Return the samples of lines of known amplitudes (n, N)."""
    turning = waves(sweeps, tracks, acting.factors if acting.shaping else None)
    heard = np.matmul(phasor[:, None, :], turning)[:, 0] + constant[:, None]
    return acting.received(heard if sweeps.iq else heard.real)


def bounds_of(s: Scene, candidate: Candidate, name: str) -> tuple[float, float]:
    """Return the declared bounds of a parameter, those of its recipe and of what samples resolve where narrower."""
    base = name.partition('[')[0]
    declared = declared_parameters(candidate.kind)[base][1]
    low, high = declared.bounds or (-np.inf, np.inf)
    own = candidate.recipe.limits.get(base, (low, high))
    if declared.unit == 'Hz' and base != candidate.recipe.size:
        high = min(high, 0.5 * s.material.rate)
    return max(low, own[0]), min(high, own[1])


def with_lines(s: Scene, sweeps: Sweeps, found: Fitted, most: int, rounds: int = 2) -> Fitted:
    """Return the fit with as many further lines as the sweeps demand, `most` in all.

    Each is looked for over the time in which the effects that were fitted leave lines straight.
    """
    order = found.tracks.frequency.shape[1]
    while len(found.tracks) < most:
        _, whole = modelled(sweeps, found.tracks, simulated(s, found.candidates))
        rest = (sweeps.signal - whole) * sweeps.used
        later = curve(s, found.candidates)
        start = strongest(sweeps, rest if later is None else resampled(rest, later), s.floor, order)
        if start is None:
            break
        if later is not None:  # as many samples over another span
            start = start / (1.0 + (later[-1] - later[0]) / (len(later) - 1.0))
        tracks = Tracks(np.vstack([found.tracks.frequency, start]))
        early = len(tracks) <= FORWARD.early  # the first lines settle what acts on all of them
        again = fit(s, sweeps, tracks, found.candidates, FORWARD.final if early else rounds)
        if not again.misfit < found.misfit:
            break
        found = again
    return found


def curve(s: Scene, candidates: Sequence[Candidate]) -> np.ndarray | None:
    """Return by how much effects make the time of all lines later (N,) [samples], None without such."""
    bending = [later_by(s, c) for c in candidates if c.kind.shapes_chirp]
    return np.sum(bending, axis=0) if bending else None


def judged(s: Scene, found: Fitted) -> tuple[Misfit, Misfit]:
    """Return the misfits of the samples fitted and of those held out."""
    acting = simulated(s, found.candidates)
    return judged_by(s, lambda sweeps: modelled(sweeps, found.tracks, acting), len(found.tracks))
