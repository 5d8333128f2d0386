"""Constants of fits, with units; "chosen" is a judgement that only the tests and the proof have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class FitLimits:
    """How parameters are fitted."""

    flat: float = 1e-30
    """Curvature of a misfit that a parameter does not change [1]; chosen."""

    steps: int = 12
    """Steps of Levenberg and Marquardt's method, at most; chosen."""

    certain: float = 2.0
    """Standard deviations that an effect's size must have, and what makes it this effect; chosen."""


FIT = FitLimits()
