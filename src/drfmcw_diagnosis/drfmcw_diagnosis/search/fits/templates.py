"""Templates: what effects add to one comparison, single ones as amid an explanation.

In: effects. Out: what they add to the model, over the standard deviations of the data. A reflection follows the true
distance, and a distortion acts on the lines, so both are simulated where an explanation has the crane, as loud as it
has the lines, and beside its distortions of the same receiver.
"""

import collections
import contextlib
import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from drfmcw_physics.constants import DECIBELS_PER_NEPER
from drfmcw_sim.effects import Effect

from ...compare.comparison import Comparison
from ...compare.groups import changes_distance, follows_distance
from .fitted import Fitted
from .limits import FIT


def _key(effect: Effect) -> tuple[type[Effect], str]:
    return type(effect), effect.station


@dataclasses.dataclass(frozen=True)
class _Amid:
    """Effects amid which single ones are simulated, with their template (n,)."""

    effects: tuple[Effect, ...] = ()
    template: np.ndarray | float = 0.0


class Templates:
    """Simulates what effects add to one comparison."""

    def __init__(self, comparison: Comparison) -> None:
        """Remember recording and model; nothing stands around single effects yet."""
        self.comparison = comparison
        self._place, self._level = _Amid(), _Amid()
        self._levels: collections.deque[_Amid] = collections.deque([_Amid()], FIT.levels)
        self._distorting: tuple[Effect, ...] = ()
        self._distorted: dict[tuple[Effect, ...], _Amid] = {}  # what stands for lines and distortions

    @contextlib.contextmanager
    def amid(self, fitted: Fitted | None) -> Iterator[None]:
        """Simulate single effects as amid an explanation: reflections where it has the crane, distortions of its lines.

        The model without effects has the crane where the reference has it, lines as strong as the link makes them, and
        receivers that do not distort.
        """
        effects = fitted.build() if fitted is not None else []
        before = self._place, self._level, self._distorting
        self._place = self._context(filter(changes_distance, effects))
        self._level = self._about_as_loud(self._context(filter(self._changes_level, effects)))
        self._distorting = tuple(effect for effect in effects if effect.distorts)
        try:
            yield
        finally:
            self._place, self._level, self._distorting = before

    def _context(self, effects: Iterable[Effect]) -> _Amid:
        """Return effects with their template."""
        found = tuple(effects)
        return _Amid(found, self.comparison.template(found)) if found else _Amid()

    def _changes_level(self, effect: Effect) -> bool:
        """Return whether an effect changes the level of lines enough to change what a distortion of them does."""
        if effect.distorts or effect.bursts:
            return False
        return self._loudest(self.comparison.template([effect])) > FIT.louder

    def _about_as_loud(self, level: _Amid) -> _Amid:
        """Return one of the newest levels where it is about the same: distortions simulated beside it are kept."""
        for known in self._levels:
            if self._loudest(level.template - known.template) < FIT.as_loud:
                return known
        self._levels.append(level)
        return level

    def _loudest(self, template: np.ndarray | float) -> float:
        """Return the largest change of the lines' level in any group, or of its peak within the sweep [dB].

        What rises and falls over the sweep as a cosine has a peak of sqrt(2) times its rms.
        """
        c = self.comparison
        values = np.broadcast_to(template, len(c.residual))
        level = self._over_stations(values, 'amplitude')[..., None]
        over_sweep = self._over_stations(values, 'ramp')[:, : level.shape[1]]  # the first channels are log amplitudes
        ripple = DECIBELS_PER_NEPER * np.sqrt(2.0 * np.mean(over_sweep**2, axis=-1, keepdims=True))
        return float(np.max(np.abs(level) + ripple, initial=0.0))

    def _over_stations(self, values: np.ndarray, kind: str) -> np.ndarray:
        """Return what values over standard deviations (n,) are in a kind of number, 0 where it is not compared."""
        std = np.asarray(self.comparison.std[kind])
        scaled: np.ndarray = values[self.comparison.entries.where(kind=kind)].reshape(std.shape)
        return scaled * np.where(np.isfinite(std), std, 0.0)

    def _around(self, effects: Sequence[Effect]) -> _Amid:
        """Return amid which effects some are simulated."""
        known = set(map(_key, effects))
        if effects and all(map(follows_distance, effects)):
            own = known.intersection(map(_key, self._place.effects))  # a fit of the place itself has them once
            return _Amid() if own else self._place
        if effects and all(effect.distorts for effect in effects):
            others = [
                other
                for other in self._distorting
                if _key(other) not in known and any(not e.station or other.applies_to(e.station) for e in effects)
            ]
            return self._beside(others) if others else self._level
        return _Amid()

    def _beside(self, distortions: Sequence[Effect]) -> _Amid:
        """Return distortions of the lines as loud as an explanation has them, or about the same ones simulated before.

        What another distortion adds beside them hardly changes while they hardly do.
        """
        effects = *self._level.effects, *distortions
        if effects not in self._distorted:
            found = self._context(effects)
            most = FIT.as_distorted * float(np.sum((found.template - self._level.template) ** 2))
            about_the_same = (
                known
                for known in self._distorted.values()
                if list(map(_key, known.effects)) == list(map(_key, effects))
                and float(np.sum((found.template - known.template) ** 2)) < most
            )
            self._distorted[effects] = next(about_the_same, found)
            while len(self._distorted) > FIT.levels:
                del self._distorted[next(iter(self._distorted))]
        return self._distorted[effects]

    def _template(self, effects: Sequence[Effect], around: tuple[Effect, ...] | None = None) -> np.ndarray:
        amid = self._around(effects)
        if amid.effects:
            return self.comparison.template((*amid.effects, *effects), around) - amid.template
        return self.comparison.template(effects, around)
