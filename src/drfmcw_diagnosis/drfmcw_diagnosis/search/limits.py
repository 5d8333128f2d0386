"""Constants of fits, with units; "chosen" is a judgement that only the tests and the proof have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class FitLimits:
    """How parameters are fitted."""

    flat: float = 1e-30
    """Curvature of a misfit that a parameter does not change [1]; chosen."""

    steps: int = 12
    """Steps of Levenberg and Marquardt's method, at most; chosen."""

    rounds: int = 4
    """Times, at most, that a distortion is computed anew on the other effects as they were fitted; chosen."""

    settled: float = 0.5
    """Squared change of a template [1] by a distortion computed anew, below which it need not be again; chosen."""

    settled_share: float = 1e-3
    """The same over the misfit [1], if that is more; chosen."""

    certain: float = 2.0
    """Standard deviations that an effect's size must have, and what makes it this effect; chosen."""


FIT = FitLimits()
