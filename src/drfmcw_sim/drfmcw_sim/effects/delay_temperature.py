"""A station's hardware delay follows its board temperature."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of, Stated


@dataclasses.dataclass(frozen=True)
class DelayTemperature(Effect, name='delay_temperature', of=Of.STATION):
    """Delay of a station in proportion to its board temperature minus the calibration temperature."""

    acts_on = ActsOn.DELAY
    formula = 'τ → τ + 10⁻¹² slope (board temperature − calibration temperature)'
    example = {'slope': 5.0}
    error_of = Stated.DELAY_SLOPE
    recipes = (Recipe('slope', {'slope': 10.0}, {'slope': 50.0}),)

    slope: float = parameter(
        unit='ps/K', bounds=(-1e4, 1e4), description='change of the delay per kelvin of board temperature'
    )

    def prepare(self, m: Measurements) -> None:
        """Lengthen every path."""
        for station in self.own_stations(m):
            for path in m.paths:
                path.delay += 1e-12 * self.slope * (station.temperature - station.calibration_temperature)
