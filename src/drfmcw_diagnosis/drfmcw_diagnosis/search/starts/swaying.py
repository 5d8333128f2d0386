"""Scanner of a movement that swings: at which frequencies the crane sways about the reference's readings."""

import dataclasses
import math

import numpy as np

from drfmcw_sim.effects import Recipe

from ...compare.comparison import Comparison
from ..limits import SCAN
from .scanning import Rest, Values, peaks


@dataclasses.dataclass(frozen=True)
class Swaying:
    """What sines may explain of the movements of n sweeps about the means of their m groups, and of these means."""

    time: np.ndarray  # of the sweeps, one group after another (n,) [s]
    groups: tuple[slice, ...]  # where the sweeps of each group stand
    movement: np.ndarray  # over its standard deviation (n,)
    weight: np.ndarray  # one over that (n,) [1/m]
    error: np.ndarray  # of the range, mean of each group, over its standard deviation (m,)
    weight_of_mean: np.ndarray  # one over that (m,) [1/m]

    @property
    def count(self) -> np.ndarray:
        """Sweeps of each group (m,)."""
        return np.array([s.stop - s.start for s in self.groups])

    def gains(self, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much sines of any size and phase lower the misfit: of movements alone, and of both.

        A sine turns by the sum of two frequencies, so that sums over all sweeps are products of two short tables.

        Args:
            first: frequencies (A,) [Hz].
            second: what is added to each of them (B,) [Hz].

        Returns:
            gain at each sum of two frequencies (A, B), twice.
        """
        one, other = (np.exp(2j * math.pi * f[:, None] * self.time) for f in (first, second))
        first_of = [s.start for s in self.groups]
        movement, squared = self.movement * self.weight, self.weight**2
        # a movement is compared within its group only
        apart = movement - np.repeat(np.add.reduceat(movement, first_of) / self.count, self.count)
        along, turned = (one * apart) @ other.T, (one**2 * squared) @ (other**2).T
        power = np.full(along.shape, squared.sum())
        of_mean, turned_of_mean, power_of_mean = np.zeros_like(along), np.zeros_like(along), np.zeros_like(power)
        for group, count, error, weight in zip(self.groups, self.count, self.error, self.weight_of_mean, strict=True):
            a, b, v = one[:, group], other[:, group].T, squared[group]
            mean, weighted = a @ b / count, (a * v) @ b
            power += v.sum() * np.abs(mean) ** 2 - 2.0 * (mean.conj() * weighted).real
            turned += v.sum() * mean**2 - 2.0 * mean * weighted
            of_mean += error * weight * mean
            power_of_mean += weight**2 * np.abs(mean) ** 2
            turned_of_mean += weight**2 * mean**2
        with_means = _gain(along + of_mean, power + power_of_mean, turned + turned_of_mean)
        return _gain(along, power, turned), with_means


def _gain(along: np.ndarray, power: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Return by how much cosine and sine lower the sum of squares of numbers z, by complex waves w = cosine + j sine.

    Args:
        along: sums of z w.
        power: sums of |w|^2.
        turned: sums of w^2.
    """
    a, b = along.real, along.imag
    rr, ii, ri = 0.5 * (power + turned.real), 0.5 * (power - turned.real), 0.5 * turned.imag
    return np.asarray((ii * a * a - 2.0 * ri * a * b + rr * b * b) / np.maximum(rr * ii - ri * ri, 1e-30))


def oscillations(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return frequencies of movement about the reference's readings [Hz]."""
    swaying = _swaying(rest.comparison, rest.residual)
    if swaying is None:
        return ()
    step = max(0.25 / max(np.ptp(swaying.time), 1.0), SCAN.fastest_sway / (SCAN.fine * SCAN.sway_cells))
    slowest = recipe.limits.get(recipe.scanned, (0.0,))[0]
    frequency = np.arange(max(math.ceil(slowest / step), 1), int(SCAN.fastest_sway / step)) * step
    stretch = math.ceil(math.sqrt(len(frequency)))
    coarse = swaying.gains(frequency[::stretch], step * np.arange(stretch))[0].ravel()[: len(frequency)]
    if coarse.max() < SCAN.faint:
        return ()
    # with pauses between groups many frequencies fit nearly as well: compare them at their exact maxima
    about = frequency[peaks(coarse, SCAN.aliases, 1)]
    beside = step * np.linspace(-1.0, 1.0, SCAN.top)
    closer = 2.0 * beside / (SCAN.top - 1)
    found: list[float] = []
    # where the crane stands on average separates aliases, but errors may hide it
    for number, gains in enumerate(swaying.gains(about, beside)):
        near = _highest(about, beside, gains, SCAN.compared)
        places = _highest(near, closer, swaying.gains(near, closer)[number], SCAN.peaks)
        found += places.tolist()
    return tuple(dict.fromkeys(found))


def _swaying(c: Comparison, residual: np.ndarray) -> Swaying | None:
    """Return what a residual (n,) holds of movements, None where few sweeps do."""
    chosen = c.entries.where(kind='movement')
    rows, group = c.entries.position[chosen], c.entries.group[chosen]
    weight = 1.0 / c.std.movement
    used = weight > 0.0
    if np.count_nonzero(used) < 4:
        return None
    members, starts = np.unique(group[used], return_index=True)
    ends = [*starts[1:], np.count_nonzero(used)]
    return Swaying(
        time=c.data.time[rows[used]],
        groups=tuple(slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True)),
        movement=residual[chosen][used],
        weight=weight[used],
        error=residual[c.entries.where(kind='range')][members],
        weight_of_mean=1.0 / c.std.range[members],
    )


def _highest(about: np.ndarray, beside: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Return where parabolas through the largest of each row's values have the highest maxima, highest first (count,).

    Args:
        about: middle of each row (n,).
        beside: equally spaced places about it (k,).
        values: there (n, k).
        count: maxima that are wanted.
    """
    row, best = np.arange(len(values)), values.argmax(axis=1).clip(1, values.shape[1] - 2)
    left, middle, right = (values[row, best + i] for i in (-1, 0, 1))
    bend = np.minimum(left - 2.0 * middle + right, -1e-30)
    offset = np.clip(0.5 * (left - right) / bend, -1.0, 1.0)
    highest = np.argsort(middle - 0.25 * (left - right) * offset)[::-1][:count]
    places: np.ndarray = (about + beside[best] + offset * (beside[1] - beside[0]))[highest]
    return places
