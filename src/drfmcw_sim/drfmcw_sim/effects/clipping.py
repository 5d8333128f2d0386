"""The receiver clips."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from ..signal_model import Measurements, Station
from .base import Effect, Stage


@dataclasses.dataclass(frozen=True)
class Clipping(Effect, name='clipping', of='station'):
    """Hard limit in front of the ADC, of I and Q each in a quadrature receiver."""

    acts_on = 'samples'
    formula = 'x → max(−L, min(x, L)), L = 10^(level / 20) of full scale'
    example = {'level': -42.0}
    stage = Stage.LIMITER

    level: float = parameter(
        unit='dBFS', bounds=(-200.0, 100.0), description='limit; the amplitude of a full-scale sine is 0 dBFS'
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
