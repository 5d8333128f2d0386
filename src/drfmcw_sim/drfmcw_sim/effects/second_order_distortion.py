"""The receiver generates even harmonics."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Station
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of, Stage


@dataclasses.dataclass(frozen=True)
class SecondOrderDistortion(Effect, name='second_order_distortion', of=Of.STATION):
    """Second-order characteristic of the IF amplifier, for I and Q separately. Its harmonics alias as in hardware."""

    title = 'second-order distortion'
    acts_on = ActsOn.SAMPLES
    formula = 'x → x + second_order x², x = 1 at full scale; an amplitude A makes ½ c A² at 2f and a mean of ½ c A²'
    example = {'second_order': 0.1}
    stage = Stage.AMPLIFIER
    distorts = True
    recipes = (
        Recipe(
            '',
            start={},
            prior={'second_order': 0.3},
            least_steps={'second_order': 0.005},
            scan='even harmonics',
            scanned='second_order',
            together=True,
        ),
    )

    second_order: float = parameter(bounds=(-100.0, 100.0), description='coefficient c; a positive one raises the mean')

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Apply the characteristic."""
        signal += np.float32(self.second_order / station.full_scale) * (signal * signal)
