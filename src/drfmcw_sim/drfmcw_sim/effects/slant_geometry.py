"""The antennas hang at different heights."""

import dataclasses

import numpy as np

from drfmcw_physics.settings import parameter

from ..signal_model import Measurements
from .base import Effect, Stage
from .motion import hypotenuse_excess, move


@dataclasses.dataclass(frozen=True)
class SlantGeometry(Effect, name='slant_geometry', of='path'):
    """The reference (and the scenario) give the horizontal distance; the radar measures along the slant."""

    acts_on = 'delay, amplitude'
    formula = 'R → √(R² + height_difference²), the power by the square of the distance'
    example = {'height_difference': 5.0}
    stage = Stage.GEOMETRY

    height_difference: float = parameter(
        unit='m', bounds=(-1e4, 1e4), description='between the antennas; its sign does not matter'
    )

    def prepare(self, m: Measurements) -> None:
        """Lengthen the distance."""
        horizontal = np.maximum(m.range, 0.1)
        move(m, *hypotenuse_excess(m, self.height_difference**2))
        for station in m.stations:
            station.received_power = station.received_power - 20.0 * np.log10(np.maximum(m.range, 0.1) / horizontal)
