"""The synthesiser is noisier than the station reports."""

import dataclasses
import math

from drfmcw_physics.phase_noise import PhaseNoise as Oscillator
from drfmcw_physics.settings import ConfigurationError, parameter

from ..measurements import Measurements
from .base import Effect
from .recipe import Recipe
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class PhaseNoise(Effect, name='phase_noise', of=Of.STATION):
    """Phase noise that replaces the reported one: its level, its corner, or both."""

    acts_on = ActsOn.NOISE
    formula = 'L(f) = L₀ / (1 + (f / corner)²), L(100 kHz) = level'
    example = {'level': -80.0}
    recipes = (
        Recipe(
            '',
            start={},
            prior={'level': 5.0, 'corner': 1e5},
            grid={'level': (-2.0, -0.5, 0.5, 2.0), 'corner': (0.5, 1.0, 2.0)},  # over and times the calibrated ones
            steps={'level': 0.1, 'corner': 2e3},
            together=True,
            added_to={'level': 'phase_noise_level'},
            times={'corner': 'phase_noise_corner'},
            # no synthesiser's loop is wider; such noise would take power from the line unseen, as a loss does
            limits={'corner': (100.0, 1e6)},
            trust={'level': 0.15, 'corner': 0.03},
        ),
    )

    level: float = parameter(
        math.nan,
        unit='dBc/Hz',
        bounds=(-250.0, 0.0),
        nan_means='as reported',
        description='single-sideband level at 100 kHz',
    )
    corner: float = parameter(
        math.nan,
        unit='Hz',
        bounds=(100.0, 1e9),
        nan_means='as reported',
        description='corner frequency of the one-pole shape',
    )

    def prepare(self, m: Measurements) -> None:
        """Replace the oscillator's noise.

        Raises:
            ConfigurationError: level or corner is missing, and the station reports no phase noise.
        """
        if math.isnan(self.level) and math.isnan(self.corner):
            return
        for station in self.own_stations(m):
            reported = station.phase_noise or Oscillator(math.nan, math.nan)
            level = reported.level if math.isnan(self.level) else self.level
            corner = reported.corner if math.isnan(self.corner) else self.corner
            if math.isnan(level) or math.isnan(corner):
                raise ConfigurationError(
                    f'phase_noise: {station.name} has no phase noise of its own, level and corner are needed'
                )
            station.phase_noise = Oscillator(level, corner)
