"""The synthesiser hums."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Modulation, Station
from .base import Effect
from .recipe import Recipe
from .sweep_ripple import SweepRipple
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class FrequencyModulation(Effect, name='frequency_modulation', of=Of.STATION):
    """Sinusoidal frequency error in true time, not locked to the sweep (mains hum, vibration). Its phase is random."""

    acts_on = ActsOn.PHASE
    formula = 'δf(u) = deviation sin(2π rate u + ψ), ψ uniform in each sweep, the same for both receivers'
    example = {'deviation': 200.0, 'rate': 5000.0}
    fluctuates = True
    recipes = (
        Recipe(
            'deviation',
            start={'deviation': 5.0},
            prior={'deviation': 2e3, 'rate': 5e4},
            order=2,
            limits={'deviation': (0.0, 1e8)},
            steps={'rate': 5.0},
            scan='rhythm',
            scanned='rate',
            cells=60,
            repeats=True,
            trust={'deviation': 0.1},  # it raises the noise around it too, which it is compared with
        ),
    )

    deviation: float = parameter(unit='Hz', bounds=(-1e9, 1e9), description='peak of the frequency error')
    rate: float = parameter(unit='Hz', bounds=(1e-3, 1e9), description='frequency of the sine')

    def in_one_sweep(self, turn: float) -> Effect:
        """Return the ripple that the sine is in a sweep in which it starts at this phase."""
        return SweepRipple(self.deviation, self.rate, 2.0 * np.pi * turn, station=self.station)

    def draw(self, station: Station, streams: Callable[[], list[np.random.Generator]]) -> None:
        """Draw the phases of the sine."""
        phase = 2.0 * np.pi * np.array([generator.random() for generator in streams()])
        station.modulations += (Modulation(self.deviation, self.rate, phase),)
