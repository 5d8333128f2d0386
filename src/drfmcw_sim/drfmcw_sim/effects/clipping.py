"""The receiver clips."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Station
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of, Stage


@dataclasses.dataclass(frozen=True)
class Clipping(Effect, name='clipping', of=Of.STATION):
    """Hard limit in front of the ADC. In a quadrature receiver it limits I and Q separately."""

    evidence = 'limit'
    acts_on = ActsOn.SAMPLES
    formula = 'x → max(−L, min(x, L)), L = 10^(level / 20) of full scale'
    example = {'level': -42.0}
    stage = Stage.LIMITER
    distorts = True
    recipes = (
        Recipe(
            '',
            start={},
            prior={'level': 20.0},
            steps={'level': 0.1},
            scan='limit',
            scanned='level',
            cells=20,
            trust={'level': 0.05},
        ),
    )

    level: float = parameter(
        unit='dBFS', bounds=(-200.0, 100.0), description='limit; a full-scale sine has an amplitude of 0 dBFS'
    )

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Limit the signal."""
        limit = np.float32(station.full_scale * 10.0 ** (self.level / 20.0))
        np.clip(signal, -limit, limit, out=signal)
