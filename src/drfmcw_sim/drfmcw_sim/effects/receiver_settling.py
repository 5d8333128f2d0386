"""The receiver settles as the sweep starts."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Station
from .base import Effect
from .recipe import Recipe, geometric
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class ReceiverSettling(Effect, name='receiver_settling', of=Of.STATION):
    """Exponential in the IF from the sweep's start (a switched amplifier, a capacitor), the same in each sweep."""

    acts_on = ActsOn.SAMPLES
    formula = 'x → x + s 10^(level / 20) exp(−t / time_constant), s full scale'
    example = {'level': -30.0, 'time_constant': 1e-4}
    recipes = (
        Recipe(
            'level',
            start={'level': -80.0},
            prior={'level': 20.0, 'time_constant': 1e-3},
            grid={'time_constant': geometric(5e-6, 2e-3, 9)},
            defining=('time_constant',),  # one that is not determined is a constant: leakage
            decibel=True,
            within_sweep=('time_constant',),  # a longer one is leakage
            steps={'level': 0.05},
        ),
    )

    level: float = parameter(
        unit='dBFS', bounds=(-200.0, 40.0), description="amplitude at the sweep's start; full scale is 0 dBFS"
    )
    time_constant: float = parameter(
        unit='s', bounds=(1e-9, 1e3), description='time in which the exponential falls to 1/e'
    )

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Add the exponential (to I of a quadrature receiver)."""
        u = np.arange(station.sweep.sample_count) / (station.sweep.sample_rate * station.sample_clock[:, None])
        target = signal[..., 0] if station.iq else signal
        target += np.float32(station.full_scale * 10.0 ** (self.level / 20.0)) * np.exp(-u / self.time_constant)
