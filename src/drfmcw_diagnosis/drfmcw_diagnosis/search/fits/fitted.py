"""Effects fitted together: their parameters, what these can follow, and which numbers belong together.

In: results of fits. Out: where another fit may begin, and what is left of values beside an explanation.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from drfmcw_sim.effects import Effect

from ...compare.algebra import scaled_inverse
from ...compare.groups import Entries
from ..starts.bank import Candidate
from .limits import FIT


@dataclasses.dataclass(frozen=True)
class FittedEffect:
    """One effect with fitted parameters."""

    candidate: Candidate
    values: dict[str, float]
    stds: dict[str, float]
    widened: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    """Value and standard deviation of parameters that the best fit alone determines too well, see `rivals.widened`."""

    size_std: float = 0.0
    """Standard deviation of the size with all else fixed: an uncertain shape makes the size uncertain too."""

    @property
    def certain(self) -> bool:
        """False where the size may be zero or the shape that of another effect: it adds only degrees of freedom."""
        recipe = self.candidate.recipe
        defined = all(abs(self.values[name]) > FIT.certain * self.stds[name] for name in recipe.defining)
        if not recipe.may_vanish:
            return defined
        return defined and abs(self.values[recipe.size]) > FIT.certain * self.size_std

    def build(self) -> Effect:
        """Return the effect."""
        return self.candidate.build(self.values)

    @property
    def key(self) -> tuple[str, str]:
        """What it is, apart from its size."""
        return self.candidate.effect, self.candidate.station


@dataclasses.dataclass(frozen=True)
class Fitted:
    """Effects fitted together."""

    effects: tuple[FittedEffect, ...]
    misfit: float  # sum of squared whitened residuals
    template: np.ndarray  # what they add, whitened
    evidence: float  # log evidence over no effect at all
    linearised: 'Linearised | None' = None  # with which it was fitted

    def build(self) -> list[Effect]:
        """Return the effects."""
        return [e.build() for e in self.effects]

    @property
    def start(self) -> list[tuple[Candidate, dict[str, float]]]:
        """The effects with the present values of their parameters, where another fit may begin."""
        return [(e.candidate, e.values) for e in self.effects]

    @property
    def spans(self) -> list[slice]:
        """Where the parameters of each effect stand among those of all, see `Fitting.slopes`."""
        ends = itertools.accumulate((len(e.candidate.free) for e in self.effects), initial=0)
        return [slice(first, end) for first, end in itertools.pairwise(ends)]

    def with_widened(self, widened: Sequence[dict[str, tuple[float, float]]]) -> 'Fitted':
        """Return the same with other values and standard deviations of the first effects' parameters."""
        rest: list[dict[str, tuple[float, float]]] = [{}] * (len(self.effects) - len(widened))
        pairs = zip(self.effects, [*widened, *rest], strict=True)
        return dataclasses.replace(self, effects=tuple(dataclasses.replace(e, widened=w) for e, w in pairs))

    @property
    def certain(self) -> bool:
        """False where one of the effects may as well be absent or another one."""
        return all(e.certain for e in self.effects)

    @property
    def keys(self) -> tuple[tuple[str, str], ...]:
        """What the effects are, apart from their sizes, in order."""
        return tuple(sorted(e.key for e in self.effects))

    @property
    def free(self) -> tuple[tuple[str, ...], ...]:
        """Names of the parameters that are fitted, in order: one kind of effect may have several sets."""
        return tuple(sorted(e.candidate.free for e in self.effects))

    @property
    def freedom(self) -> int:
        """Number of parameters that are fitted."""
        return sum(map(len, self.free))


class Freedom:
    """What the parameters of an explanation can follow to first order."""

    def __init__(self, slopes: np.ndarray) -> None:
        """Take the whitened derivatives of a template by its parameters (P, n)."""
        self.slopes = slopes
        self._inverse = scaled_inverse(slopes @ slopes.T)

    def left(self, values: np.ndarray) -> np.ndarray:
        """Return what they cannot follow of whitened values (..., n)."""
        return values - (values @ self.slopes.T) @ self._inverse @ self.slopes

    def followed(self, values: np.ndarray) -> np.ndarray:
        """Return the squared length of what they follow of whitened values (..., n)."""
        return self.power(values @ self.slopes.T)

    def power(self, along: np.ndarray) -> np.ndarray:
        """Return the squared length of what they follow of values by these values' products with `slopes` (..., P)."""
        return np.einsum('...p,pq,...q->...', along, self._inverse, along)


@dataclasses.dataclass(frozen=True)
class Linearised:
    """What the distortions and bursts of an explanation add to it, to first order in their own parameters.

    Simulating them takes most of the time of a fit. Beside effects that hardly change the lines they stay as they are.
    """

    effects: tuple[FittedEffect, ...]  # of the explanation
    added: np.ndarray  # by those that distort or come and go, whitened (n,)
    slopes: Mapping[tuple[int, str], np.ndarray]  # of that, by the number among these effects and the parameter's name

    @property
    def acting(self) -> tuple[FittedEffect, ...]:
        """Those effects that distort the IF or come and go."""
        return tuple(e for e in self.effects if e.candidate.acts)

    def template(self, values: Sequence[dict[str, float]]) -> np.ndarray:
        """Return what they add with other values of their parameters (n,)."""
        own = self.acting
        changes = ((values[i][name] - own[i].values[name]) * slope for (i, name), slope in self.slopes.items())
        return sum(changes, self.added)

    def holds(self, values: Sequence[dict[str, float]]) -> bool:
        """Return whether their parameters have hardly changed."""
        own = self.acting
        return all(
            abs(values[i][name] - own[i].values[name]) <= FIT.linear * own[i].stds[name] for i, name in self.slopes
        )


def series_of(entries: Entries) -> np.ndarray:
    """Return which series each number belongs to (n,): one kind at one station."""
    _, series = np.unique(np.char.add(entries.kind, entries.station.astype('U4')), return_inverse=True)
    return series


def rows_of_series(entries: Entries) -> list[np.ndarray]:
    """Return where the numbers of each series stand, in its order: one kind at one station."""
    series = series_of(entries)
    return [np.flatnonzero(series == number) for number in range(int(series.max()) + 1)]


def cells_of(entries: Entries) -> np.ndarray:
    """Return the number of each number's cell (n,): one kind at one station in one group of sweeps."""
    cells: np.ndarray = series_of(entries) * (entries.group.max() + 1) + entries.group
    return cells
