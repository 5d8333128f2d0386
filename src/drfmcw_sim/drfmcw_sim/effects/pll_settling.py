"""The synthesiser settles as the ramp starts."""

import dataclasses

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Station
from .base import Effect
from .clocks import own_time
from .recipe import Recipe, geometric
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class PllSettling(Effect, name='pll_settling', of=Of.STATION):
    """Damped oscillation of a second-order loop, which begins with a step of the frequency at the start of the ramp."""

    title = 'PLL settling'
    acts_on = ActsOn.PHASE
    formula = 'δf(t) = step exp(−2π d fₙ t) cos(2π fₙ √(1 − d²) t), φ = 2π ∫₀ᵗ δf'
    example = {'step': 20000.0, 'natural_frequency': 20000.0, 'damping': 0.5}
    shapes_chirp = True
    recipes = (
        Recipe(
            'step',
            start={'step': 500.0},
            prior={'step': 1e5, 'natural_frequency': 5e4, 'damping': 1.0},
            grid={'natural_frequency': geometric(2e3, 6e4, 12), 'damping': (0.15, 0.35, 0.7)},
            defining=('damping',),
        ),
    )

    step: float = parameter(unit='Hz', bounds=(-1e9, 1e9), description='frequency error at the start of the ramp')
    natural_frequency: float = parameter(unit='Hz', bounds=(10.0, 1e9), description='natural frequency fₙ of the loop')
    damping: float = parameter(bounds=(0.0, 1.0), description='damping d of the loop; 1 is critical in this formula')

    def chirp_phase(self, station: Station, u: np.ndarray) -> np.ndarray:
        """Return the integral of the frequency error over the station's own time [rad]."""
        t = np.maximum(own_time(station, u), 0.0)  # nothing before the ramp, where the exponential would overflow
        decay = 2.0 * np.pi * self.natural_frequency * self.damping
        turn = 2.0 * np.pi * self.natural_frequency * np.sqrt(1.0 - self.damping**2)
        # real part of the integral of exp((-decay + j turn) t)
        left = decay * np.cos(turn * t) - turn * np.sin(turn * t)
        left *= np.exp(-decay * t)
        return (2.0 * np.pi * self.step / (decay**2 + turn**2)) * (decay - left)
