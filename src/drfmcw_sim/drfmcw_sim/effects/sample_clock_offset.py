"""The ADC clock runs off its calibration."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..signal_model import Measurements
from .base import Effect


@dataclasses.dataclass(frozen=True)
class SampleClockOffset(Effect, name='sample_clock_offset', of='station'):
    """Deviation of the ADC clock relative to its calibration; the chirp is not touched."""

    acts_on = 'clock'
    formula = 'ADC clock → ADC clock (1 + 10⁻⁶ deviation)'
    example = {'deviation': 10.0}

    deviation: float = parameter(
        unit='ppm', bounds=(-500.0, 500.0), description='of the ADC clock from its calibration'
    )

    def prepare(self, m: Measurements) -> None:
        """Scale the ADC clock."""
        for station in self.own_stations(m):
            station.sample_clock *= 1.0 + 1e-6 * self.deviation
