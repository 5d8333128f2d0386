"""The receiver is not linear."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Station
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of, Stage


@dataclasses.dataclass(frozen=True)
class Compression(Effect, name='compression', of=Of.STATION):
    """Third-order characteristic of the IF amplifier, for I and Q separately. Its harmonics alias as in hardware."""

    acts_on = ActsOn.SAMPLES
    formula = 'x → x − third_order x³, x = 1 at full scale; an amplitude A loses ¾ c A³ and gains ¼ c A³ at 3f'
    example = {'third_order': 0.1}
    stage = Stage.AMPLIFIER
    distorts = True
    recipes = (
        Recipe(
            '',
            start={},
            prior={'third_order': 0.3},
            least_steps={'third_order': 0.005},
            scan='odd harmonics',
            scanned='third_order',
            cells=10,
            tries=(-0.3, -0.1, -0.03, 0.03, 0.1, 0.3),  # shares of the strongest line that are lost
        ),
    )

    third_order: float = parameter(bounds=(-100.0, 100.0), description='coefficient c; a positive one compresses')

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Apply the characteristic."""
        signal -= np.float32(self.third_order / station.full_scale**2) * (signal * signal * signal)
