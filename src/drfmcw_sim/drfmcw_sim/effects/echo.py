"""A second, longer path."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..signal_model import Measurements, Path
from .base import Effect, Stage
from .motion import slowness


@dataclasses.dataclass(frozen=True)
class Echo(Effect, name='echo', of='path'):
    """A reflector beside the direct path, at constant excess range; its carrier phase follows from its length."""

    acts_on = 'delay, amplitude'
    formula = "second path of length R + excess_range, amplitude 10^(relative_power / 20) of the direct one's"
    example = {'excess_range': 7.5, 'relative_power': -30.0}
    stage = Stage.PATHS

    excess_range: float = parameter(unit='m', bounds=(0.0, 1e5), description='length beyond the direct path')
    relative_power: float = parameter(unit='dB', bounds=(-200.0, 20.0), description='power relative to the direct path')

    def prepare(self, m: Measurements) -> None:
        """Add the path."""
        direct = m.paths[0]
        m.paths.append(
            Path(
                direct.delay + self.excess_range * slowness(m),
                direct.rate.copy(),
                direct.acceleration.copy(),
                direct.amplitude * 10.0 ** (self.relative_power / 20.0),
            )
        )
