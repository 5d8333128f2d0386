"""The reference has a wrong scale."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of, Stated


@dataclasses.dataclass(frozen=True)
class ReferenceScale(Effect, name='reference_scale', of=Of.REFERENCE):
    """Error of the reference instrument, proportional to the distance."""

    acts_on = ActsOn.REFERENCE
    formula = 'reading = R (1 + 10⁻⁶ scale)'
    example = {'scale': 20.0}
    error_of = Stated.REFERENCE_SCALE
    recipes = (Recipe('scale', {'scale': 2.0}, {'scale': 200.0}),)

    scale: float = parameter(
        unit='ppm', bounds=(-1e5, 1e5), description='error over the distance, added to each reading'
    )

    def reference_error(
        self,
        time: np.ndarray | float,
        distance: np.ndarray | float,
        distance_at: Callable[[np.ndarray | float], np.ndarray | float],
    ) -> np.ndarray | float:
        """Return the error of the reading [m]."""
        return 1e-6 * self.scale * distance
