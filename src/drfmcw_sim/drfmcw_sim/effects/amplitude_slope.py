"""The received signal falls over the ramp."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class AmplitudeSlope(Effect, name='amplitude_slope', of=Of.STATION):
    """Gain that changes with the frequency (antenna, mixer), for all paths. The receiver's noise stays the same."""

    evidence = 'slope'
    acts_on = ActsOn.AMPLITUDE
    formula = "P_rx → P_rx − slope t / T, t the station's own time since its ramp starts"
    example = {'slope': 1.0}
    recipes = (Recipe('slope', {'slope': 0.02}, {'slope': 3.0}, together=True),)

    slope: float = parameter(
        unit='dB',
        bounds=(-60.0, 60.0),
        description="loss of the received signal from the ramp's start to its end, linear in dB",
    )

    def prepare(self, m: Measurements) -> None:
        """Change the slope."""
        for station in self.own_stations(m):
            station.slope += self.slope
