"""The ramp ripples."""

import dataclasses

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Station
from .base import Effect
from .clocks import own_time
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class SweepRipple(Effect, name='sweep_ripple', of=Of.STATION):
    """Sinusoidal frequency error locked to the sweep (DAC steps, a coupled clock), in Hz of the station's own clock."""

    acts_on = ActsOn.PHASE
    formula = 'δf(t) = deviation sin(2π rate t + phase), φ = (deviation / rate) (cos phase − cos(2π rate t + phase))'
    example = {'deviation': 200.0, 'rate': 5000.0}
    shapes_chirp = True
    recipes = (
        Recipe(
            'deviation',
            start={'deviation': 20.0},
            prior={'deviation': 2e3, 'rate': 5e4, 'phase': 3.0},
            quadrature=('phase', np.pi / 2.0),
            steps={'rate': 5.0, 'phase': 0.01},
            scan='ripple',
            scanned='rate',
            cells=60,
            repeats=True,
        ),
    )

    deviation: float = parameter(unit='Hz', bounds=(-1e9, 1e9), description='peak of the frequency error')
    rate: float = parameter(unit='Hz', bounds=(1.0, 1e9), description='frequency of the sine')
    phase: float = parameter(
        0.0, unit='rad', bounds=(-10.0, 10.0), description='phase of the sine at the start of the ramp'
    )

    def chirp_phase(self, station: Station, u: np.ndarray) -> np.ndarray:
        """Return the integral of the frequency error over the station's own time [rad]."""
        angle = (2.0 * np.pi * self.rate) * own_time(station, u) + self.phase
        return (self.deviation / self.rate) * (np.cos(self.phase) - np.cos(angle))
