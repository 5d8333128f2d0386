"""The reference oscillator ages or warms up."""

import dataclasses

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .clocks import shift_reference
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class ReferenceClockDrift(Effect, name='reference_clock_drift', of=Of.STATION):
    """Error of alpha that changes with time: a steady drift from the start, or a warm-up to the calibrated value."""

    acts_on = ActsOn.CLOCK
    formula = 'α → α + 10⁻⁶ (rate t / 3600 s + warmup exp(−t / time_constant)), t since the start'
    example = {'warmup': 2.0, 'time_constant': 300.0}
    recipes = (
        Recipe('rate', {'rate': 1.0}, {'rate': 50.0}),
        Recipe(
            'warmup',
            start={'warmup': 0.2},
            prior={'warmup': 10.0, 'time_constant': 300.0},
            grid={'time_constant': (10.0, 30.0, 100.0, 300.0)},
            within_recording=('time_constant',),  # a longer warm-up is an offset or a steady drift
        ),
    )

    rate: float = parameter(
        0.0,
        unit='ppm/h',
        bounds=(-1000.0, 1000.0),
        description='steady drift; alpha is the calibrated one at the start',
    )
    warmup: float = parameter(
        0.0, unit='ppm', bounds=(-100.0, 100.0), description='error at the start, which decays during the warm-up'
    )
    time_constant: float = parameter(300.0, unit='s', bounds=(1.0, 1e6), description='time constant of the warm-up')

    def prepare(self, m: Measurements) -> None:
        """Shift alpha and the ADC clock."""
        deviation = self.rate * m.time / 3600.0 + self.warmup * np.exp(-m.time / self.time_constant)
        for station in self.own_stations(m):
            shift_reference(station, 1e-6 * deviation)
