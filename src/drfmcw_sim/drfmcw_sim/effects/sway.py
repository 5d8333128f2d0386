"""The antenna sways."""

import dataclasses

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .motion import move
from .recipe import Recipe
from .traits import ActsOn, Motion, Of


@dataclasses.dataclass(frozen=True)
class Sway(Effect, name='sway', of=Of.PATH):
    """Oscillation of the distance about that of the reference.

    The position, velocity and acceleration at its start describe each sweep. At time t within the sweep, this leaves an
    error of (2 pi frequency t)^3 / 6 of the amplitude.
    """

    acts_on = ActsOn.DELAY
    formula = 'R(t) → R(t) + amplitude sin(2π frequency t + phase), t since the start of the recording'
    example = {'amplitude': 0.005, 'frequency': 0.7}
    motion = Motion.SWAY
    recipes = (
        Recipe(
            'amplitude',
            start={'amplitude': 1e-4},
            prior={'amplitude': 0.5, 'frequency': 2.0, 'phase': 3.0},
            quadrature=('phase', np.pi / 2.0),
            limits={'frequency': (0.02, 50.0)},  # what takes longer than a minute is a drift
            steps={'frequency': 1e-5, 'phase': 0.01},
            scan='oscillation',
            scanned='frequency',
            cells=2500,
            lookalikes=True,
        ),
    )

    amplitude: float = parameter(unit='m', bounds=(-100.0, 100.0), description='amplitude of the distance')
    frequency: float = parameter(unit='Hz', bounds=(0.0, 50.0), description='frequency of the sway')
    phase: float = parameter(
        0.0, unit='rad', bounds=(-10.0, 10.0), description='phase of the sine at the start of the recording'
    )

    def prepare(self, m: Measurements) -> None:
        """Move the crane."""
        omega = 2.0 * np.pi * self.frequency
        angle = omega * m.time + self.phase
        position = self.amplitude * np.sin(angle)
        move(m, position, self.amplitude * omega * np.cos(angle), -(omega**2) * position)
