"""The ramp is too fast or too slow."""

import dataclasses

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Station
from .base import Effect
from .clocks import own_time
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class SweepRate(Effect, name='sweep_rate', of=Of.STATION):
    """Error of the ramp's rate in the station's own clock. The ramp starts at the stated frequency."""

    acts_on = ActsOn.PHASE
    formula = 'δf(t) = error k t, φ = π error k t²'
    example = {'error': 0.001}
    shapes_chirp = True
    recipes = (Recipe('error', {'error': 1e-6}, {'error': 1e-3}),)

    error: float = parameter(
        unit='%', bounds=(-50.0, 50.0), description="error of the ramp's rate over the nominal rate"
    )

    def chirp_phase(self, station: Station, u: np.ndarray) -> np.ndarray:
        """Return the integral of the frequency error over the station's own time [rad]."""
        t = own_time(station, u)
        return (np.pi * 0.01 * self.error * station.sweep.chirp_rate) * (t * t)
