"""A constant delay that nobody calibrated."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..signal_model import Measurements
from .base import Effect


@dataclasses.dataclass(frozen=True)
class DelayOffset(Effect, name='delay_offset', of='path'):
    """Delay of the whole path beyond the calibrated one (a longer cable)."""

    acts_on = 'delay'
    formula = 'τ → τ + 10⁻⁹ delay'
    example = {'delay': 0.1}

    delay: float = parameter(unit='ns', bounds=(-1e3, 1e3), description='added to the delay of the path')

    def prepare(self, m: Measurements) -> None:
        """Lengthen every path."""
        for path in m.paths:
            path.delay += 1e-9 * self.delay
