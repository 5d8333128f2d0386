"""The crane moves during a sweep."""

import dataclasses

import numpy as np

from drfmcw_physics.settings import ConfigurationError, parameter

from ..measurements import Measurements
from .base import Effect
from .motion import move
from .recipe import Recipe
from .traits import ActsOn, Motion, Of


@dataclasses.dataclass(frozen=True)
class TargetMotion(Effect, name='target_motion', of=Of.PATH):
    """Velocity of the crane, which the reference distance of a sweep does not show: Doppler shift and movement."""

    acts_on = ActsOn.DELAY
    formula = "R(t) → R + velocity t, t since station 1's sweep starts; range error f_c velocity / k + velocity t"
    example = {'velocity': 0.5}
    motion = Motion.DRIVE
    recipes = (
        Recipe('velocity', {'velocity': 0.001}, {'velocity': 3.0}),
        Recipe('velocity', {'velocity': 0.001}, {'velocity': 3.0}, per_group=True),
    )

    velocity: list[float] = parameter(
        unit='m/s',
        bounds=(-1e3, 1e3),
        description='rate at which the distance grows: a number, or a list with one per distance of a standing crane',
    )

    def __post_init__(self) -> None:
        """Refuse an empty list."""
        if not self.velocity:
            raise ConfigurationError('velocity is empty')

    def prepare(self, m: Measurements) -> None:
        """Move the crane.

        Raises:
            ConfigurationError: fewer velocities than distances.
        """
        velocity = np.asarray(self.velocity)
        if len(velocity) > 1:
            setting = np.broadcast_to(m.setting, len(m))
            if setting.max() >= len(velocity):
                raise ConfigurationError(f'target_motion: {len(velocity)} velocities are too few for the distances')
            velocity = velocity[setting]
        move(m, velocity=velocity)
