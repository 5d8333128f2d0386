"""The reference measures from another point."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of, Stated


@dataclasses.dataclass(frozen=True)
class ReferenceOffset(Effect, name='reference_offset', of=Of.REFERENCE):
    """Constant error of the reference instrument (antenna offset, prism constant)."""

    acts_on = ActsOn.REFERENCE
    formula = 'reading = R + offset'
    example = {'offset': 0.01}
    error_of = Stated.REFERENCE_ZERO
    recipes = (Recipe('offset', {'offset': 1e-3}, {'offset': 0.5}),)

    offset: float = parameter(unit='m', bounds=(-1e4, 1e4), description='error, added to each reading')

    def reference_error(
        self,
        time: np.ndarray | float,
        distance: np.ndarray | float,
        distance_at: Callable[[np.ndarray | float], np.ndarray | float],
    ) -> np.ndarray | float:
        """Return the error of the reading [m]."""
        return self.offset
