"""Second paths without a name: of a reflector that stands still, or that is there along a part of the track.

In: an explanation. Out: by how much its own second paths explain more than such a path, and what such a path leaves, to
be set aside. The excess length of an echo is the same wherever the crane stands, that of a reflection at the ground
falls as one over the distance. What a mast behind the crane throws back is longer by twice its distance from the crane.
Two echoes, or an echo and a reflection, imitate that.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

from drfmcw_physics.settings import parameter
from drfmcw_sim.effects import ActsOn, Effect, Of, Stage
from drfmcw_sim.effects.motion import slowness
from drfmcw_sim.measurements import Measurements, Path

from ..compare.algebra import gain_of
from ..compare.comparison import Comparison
from ..search.fits.fitted import Fitted, Freedom
from ..search.fits.fitting import Fitting
from ..search.fits.whitening import Whitening
from ..search.leftovers import Leftover
from ..search.limits import EVENTS
from ..search.search import Search
from ..search.starts.phasors import Phasors, path_phasors, per_metre


@dataclasses.dataclass(frozen=True)
class PathLimits:
    """When a second path without a name is taken for the cause."""

    seen: float = 6.0
    """Gain at a distance, below which it is not seen there [1]: amplitude and phase of noise gain 2; chosen."""

    parameter: float = EVENTS.parameter
    """Gain that each parameter must bring (Akaike 1974)."""

    beaten: float = EVENTS.beaten
    """Gain of second paths beyond that of one without a name, below which they are in doubt; chosen, as of an event."""

    worth: float = 0.5
    """Share of what is left over the sweep that it must explain to be set aside [1]; chosen."""

    chance: float = EVENTS.chance
    """Chance of such a path, of all that are tried, above which it is not set aside [1]; chosen."""

    clearly: float = EVENTS.clearly
    """Gain by which it must exceed that of any effect to be set aside [1]; chosen."""

    prior: float = 10.0
    """Standard deviation of its size at each distance when it is set aside, over that found [1]; chosen: any size."""

    small: float = 1e-3
    """Relative amplitude with which it is simulated, so that it adds in proportion to it [1]; chosen."""

    least: float = 1e-4
    """Relative amplitude of products of the path with itself, from which on they count [1]; chosen."""

    products: int = 4
    """Order of these products, at most; chosen."""


LIMITS = PathLimits()


@dataclasses.dataclass(frozen=True)
class Unnamed(Effect, name='path without a name', of=Of.PATH, registered=False):
    """A second path whose excess length is a straight line over the distance; none where that is negative."""

    acts_on = ActsOn.DELAY | ActsOn.AMPLITUDE
    stage = Stage.PATHS

    offset: float = parameter(0.0, unit='m', description='excess length at no distance')
    slope: float = parameter(0.0, description='excess length over the distance')
    phase: float = parameter(0.0, unit='rad', description='by which it turns the carrier')

    def prepare(self, m: Measurements) -> None:
        """Add the path."""
        direct = m.paths[0]
        excess = self.offset + self.slope * m.range
        amplitude = np.where(excess > 0.0, LIMITS.small * direct.amplitude, 0.0)
        delay = direct.delay + np.maximum(excess, 0.0) * slowness(m)
        rate, acceleration = ((1.0 + self.slope) * x for x in (direct.rate, direct.acceleration))
        m.paths.append(Path(delay, rate, acceleration, amplitude, self.phase / (2.0 * math.pi)))


@dataclasses.dataclass(frozen=True)
class _Law:
    """Where a path without a name is, and how strong (G,)."""

    offset: float  # of its excess length [m]
    slope: float
    seen: np.ndarray  # in which groups it is (G,)
    resolved: np.ndarray  # in which it may be too, as a line of its own (G,)
    amplitude: np.ndarray  # relative to the direct path (G,)
    gain: float
    everywhere: float  # gain of the best path of one excess length, amplitude and phase
    tried: int  # laws

    @property
    def parameters(self) -> int:
        """Amplitude and phase in each group, and one of the law."""
        return 2 * int(self.seen.sum()) + 1

    @property
    def worth(self) -> float:
        """Gain less what the parameters cost."""
        return self.gain - LIMITS.parameter * self.parameters


def beyond_paths(fitting: Fitting, fitted: Fitted) -> list[float]:
    """Return by how much second paths gain more than one without a name in their place; infinity for other effects.

    All second paths of an explanation together are compared with one: several may imitate it.

    Args:
        fitting: of the recording.
        fitted: the explanation.
    """
    found = [np.inf] * len(fitted.effects)
    own = [i for i, effect in enumerate(fitted.effects) if _is_second_path(effect.candidate.kind)]
    if not own:
        return found
    c, whitening = fitting.comparison, fitting.whitening
    without = _without(fitting, fitted, own)
    law = _best_law(c, fitting.without_set_aside(c.residual - without))
    if law is None:
        return found
    directions = _directions(c, law)
    beside, unexplained, gained = _explained(fitting, fitted, own, without, whitening)
    gain = gained - LIMITS.parameter * sum(len(fitted.effects[i].candidate.free) for i in own)
    instead = gain_of(beside.left(whitening(directions)), unexplained) - LIMITS.parameter * law.parameters
    with_law = whitening.beside(LIMITS.prior * directions)
    for i in own:
        _, _, needed = _explained(fitting, fitted, [i], _without(fitting, fitted, [i]), with_law)
        if stats.chi2.sf(max(needed, 0.0), len(fitted.effects[i].candidate.free)) >= LIMITS.chance:
            found[i] = gain - instead
    return found


def _without(fitting: Fitting, fitted: Fitted, numbers: Sequence[int]) -> np.ndarray:
    """Return what an explanation adds without some of its effects (n,)."""
    others = [e.build() for i, e in enumerate(fitted.effects) if i not in numbers]
    return fitting.comparison.template(others) if others else np.zeros_like(fitted.template)


def _explained(
    fitting: Fitting, fitted: Fitted, numbers: Sequence[int], without: np.ndarray, whitening: Whitening
) -> tuple[Freedom, np.ndarray, float]:
    """Return the freedom of an explanation without some effects, what it leaves then (n,), and what these gain.

    Args:
        fitting: of the recording.
        fitted: the explanation.
        numbers: of the effects.
        without: what it adds without them (n,).
        whitening: of numbers.
    """
    residual, spans = fitting.comparison.residual, np.r_[tuple(fitted.spans[i] for i in numbers)]
    beside = Freedom(np.delete(whitening(fitting.slopes(fitted)), spans, axis=0))
    rest, unexplained = (beside.left(whitening(residual - t)) for t in (fitted.template, without))
    return beside, unexplained, float(unexplained @ unexplained - rest @ rest)


def _is_second_path(kind: type[Effect]) -> bool:
    return kind.stage is Stage.PATHS and ActsOn.DELAY in kind.acts_on


@dataclasses.dataclass(frozen=True)
class _Found:
    """A second path that nothing names."""

    directions: np.ndarray  # what it adds at each distance (k, n)
    gain: float
    chance: float  # of so much, of all laws that are tried


def left(search: Search, fitted: Fitted | None, as_measured: Whitening) -> np.ndarray:
    """Return a second path without a name beside an explanation, each number of it times its prior (k, n).

    Args:
        search: of the recording.
        fitted: the explanation, None for none.
        as_measured: whitening of what it leaves, nothing of which counts as unknown.
    """
    found = _found(search, fitted, as_measured)
    return np.zeros((0, len(search.comparison.residual))) if found is None else LIMITS.prior * found.directions


def leftover(search: Search, fitted: Fitted | None) -> Leftover | None:
    """Return what a second path without a name leaves beside an explanation, None where there is none."""
    found = _found(search, fitted, search.whitening_of(fitted, with_unknown=False))
    if found is None:
        return None
    return Leftover('ramp', len(search.comparison.channels) - 1, found.chance, found.gain)


def _found(search: Search, fitted: Fitted | None, as_measured: Whitening) -> _Found | None:
    """Return the second path without a name that explains more than any effect would; None where none does."""
    c = search.comparison
    residual = c.residual - (fitted.template if fitted is not None else 0.0)
    law = _best_law(c, residual)
    if law is None or law.worth < law.everywhere + LIMITS.clearly:
        return None
    nothing = np.zeros((0, len(residual)))
    beside = Freedom(as_measured(search.slopes(fitted)) if fitted is not None else nothing)
    rest = beside.left(as_measured(residual))
    directions = _directions(c, law)
    gain = gain_of(beside.left(as_measured(directions)), rest)
    over_sweep = c.entries.where(kind='ramp')
    excess = float(rest[over_sweep] @ rest[over_sweep]) - np.count_nonzero(rest[over_sweep])
    chance = law.tried * float(stats.chi2.sf(gain, law.parameters))
    if gain < LIMITS.worth * excess or chance > LIMITS.chance:
        return None
    named = search.most_by_one(fitted, as_measured, rest)
    return _Found(directions, gain, chance) if gain > named + LIMITS.clearly else None


def _best_law(c: Comparison, residual: np.ndarray) -> _Law | None:
    """Return the second path without a name that explains most of a residual over the sweep (n,); None where none does.

    At one distance alone nothing separates it from an echo.
    """
    if len(c.members) < 2:
        return None
    phasors = path_phasors(c, residual)
    each = phasors.gain_of_each()  # (G, cells)
    seen = np.where(each > LIMITS.seen, each, 0.0)
    still, parts = _still(c, phasors, seen), _along_a_part(c, phasors, seen)
    best = max((law for law in (still, parts) if law is not None), key=lambda law: law.worth, default=None)
    if best is None:
        return None
    tried = sum(law.tried for law in (still, parts) if law is not None)
    return dataclasses.replace(best, tried=tried)


def _still(c: Comparison, phasors: Phasors, seen: np.ndarray) -> _Law | None:
    """Return the best reflector that stands still behind the crane; `seen` gains of each group in each cell."""
    distance, count = c.recorded.distance, len(phasors.frequency)
    per_cell = phasors.frequency[0] / per_metre(c)  # [m]
    places = np.arange(float(distance.min()), float(distance.max()) + 0.5 * per_cell * count, 0.25 * per_cell)
    cells = np.rint(2.0 * (places[:, None] - distance) / per_cell).astype(int) - 1  # (laws, G)
    inside = (cells >= 0) & (cells < count)
    gains = np.where(inside, seen[np.arange(len(distance)), cells.clip(0, count - 1)], 0.0)
    return _best(phasors, gains, cells, 2.0 * places, -2.0)


def _along_a_part(c: Comparison, phasors: Phasors, seen: np.ndarray) -> _Law | None:
    """Return the best reflector that is there between two distances only; `seen` gains of each group in each cell."""
    order = np.argsort(c.recorded.distance)
    over = seen[order] - LIMITS.seen
    sums = np.concatenate([np.zeros((1, over.shape[1])), np.cumsum(over, axis=0)])
    lowest = np.minimum.accumulate(sums, axis=0)
    last = np.argmax(sums - lowest, axis=0)  # (cells,) the run with the largest sum ends there
    first = np.array([int(np.argmin(sums[: end + 1, cell])) for cell, end in enumerate(last)])
    place = np.arange(len(order))[:, None]
    part = (place >= first) & (place < last) & (last - first < len(order))  # one that is everywhere is an echo
    gains = np.zeros_like(seen)
    gains[order] = np.where(part, seen[order], 0.0)
    cells = np.broadcast_to(np.arange(seen.shape[1])[:, None], gains.T.shape)
    lengths = phasors.frequency / per_metre(c)
    return _best(phasors, gains.T, cells, lengths, 0.0)


def _best(phasors: Phasors, gains: np.ndarray, cells: np.ndarray, offsets: np.ndarray, slope: float) -> _Law | None:
    """Return the best of laws, None where none is seen anywhere.

    Args:
        phasors: how well a second path fits.
        gains: of each law in each group, 0 where it is not seen (laws, G).
        cells: of its excess length (laws, G); beyond those of the phasors it is a line of its own.
        offsets: of this [m] (laws,).
        slope: of this over the distance.
    """
    tried = int(np.count_nonzero(gains.any(axis=1)))
    if not tried:
        return None
    worth = gains.sum(axis=1) - LIMITS.parameter * (2 * np.count_nonzero(gains, axis=1) + 1)
    best = int(np.argmax(np.where(gains.any(axis=1), worth, -np.inf)))
    seen = gains[best] > 0.0
    sizes = phasors.size_of_each()[np.flatnonzero(seen), cells[best, seen]]
    amplitude = np.full(len(seen), sizes.mean())
    amplitude[seen] = sizes
    resolved = cells[best] >= len(phasors.frequency)
    gain, everywhere = float(gains[best].sum()), float(phasors.gain().max())
    return _Law(float(offsets[best]), slope, seen, resolved, amplitude, gain, everywhere, tried)


def _directions(c: Comparison, law: _Law) -> np.ndarray:
    """Return what a path without a name adds at each distance, of the size found there (k, n).

    With the amplitude a, the logarithm of the sum of both paths is a series of a^k / k at k times the excess length. At
    each distance each of them may have any phase: nobody knows the distance to a part of the carrier's wavelength.
    """
    groups = c.entries.group
    found = [np.zeros((0, len(c.residual)))]
    for order in range(1, LIMITS.products + 1):
        sizes = law.amplitude**order / order
        where = np.flatnonzero((law.seen & (sizes > LIMITS.least)) | ((law.seen | law.resolved) & (order == 1)))
        if not len(where):
            break
        for phase in (0.0, 0.5 * math.pi):
            template = c.template([Unnamed(offset=order * law.offset, slope=order * law.slope, phase=phase)])
            found.append(np.where(groups == where[:, None], template, 0.0) * sizes[where, None] / LIMITS.small)
    return np.concatenate(found)
