"""The ground reflects a second ray."""

import dataclasses

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Path
from .base import Effect
from .motion import hypotenuse_excess, slowness
from .recipe import Recipe
from .traits import ActsOn, Of, Stage


@dataclasses.dataclass(frozen=True)
class GroundReflection(Effect, name='ground_reflection', of=Of.PATH):
    """Two-ray model over flat ground: a longer path with reversed sign. Its excess range changes with distance."""

    acts_on = ActsOn.DELAY | ActsOn.AMPLITUDE
    formula = 'second path of length √(R² + 4 h₁h₂), amplitude −coefficient relative to the direct path'
    example = {'height_product': 100.0, 'coefficient': 0.1}
    stage = Stage.PATHS
    recipes = (
        Recipe(
            'coefficient',
            start={'coefficient': 0.02},
            prior={'coefficient': 0.5, 'height_product': 100.0},
            defining=('height_product',),
            steps={'height_product': 0.003},
            scan='fringes over distance',
            scanned='height_product',
            cells=1000,
            fringes=True,
            lookalikes=True,
        ),
    )

    height_product: float = parameter(
        unit='m^2', bounds=(0.0, 1e6), description="product h1 h2 of the antennas' heights above the ground"
    )
    coefficient: float = parameter(
        bounds=(-1.0, 1.0), description='amplitude at the receiver relative to the direct path; its sign is reversed'
    )

    def prepare(self, m: Measurements) -> None:
        """Add the path."""
        direct, per_length = m.paths[0], slowness(m)
        excess, velocity, acceleration = hypotenuse_excess(m, 4.0 * self.height_product)
        m.paths.append(
            Path(
                direct.delay + excess * per_length,
                direct.rate + velocity * per_length,
                direct.acceleration + acceleration * per_length,
                np.full(len(m), -self.coefficient) * direct.amplitude,
            )
        )
