"""The path has a constant delay that the calibration leaves out."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of, Stated


@dataclasses.dataclass(frozen=True)
class DelayOffset(Effect, name='delay_offset', of=Of.PATH):
    """Constant delay of the whole path in addition to the calibrated one (a longer cable)."""

    acts_on = ActsOn.DELAY
    formula = 'τ → τ + 10⁻⁹ delay'
    example = {'delay': 0.1}
    movable = True
    of_hardware = True
    error_of = Stated.DELAY
    recipes = (Recipe('delay', {'delay': 0.3}, {'delay': 10.0}),)

    delay: float = parameter(unit='ns', bounds=(-1e3, 1e3), description='added to the delay of the path')

    def prepare(self, m: Measurements) -> None:
        """Lengthen every path."""
        for path in m.paths:
            path.delay += 1e-9 * self.delay
