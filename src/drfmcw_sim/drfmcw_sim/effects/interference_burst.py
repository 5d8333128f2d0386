"""Another transmitter crosses the band."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Station
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class InterferenceBurst(Effect, name='interference_burst', of=Of.STATION):
    """Burst of white noise in some sweeps. Its start is uniform over the record, whose end cuts it off."""

    evidence = 'bursts'
    acts_on = ActsOn.NOISE
    formula = 'x → x + s 10^(level / 20) √½ w(t) for t₀ ≤ t < t₀ + duration, w white with unit variance, s full scale'
    example = {'probability': 0.3, 'level': -40.0, 'duration': 5e-5}
    bursts = True
    recipes = (
        Recipe(
            '',
            start={'level': -50.0, 'duration': 5e-5},
            prior={'probability': 0.5, 'level': 20.0, 'duration': 1e-4},
            within_sweep=('duration',),
            each_sweep='probability',
            steps={'probability': 0.05, 'level': 0.5, 'duration': 1e-5},
            scan='bursts',
            scanned='probability',
            scanned_with=('level', 'duration'),
            cells=30,
            trust={'probability': 0.15, 'level': 1.0, 'duration': 0.25},
        ),
    )

    probability: float = parameter(bounds=(0.0, 1.0), description='probability that a sweep holds a burst')
    level: float = parameter(
        unit='dBFS', bounds=(-200.0, 40.0), description='power of the burst; that of a full-scale sine is 0 dBFS'
    )
    duration: float = parameter(unit='s', bounds=(0.0, 100.0), description='length of a burst')

    def in_each_sweep(self) -> tuple[Effect, float]:
        """Return bursts that come in every sweep, and the share of sweeps that hold one."""
        return dataclasses.replace(self, probability=1.0), self.probability

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Add the bursts; those in I and Q are independent."""
        if self.probability == 0.0:
            return
        count, rate = station.sweep.sample_count, station.sweep.sample_rate
        std = np.float32(station.full_scale * 10.0 ** (self.level / 20.0) * np.sqrt(0.5))
        for row, generator in enumerate(streams()):
            chance, start = generator.random(2)
            if chance >= self.probability:
                continue
            begin = int(np.ceil(start * count))
            end = int(np.ceil(min(start * count + self.duration * rate * station.sample_clock[row], count)))
            signal[row, begin:end] += std * generator.standard_normal(signal[row, begin:end].shape, dtype=np.float32)
