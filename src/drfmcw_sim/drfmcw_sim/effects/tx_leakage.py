"""A station's own transmit signal leaks into its receiver."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Station
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class TxLeakage(Effect, name='tx_leakage', of=Of.STATION):
    """Leakage over a path without delay: mixed with itself, the chirp gives a constant while it is on."""

    title = 'TX leakage'
    acts_on = ActsOn.SAMPLES
    formula = 'x → x + s 10^(level / 20) while the chirp is on, s full scale'
    example = {'level': -40.0}
    recipes = (Recipe('level', {'level': -70.0}, {'level': 20.0}, decibel=True, steps={'level': 0.05}),)

    level: float = parameter(
        unit='dBFS', bounds=(-200.0, 20.0), description='of the constant; ADC full scale is 0 dBFS'
    )

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Add the constant (to I of a quadrature receiver) while the station transmits."""
        n = np.arange(station.sweep.sample_count)
        on = n / (station.sweep.sample_rate * station.sample_clock[:, None]) <= (
            station.sweep.ramp_duration / station.alpha[:, None]
        )
        target = signal[..., 0] if station.iq else signal
        target += on * np.float32(station.full_scale * 10.0 ** (self.level / 20.0))
