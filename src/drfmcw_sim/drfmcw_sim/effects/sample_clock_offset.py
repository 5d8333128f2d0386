"""The frequency of the ADC clock differs from its calibration."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of, Stated


@dataclasses.dataclass(frozen=True)
class SampleClockOffset(Effect, name='sample_clock_offset', of=Of.STATION):
    """Relative error of the ADC clock against its calibration. The chirp does not change."""

    acts_on = ActsOn.CLOCK
    formula = 'ADC clock → ADC clock (1 + 10⁻⁶ deviation)'
    example = {'deviation': 10.0}
    error_of = Stated.SAMPLE_CLOCK
    recipes = (
        Recipe(
            'deviation',
            start={'deviation': 5.0},
            prior={'deviation': 50.0},
            incoherence={'deviation': 0.05},  # noise is compared sample by sample, and the clocks run apart
        ),
    )

    deviation: float = parameter(unit='ppm', bounds=(-500.0, 500.0), description='relative error of the ADC clock')

    def prepare(self, m: Measurements) -> None:
        """Scale the ADC clock."""
        for station in self.own_stations(m):
            station.sample_clock *= 1.0 + 1e-6 * self.deviation
