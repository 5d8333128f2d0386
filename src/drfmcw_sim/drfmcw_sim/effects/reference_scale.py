"""The reference has another metre."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from .base import Effect


@dataclasses.dataclass(frozen=True)
class ReferenceScale(Effect, name='reference_scale', of='reference'):
    """Error of the reference instrument in proportion to the distance."""

    acts_on = 'reference'
    formula = 'reading = R (1 + 10⁻⁶ scale)'
    example = {'scale': 20.0}

    scale: float = parameter(unit='ppm', bounds=(-1e5, 1e5), description='of the distance, added to each reading')

    def reference_error(
        self,
        time: np.ndarray | float,
        distance: np.ndarray | float,
        distance_at: Callable[[np.ndarray | float], np.ndarray | float],
    ) -> np.ndarray | float:
        """Return the error of the reading [m]."""
        return 1e-6 * self.scale * distance
