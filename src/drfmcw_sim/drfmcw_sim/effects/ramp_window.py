"""Only a part of the ramp is straight."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class RampWindow(Effect, name='ramp_window', of=Of.STATION):
    """Dead time and fly-back: outside the window neither receiver of the pair sees this station's ramp."""

    evidence = 'window'
    acts_on = ActsOn.AMPLITUDE
    formula = 'f(t) = f₀ + k t for start ≤ t ≤ end, t in the own clock; outside there is no IF of it'
    example = {'start': 5e-5, 'end': 9.5e-4}
    recipes = (
        Recipe('', {}, {'start': 1e-4}, steps={'start': 1e-6}, scan='ends', scanned='start'),
        Recipe('', {}, {'end': 1e-3}, steps={'end': 1e-6}, scan='ends', scanned='end'),
    )

    start: float = parameter(0.0, unit='s', bounds=(0.0, 100.0), description="of the window, from the sweep's start")
    end: float = parameter(100.0, unit='s', bounds=(0.0, 100.0), description="of the window, from the sweep's start")

    def prepare(self, m: Measurements) -> None:
        """Narrow the ramp."""
        for station in self.own_stations(m):
            first, last = station.straight
            station.straight = (max(first, self.start), min(last, self.end))
