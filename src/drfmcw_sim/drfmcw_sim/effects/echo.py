"""The signal also arrives over a second, longer path."""

import dataclasses
import math

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Path
from .base import Effect
from .motion import slowness
from .recipe import Recipe
from .traits import ActsOn, Of, Stage


@dataclasses.dataclass(frozen=True)
class Echo(Effect, name='echo', of=Of.PATH):
    """Reflector with a constant excess range. Its carrier phase is that of its length plus its own."""

    acts_on = ActsOn.DELAY | ActsOn.AMPLITUDE
    formula = (
        "second path of length R + excess_range, amplitude 10^(relative_power / 20) of the direct one's; "
        'phase turns its IF as a longer way does, at both stations'
    )
    example = {'excess_range': 7.5, 'relative_power': -30.0}
    stage = Stage.PATHS
    movable = True
    recipes = (
        Recipe(
            'relative_power',
            start={'relative_power': -50.0, 'phase': 0.0},
            prior={'relative_power': 20.0, 'excess_range': 100.0, 'phase': 3.0},
            decibel=True,
            quadrature=('phase', math.pi / 2.0),
            carrier=('phase', 'excess_range'),
            # shorter ones shape the sweep as a slope does; stronger ones are the direct path
            limits={'excess_range': (0.5, 1e5), 'relative_power': (-200.0, -6.0)},
            steps={'excess_range': 5e-3, 'relative_power': 0.05, 'phase': 0.02},
            scan='excess delay',
            scanned='excess_range',
            cells=350,
            repeats=True,
            fringes=True,
        ),
    )

    excess_range: float = parameter(
        unit='m', bounds=(0.0, 1e5), description='length in addition to that of the direct path'
    )
    relative_power: float = parameter(unit='dB', bounds=(-200.0, 20.0), description='power relative to the direct path')
    phase: float = parameter(
        0.0,
        unit='rad',
        bounds=(-10.0, 10.0),
        description='phase by which the reflector itself delays the carrier',
    )

    def prepare(self, m: Measurements) -> None:
        """Add the path."""
        direct = m.paths[0]
        m.paths.append(
            Path(
                direct.delay + self.excess_range * slowness(m),
                direct.rate.copy(),
                direct.acceleration.copy(),
                direct.amplitude * 10.0 ** (self.relative_power / 20.0),
                self.phase / (2.0 * math.pi),
            )
        )
