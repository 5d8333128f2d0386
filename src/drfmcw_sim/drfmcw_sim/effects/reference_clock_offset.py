"""The frequency of the reference oscillator differs from its calibration."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .clocks import shift_reference
from .recipe import Recipe
from .traits import ActsOn, Of, Stated


@dataclasses.dataclass(frozen=True)
class ReferenceClockOffset(Effect, name='reference_clock_offset', of=Of.STATION):
    """Constant error of the reference, added to the calibrated alpha. The ADC clock changes in proportion."""

    acts_on = ActsOn.CLOCK
    formula = 'α → α + 10⁻⁶ deviation; ADC clock in proportion'
    example = {'deviation': 2.0}
    error_of = Stated.CLOCK
    recipes = (Recipe('deviation', {'deviation': 0.2}, {'deviation': 20.0}),)

    deviation: float = parameter(unit='ppm', bounds=(-500.0, 500.0), description='error, added to the calibrated alpha')

    def prepare(self, m: Measurements) -> None:
        """Shift alpha and the ADC clock."""
        for station in self.own_stations(m):
            shift_reference(station, 1e-6 * self.deviation)
