"""The frequency of the reference oscillator follows the board temperature."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .clocks import shift_reference
from .recipe import Recipe
from .traits import ActsOn, Of, Stated


@dataclasses.dataclass(frozen=True)
class ReferenceClockTemperature(Effect, name='reference_clock_temperature', of=Of.STATION):
    """Error of alpha in proportion to board temperature minus calibration temperature. The ADC clock follows."""

    acts_on = ActsOn.CLOCK
    formula = 'α → α + 10⁻⁶ slope (board temperature − calibration temperature); ADC clock in proportion'
    example = {'slope': 0.1}
    error_of = Stated.CLOCK_SLOPE
    recipes = (Recipe('slope', {'slope': 0.02}, {'slope': 1.0}),)

    slope: float = parameter(
        unit='ppm/K', bounds=(-50.0, 50.0), description='change of alpha per kelvin of board temperature'
    )

    def prepare(self, m: Measurements) -> None:
        """Shift alpha and the ADC clock."""
        for station in self.own_stations(m):
            shift_reference(station, 1e-6 * self.slope * (station.temperature - station.calibration_temperature))
