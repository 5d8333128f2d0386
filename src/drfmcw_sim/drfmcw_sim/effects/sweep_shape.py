"""The ramp's rate changes over the band."""

import dataclasses

import numpy as np

from drfmcw_physics.settings import ConfigurationError, parameter
from drfmcw_physics.sweep import SweepSettings

from ..measurements import Station
from .base import Effect
from .clocks import own_time
from .recipe import Recipe
from .splines import DEGREE, coefficients, excess
from .traits import ActsOn, Of


@dataclasses.dataclass(frozen=True)
class SweepShape(Effect, name='sweep_shape', of=Of.STATION):
    """Relative rate of the ramp as a cubic B-spline over the nominal frequency (a VCO's tuning curve).

    The knots are uniform and clamped at the band's ends, so the first and last coefficients are the relative rates
    there. The spline is divided by its mean, so the ramp ends at the stated frequency.
    """

    evidence = 'rate'
    acts_on = ActsOn.PHASE
    formula = "f'(t) = k r(x), r(x) = Σ relative_rate[i] Bᵢ(x) / mean, x = (f_nominal(t) − f₀) / B = t / T"
    example = {'relative_rate': [1.00002, 1.0, 0.99999, 1.0, 1.00001]}
    shapes_chirp = True
    recipes = (
        Recipe(
            '',
            start={'relative_rate': 1.0},
            prior={'relative_rate': 1e-3},
            steps={'relative_rate': 1e-6},
            coefficients=(5, 8, 12),
        ),
    )

    relative_rate: list[float] = parameter(bounds=(0.01, 100.0), description='coefficients of the spline, 4 or more')

    def __post_init__(self) -> None:
        """Refuse fewer coefficients than a cubic needs."""
        if len(self.relative_rate) <= DEGREE:
            raise ConfigurationError(f'relative_rate has {len(self.relative_rate)} coefficients; too few for a cubic')

    def chirp_phase(self, station: Station, u: np.ndarray) -> np.ndarray:
        """Return the integral of the frequency error over the station's own time [rad]."""
        duration = station.sweep.ramp_duration
        x = own_time(station, u) / duration
        return (2.0 * np.pi * station.sweep.chirp_rate * duration**2) * excess(tuple(self.relative_rate))(x)

    @classmethod
    def imitating(cls, phase: np.ndarray, sweep: SweepSettings, count: int) -> list[float]:
        """Return coefficients with which the ramp bends as a phase does; arguments as `Effect.imitating`."""
        return coefficients(phase / (2.0 * np.pi * sweep.chirp_rate * sweep.ramp_duration**2), count)
