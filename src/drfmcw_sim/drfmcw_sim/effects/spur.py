"""The IF holds an unmodulated line."""

import dataclasses
from collections.abc import Callable

import numpy as np

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Station
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class Spur(Effect, name='spur', of=Of.STATION):
    """Free-running line (switching regulator, clock harmonic) with a random phase in each sweep."""

    acts_on = ActsOn.SAMPLES
    formula = 'x → x + s 10^(level / 20) cos(2π frequency t + φ), φ uniform in each sweep, s full scale'
    example = {'frequency': 300000.0, 'level': -70.0}
    recipes = (
        Recipe(
            'level',
            start={'level': -80.0},
            prior={'level': 20.0, 'frequency': 5e5},
            decibel=True,
            steps={'frequency': 20.0, 'level': 0.05},
            scan='narrow line',
            scanned='frequency',
            cells=1000,
            repeats=True,
        ),
    )

    frequency: float = parameter(unit='Hz', bounds=(0.0, 1e10), description='frequency of the line in the IF')
    level: float = parameter(unit='dBFS', bounds=(-200.0, 20.0), description='amplitude; a full-scale sine is 0 dBFS')

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Add the line."""
        start = np.array([generator.random() for generator in streams()])
        n = np.arange(station.sweep.sample_count)
        turns = start[:, None] + n * (self.frequency / station.sweep.sample_rate / station.sample_clock[:, None])
        angle = (2.0 * np.pi * (turns - np.rint(turns))).astype(np.float32)
        amplitude = np.float32(station.full_scale * 10.0 ** (self.level / 20.0))
        if station.iq:
            signal[..., 0] += amplitude * np.cos(angle)
            signal[..., 1] += amplitude * np.sin(angle)
        else:
            signal += amplitude * np.cos(angle)
