"""The reference is late."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from .base import Effect


@dataclasses.dataclass(frozen=True)
class ReferenceLag(Effect, name='reference_lag', of='reference'):
    """The reference tells where the crane was; where it stands, nothing changes."""

    acts_on = 'reference'
    formula = 'reading = R(t − lag), about R − v lag'
    example = {'lag': 0.1}

    lag: float = parameter(unit='s', bounds=(-60.0, 60.0), description='age of the distance that is read')

    def reference_error(
        self,
        time: np.ndarray | float,
        distance: np.ndarray | float,
        distance_at: Callable[[np.ndarray | float], np.ndarray | float],
    ) -> np.ndarray | float:
        """Return the error of the reading [m]."""
        return distance_at(time - self.lag) - distance
