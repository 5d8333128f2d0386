"""The air on the path differs from that at the weather station."""

import dataclasses

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of, Stated


@dataclasses.dataclass(frozen=True)
class AirRefractivity(Effect, name='air_refractivity', of=Of.PATH):
    """Difference between the path's refractivity and that of the measured weather (gradients, a sensor in the sun)."""

    acts_on = ActsOn.DELAY
    formula = 'n → n + 10⁻⁶ offset; τ → τ + 10⁻⁶ offset R / c, 1 N-unit is 1 mm per km'
    example = {'offset': 10.0}
    error_of = Stated.AIR
    recipes = (Recipe('offset', {'offset': 20.0}, {'offset': 100.0}),)

    offset: float = parameter(
        unit='1e-6', bounds=(-500.0, 500.0), description='difference in N-units, added to the refractivity'
    )

    def prepare(self, m: Measurements) -> None:
        """Slow down the light on every path."""
        extra = 1e-6 * self.offset
        for path in m.paths:
            path.delay = path.delay + extra * m.range / SPEED_OF_LIGHT
            path.rate = path.rate * (1.0 + extra / m.refractive_index)
            path.acceleration = path.acceleration * (1.0 + extra / m.refractive_index)
        m.refractive_index = m.refractive_index + extra
