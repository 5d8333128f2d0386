"""The reference's readings are late."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class ReferenceLag(Effect, name='reference_lag', of=Of.REFERENCE):
    """The reference reports the distance of an earlier time. While the crane stands, this changes nothing."""

    acts_on = ActsOn.REFERENCE
    formula = 'reading = R(t − lag), about R − v lag'
    example = {'lag': 0.1}
    recipes = (Recipe('lag', {'lag': 0.01}, {'lag': 2.0}),)

    lag: float = parameter(unit='s', bounds=(-60.0, 60.0), description='age of the distance that a reading reports')

    def reference_error(
        self,
        time: np.ndarray | float,
        distance: np.ndarray | float,
        distance_at: Callable[[np.ndarray | float], np.ndarray | float],
    ) -> np.ndarray | float:
        """Return the error of the reading [m]."""
        return distance_at(time - self.lag) - distance
