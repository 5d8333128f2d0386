"""The receiver makes even harmonics."""

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
    """Second-order curve of the IF amplifier, for I and Q each; its harmonics alias as those of hardware do."""

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
            steps={'second_order': 0.005},
            scan='even harmonics',
            scanned='second_order',
            together=True,
        ),
    )

    second_order: float = parameter(bounds=(-100.0, 100.0), description='c; positive raises the mean')

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Apply the curve."""
        signal += np.float32(self.second_order / station.full_scale) * (signal * signal)
