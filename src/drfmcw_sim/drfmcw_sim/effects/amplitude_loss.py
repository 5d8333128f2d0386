"""The received signal is weaker than the link budget predicts."""

import dataclasses

from drfmcw_physics.settings import parameter

from ..measurements import Measurements
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of, Stage


@dataclasses.dataclass(frozen=True)
class AmplitudeLoss(Effect, name='amplitude_loss', of=Of.PATH):
    """Loss of the path in addition to that of free space: constant (alignment), per distance (rain), or both."""

    acts_on = ActsOn.AMPLITUDE
    formula = 'P_rx → P_rx − loss − specific R'
    example = {'loss': 6.0}
    stage = Stage.PATHS
    movable = True
    recipes = (
        # single precision holds no stronger line
        Recipe('loss', {'loss': 0.2}, {'loss': 10.0}, limits={'loss': (-45.0, 200.0)}),
        Recipe('specific', {'specific': 0.3}, {'specific': 20.0}),
    )

    loss: float = parameter(0.0, unit='dB', bounds=(-60.0, 200.0), description='loss at every distance')
    specific: float = parameter(0.0, unit='dB/km', bounds=(-100.0, 1000.0), description='loss per distance')

    def prepare(self, m: Measurements) -> None:
        """Lower the received power."""
        for station in m.stations:
            station.received_power -= self.loss + self.specific * m.range / 1e3
