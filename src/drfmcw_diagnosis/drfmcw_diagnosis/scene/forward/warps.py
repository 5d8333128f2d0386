"""Where a search for what bends the ramp begins: a time in which all lines are straight makes their spectrum sharp.

A line of delay tau has the phase 2 pi tau f(t), so an error of the ramp's frequency moves the time of all lines alike,
by that error over the ramp's rate.
"""

import dataclasses
import itertools

import numpy as np
from scipy.optimize import minimize

from drfmcw_physics.settings import declared_parameters
from drfmcw_sim.effects import Effect, Recipe

from ...search.starts.bank import Candidate, recipes
from .limits import WARPS
from .model import Scene


def resampled(signal: np.ndarray, later: np.ndarray) -> np.ndarray:
    """Return sweeps (n, N) over the time in which lines are straight, which is `later` (N,) [samples] than recorded."""
    return _Sharpness(signal, 1.0).over(later)


class _Sharpness:
    """How sharp the lines of sweeps are over another time."""

    def __init__(self, signal: np.ndarray, floor: float) -> None:
        self.count = signal.shape[1]
        self.floor = floor
        fine = WARPS.finer * self.count
        spectrum = np.fft.fft(signal - signal.mean(axis=1, keepdims=True), axis=1)
        half = self.count // 2
        padded = np.zeros((len(signal), fine), complex)
        padded[:, :half], padded[:, half - self.count :] = spectrum[:, :half], spectrum[:, half:]
        dense = np.fft.ifft(padded, axis=1) * WARPS.finer
        self._fine: np.ndarray = dense if np.iscomplexobj(signal) else dense.real
        self._window = np.hanning(self.count + 2)[1:-1]
        power = np.abs(np.fft.fft(signal * self._window, axis=1)) ** 2
        folded = np.minimum(np.arange(self.count), self.count - np.arange(self.count))
        mean = np.where(folded > 1, power.mean(axis=0), 0.0)
        order = np.argsort(folded)
        held = np.cumsum(mean[order])
        self.highest = max(float(folded[order][np.searchsorted(held, WARPS.held * held[-1])]) / self.count, 0.02)

    def over(self, later: np.ndarray) -> np.ndarray:
        time = np.arange(self.count)
        warped = time + later
        even = np.linspace(warped[0], warped[-1], self.count)
        place = np.clip(np.interp(even, warped, time) * WARPS.finer, 0, self._fine.shape[1] - WARPS.finer - 1)
        below = place.astype(int)
        share = place - below
        result: np.ndarray = self._fine[:, below] * (1.0 - share) + self._fine[:, below + 1] * share
        return result

    def cost(self, later: np.ndarray) -> float:
        """Return the mean of log(1 + power over noise): the information that noise of such a spectrum has."""
        if np.any(np.diff(later) < -WARPS.steepest):
            return np.inf
        power = np.mean(np.abs(np.fft.fft(self.over(later) * self._window, axis=1)) ** 2, axis=0)
        return float(np.mean(np.log1p(power / (self.floor * np.sum(self._window**2)))))


@dataclasses.dataclass(frozen=True)
class Start:
    """Where a fit begins."""

    candidate: Candidate
    later: np.ndarray  # (N,) by which it makes the time of all lines later [samples]
    cost: float


def scaled(kind: type[Effect], name: str, value: float, duration: float) -> float:
    """Return a value of a recipe, which is written for ramps of a millisecond, for another duration [s]."""
    unit = declared_parameters(kind)[name][1].unit
    return value * {'Hz': 1e-3 / duration, 's': duration / 1e-3}.get(unit, 1.0)


def later(s: Scene, candidate: Candidate) -> np.ndarray:
    """Return by how much an effect on the ramp makes the time of all lines later (N,) [samples]."""
    sign = np.sign(s.simulated_lines.rate)
    reference = WARPS.reference * (sign if s.material.iq else 1.0)
    (factor,) = s.simulated_lines.shaped(np.array([reference]), [candidate.build()])
    return np.unwrap(np.angle(factor)) / (2.0 * np.pi * reference)


def starts(s: Scene, rows: np.ndarray, without: set[str]) -> list[Start]:
    """Return the sharpest start of each kind that bends the ramp, sharpest first.

    Args:
        s: sweeps.
        rows: of those fitted that are looked at.
        without: effects that are left out.
    """
    sharp = _Sharpness(s.fitted.signal[rows] * s.fitted.used[rows], s.floor.mean)
    found = []
    for name, recipe in recipes(without):
        kind = Effect.registry[name]
        if kind.shapes_chirp and recipe.size and recipe.scan in ('', 'ripple'):
            start = _sharpest(s, sharp, name, recipe)
            if start is not None:
                found.append(start)
    return sorted(found, key=lambda x: x.cost)


def starting_values(s: Scene, kind: type[Effect], recipe: Recipe) -> dict[str, list[float]]:
    """Return the values of parameters other than the size at which fits may begin."""
    m = s.material
    axes = {key: [scaled(kind, key, v, m.duration) for v in values] for key, values in recipe.grid.items()}
    if recipe.scan == 'ripple':
        most = min(WARPS.fastest, m.duration * m.rate / 8.0)
        slow = np.arange(WARPS.slowest, WARPS.slow, 0.5 * WARPS.step)
        axes[recipe.scanned] = list(np.concatenate([slow, np.arange(WARPS.slow, most, WARPS.step)]) / m.duration)
    if recipe.quadrature[0]:
        axes[recipe.quadrature[0]] = [x * recipe.quadrature[1] for x in (0.0, 0.5, 1.0, 1.5)]
    return axes


def _sharpest(s: Scene, sharp: _Sharpness, name: str, recipe: Recipe) -> Start | None:
    kind, m = Effect.registry[name], s.material
    axes = starting_values(s, kind, recipe)
    tried: list[tuple[float, Candidate]] = []
    straight = sharp.cost(np.zeros(sharp.count))
    for values in itertools.product(*axes.values()):
        start = dict(recipe.start) | dict(zip(axes, values, strict=True))
        quick = start.get(recipe.scanned, 0.0) * m.duration >= WARPS.slow
        if quick and start.get(recipe.quadrature[0], 0.0) % recipe.quadrature[1]:
            continue
        candidate = Candidate(name, m.station, recipe, start)
        whole = float(np.abs(later(s, candidate)).max())
        if not whole > 0.0:
            continue
        unit = start[recipe.size] / whole
        one = later(s, candidate.moved(**{recipe.size: unit}))
        bend = float(np.abs(np.diff(one)).max())
        low, high = WARPS.weakest / (2.0 * np.pi * sharp.highest), WARPS.steepest / max(bend, 1e-12)
        if low >= high:
            continue
        even = WARPS.even / (2.0 * np.pi * sharp.highest)  # of one radian and more, neighbours are as far apart
        small = np.exp(np.arange(np.log(low), np.log(min(high, even / WARPS.ratio)), WARPS.ratio))
        sizes = np.concatenate([small, np.arange(even / WARPS.ratio, high, even)])
        own = min(((sharp.cost(x * one), x) for size in sizes for x in (size, -size)), default=(np.inf, 0.0))
        tried.append((own[0], candidate.moved(**{recipe.size: float(own[1]) * unit})))
    tried = sorted((x for x in tried if x[0] < straight - WARPS.sharper), key=lambda x: x[0])[: WARPS.polished]
    polished = [_polished(s, sharp, candidate) for _, candidate in tried]
    found = [Start(x, curve, sharp.cost(curve)) for x in polished for curve in [later(s, x)]]
    return min(found, key=lambda x: x.cost, default=None)


def _polished(s: Scene, sharp: _Sharpness, candidate: Candidate) -> Candidate:
    """Return the parameters at which lines are sharpest near those given (Nelder and Mead)."""
    names = [n for n in candidate.free if n in candidate.values]
    origin = np.array([candidate.values[n] for n in names])
    scale = np.where(np.abs(origin) > 0.0, WARPS.near * np.abs(origin), 0.3)

    def cost(x: np.ndarray) -> float:
        try:
            moved = candidate.moved(**dict(zip(names, (origin + scale * x).tolist(), strict=True)))
            return sharp.cost(later(s, moved))
        except ValueError:
            return np.inf

    found = minimize(cost, np.zeros(len(names)), method='Nelder-Mead', options={'maxfev': WARPS.trials, 'xatol': 1e-3})
    return candidate.moved(**dict(zip(names, (origin + scale * found.x).tolist(), strict=True)))
