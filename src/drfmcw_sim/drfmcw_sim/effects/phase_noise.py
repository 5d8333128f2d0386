"""The synthesiser is noisier than the station reports."""

import dataclasses
import math

from drfmcw_physics.phase_noise import PhaseNoise as Oscillator
from drfmcw_physics.settings import ConfigurationError, parameter

from ..signal_model import Measurements
from .base import Effect


@dataclasses.dataclass(frozen=True)
class PhaseNoise(Effect, name='phase_noise', of='station'):
    """True phase noise in place of the reported one: its level, its corner, or both."""

    acts_on = 'noise'
    formula = 'L(f) = L₀ / (1 + (f / corner)²), L(100 kHz) = level'
    example = {'level': -80.0}

    level: float = parameter(
        math.nan,
        unit='dBc/Hz',
        bounds=(-250.0, 0.0),
        nan_means='as reported',
        description='single side-band at 100 kHz',
    )
    corner: float = parameter(
        math.nan, unit='Hz', bounds=(100.0, 1e9), nan_means='as reported', description='corner of the one-pole shape'
    )

    def prepare(self, m: Measurements) -> None:
        """Replace the oscillator's noise.

        Raises:
            ConfigurationError: one of the two left out at a station without phase noise.
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
