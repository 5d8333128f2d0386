"""The ramp's rate changes over the band."""

import dataclasses
import functools

import numpy as np
from scipy.interpolate import BSpline, PPoly

from drfmcw_physics.settings import ConfigurationError, parameter

from ..measurements import Station
from .base import Effect
from .clocks import own_time
from .recipe import Recipe
from .traits import ActsOn, Of

_DEGREE = 3


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
        if len(self.relative_rate) <= _DEGREE:
            raise ConfigurationError(f'relative_rate has {len(self.relative_rate)} coefficients; too few for a cubic')

    def chirp_phase(self, station: Station, u: np.ndarray) -> np.ndarray:
        """Return the integral of the frequency error over the station's own time [rad]."""
        duration = station.sweep.ramp_duration
        x = own_time(station, u) / duration
        return (2.0 * np.pi * station.sweep.chirp_rate * duration**2) * _excess(tuple(self.relative_rate))(x)


@functools.lru_cache(maxsize=32)
def _excess(coefficients: tuple[float, ...]) -> PPoly:
    """Return the second integral of the relative rate less 1, over the elapsed share of the ramp.

    As polynomials, which take an eighth of the time of B-splines at the samples of a sweep.
    """
    inner = np.linspace(0.0, 1.0, len(coefficients) - _DEGREE + 1)
    knots = np.concatenate([np.zeros(_DEGREE), inner, np.ones(_DEGREE)])
    mean = float(BSpline(knots, np.array(coefficients), _DEGREE).integrate(0.0, 1.0))
    return PPoly.from_spline(BSpline(knots, np.array(coefficients) / mean - 1.0, _DEGREE).antiderivative(2))
