"""I and Q of the receiver differ in gain or phase."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Station
from .base import Effect
from .traits import ActsOn, Of, Stage


@dataclasses.dataclass(frozen=True)
class IqImbalance(Effect, name='iq_imbalance', of=Of.STATION):
    """Error of Q against I turned by 90 degrees, in gain and phase: an image at -f. A real IF does not change."""

    title = 'IQ imbalance'
    evidence = 'image'
    acts_on = ActsOn.SAMPLES
    formula = 'Q → 10^(gain / 20) (Q cos phase − I sin phase), I as it is'
    example = {'gain': 0.5, 'phase': 2.0}
    stage = Stage.FILTER

    gain: float = parameter(0.0, unit='dB', bounds=(-60.0, 60.0), description='gain of Q over that of I')
    phase: float = parameter(
        0.0,
        unit='deg',
        bounds=(-90.0, 90.0),
        description='lag of Q behind I in addition to 90 degrees: Q is cos(D - 90 deg - phase)',
    )

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Mix I into Q, and amplify Q."""
        if not station.iq:
            return
        gain, phase = 10.0 ** (self.gain / 20.0), math.radians(self.phase)
        quadrature = signal[..., 1]
        quadrature *= np.float32(gain * math.cos(phase))
        quadrature -= np.float32(gain * math.sin(phase)) * signal[..., 0]
