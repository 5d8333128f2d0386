"""Constants of hypothetical measurements, with units; "chosen" is a judgement that only tests have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class FurtherLimits:
    """How further sweeps are simulated."""

    headroom: float = 6.0
    """By which a strong signal is attenuated below full scale [dB]; chosen."""

    sweeps: int = 12
    """Sweep pairs at each distance, at most; chosen."""

    distances: int = 5
    """Distances of further sweeps, at most; chosen."""

    predicted: int = 60
    """Predictions of each measurement that the time allows; chosen."""

    distorting: int = 8
    """Time that predicting a distortion takes, over that of other effects [1]; chosen."""


FURTHER = FurtherLimits()
