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
    """Leakage over a short path. Mixed with itself, the chirp gives a constant, or after a delay a line at k delay.

    The oscillator's phase noise and the ramp's errors nearly cancel over so short a delay; the effect omits them.
    """

    title = 'TX leakage'
    evidence = 'leakage'
    acts_on = ActsOn.SAMPLES
    formula = 'x → x + s 10^(level / 20) cos 2π(f₀ delay + k delay (u − ½ delay)) while both are on, s full scale'
    example = {'level': -40.0}
    recipes = (
        Recipe('level', {'level': -70.0}, {'level': 20.0}, decibel=True, steps={'level': 0.05}),
        Recipe(
            'level',
            start={'level': -80.0},
            prior={'level': 20.0, 'delay': 200.0},
            defining=('delay',),
            decibel=True,
            steps={'level': 0.05, 'delay': 0.1},
            scan='line of the chirp',
            scanned='delay',
            cells=200,
        ),
    )

    level: float = parameter(
        unit='dBFS', bounds=(-200.0, 20.0), description='amplitude of the constant or line; ADC full scale is 0 dBFS'
    )
    delay: float = parameter(0.0, unit='ns', bounds=(0.0, 1e6), description='delay of the leakage; 0 gives a constant')

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Add the line, which a quadrature receiver sees as its own chirp times the conjugate of the leaked one."""
        sweep, delay = station.sweep, 1e-9 * self.delay
        u = np.arange(sweep.sample_count) / (sweep.sample_rate * station.sample_clock[:, None])
        alpha = station.alpha[:, None]
        on = (u >= delay) & (u <= sweep.ramp_duration / alpha)
        turns = alpha * delay * (sweep.start_frequency + alpha * sweep.chirp_rate * (u - 0.5 * delay))
        angle = (2.0 * np.pi * (turns - np.rint(turns))).astype(np.float32)
        amplitude = on * np.float32(station.full_scale * 10.0 ** (self.level / 20.0))
        if station.iq:
            signal[..., 0] += amplitude * np.cos(angle)
            signal[..., 1] += amplitude * np.sin(angle)
        else:
            signal += amplitude * np.cos(angle)
