"""The ramp is bent."""

import dataclasses

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Station
from .base import Effect
from .clocks import own_time
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class SweepCurvature(Effect, name='sweep_curvature', of=Of.STATION):
    """Parabolic frequency error between the sweep's ends, in Hz of the station's own clock."""

    acts_on = ActsOn.PHASE
    formula = 'δf(t) = 4 deviation t (T − t) / T², φ = 4π deviation t² (1 − 2t / 3T) / T'
    example = {'deviation': 1000.0}
    shapes_chirp = True
    recipes = (Recipe('deviation', {'deviation': 50.0}, {'deviation': 1e4}),)

    deviation: float = parameter(
        unit='Hz',
        bounds=(-1e9, 1e9),
        description='frequency error at mid-sweep, against a straight ramp between the ends',
    )

    def chirp_phase(self, station: Station, u: np.ndarray) -> np.ndarray:
        """Return the integral of the frequency error over the station's own time [rad]."""
        x = own_time(station, u) / station.sweep.ramp_duration
        return (4.0 * np.pi * self.deviation * station.sweep.ramp_duration) * (x * x * (1.0 - (2.0 / 3.0) * x))
