"""The antennas have different heights."""

import dataclasses

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .motion import hypotenuse_excess, move
from .recipe import Recipe
from .traits import ActsOn, Of, Stage


@dataclasses.dataclass(frozen=True)
class SlantGeometry(Effect, name='slant_geometry', of=Of.PATH):
    """The reference and the scenario give the horizontal distance. The radar measures along the slant."""

    acts_on = ActsOn.DELAY | ActsOn.AMPLITUDE
    formula = 'R → √(R² + height_difference²), the power falls with the square of the distance'
    example = {'height_difference': 5.0}
    stage = Stage.GEOMETRY
    recipes = (
        Recipe(
            '',
            start={},
            prior={'height_difference': 20.0},
            grid={'height_difference': (0.5, 1.0, 2.0, 5.0, 10.0)},
            limits={'height_difference': (0.1, 1e4)},  # its sign does not matter
            needs_reference=True,  # without one, the measured distance stands in for it: that along the slant
        ),
    )

    height_difference: float = parameter(
        unit='m',
        bounds=(-1e4, 1e4),
        description='difference between the heights of the antennas; its sign does not matter',
    )

    def prepare(self, m: Measurements) -> None:
        """Lengthen the distance."""
        horizontal = np.maximum(m.range, 0.1)
        move(m, *hypotenuse_excess(m, self.height_difference**2))
        for station in m.stations:
            station.received_power = station.received_power - 20.0 * np.log10(np.maximum(m.range, 0.1) / horizontal)
