"""More additive noise than the station reports."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..signal_model import Measurements
from .base import Effect


@dataclasses.dataclass(frozen=True)
class NoiseFloor(Effect, name='noise_floor', of='station'):
    """Excess of the additive noise over the calibrated floor."""

    acts_on = 'noise'
    formula = 'noise density → noise density + excess'
    example = {'excess': 3.0}

    excess: float = parameter(unit='dB', bounds=(-60.0, 100.0), description='over the calibrated noise floor')

    def prepare(self, m: Measurements) -> None:
        """Raise the density."""
        for station in self.own_stations(m):
            station.noise_density += self.excess
