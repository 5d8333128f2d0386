"""The receiver adds more noise than the station reports."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class NoiseFloor(Effect, name='noise_floor', of=Of.STATION):
    """Additive noise in excess of the calibrated noise floor."""

    acts_on = ActsOn.NOISE
    formula = 'noise density → noise density + excess'
    example = {'excess': 3.0}
    recipes = (Recipe('', {}, {'excess': 10.0}, {'excess': (-1.0, 1.0, 6.0)}, steps={'excess': 0.05}, together=True),)

    excess: float = parameter(
        unit='dB', bounds=(-60.0, 100.0), description='power over that of the calibrated noise floor'
    )

    def prepare(self, m: Measurements) -> None:
        """Raise the density."""
        for station in self.own_stations(m):
            station.noise_density += self.excess
