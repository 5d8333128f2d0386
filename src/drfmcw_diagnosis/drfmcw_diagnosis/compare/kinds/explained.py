"""What a kind of number asks of an explanation, to say how far its forward model is trusted."""

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from ..recorded_sweeps import RecordedSweeps


@dataclasses.dataclass(frozen=True)
class Explained:
    """An explanation, as the doubt about forward models depends on it."""

    recorded: RecordedSweeps
    std: Mapping[str, np.ndarray]  # of the numbers of each kind
    trust: float  # to which forward models are trusted in general, relative to what they add
    distorting: bool  # one of its effects distorts the IF
    bursting: bool  # one of its effects comes and goes
    incoherence: float  # doubt that its effects cast on what both lines' noise has in common [1]
    uneven: Callable[[], np.ndarray]  # computes by how much its distortion makes noise uneven, see `Comparison.uneven`
    scattering: Callable[[], np.ndarray]  # computes how far it changes noise by chance, see `Comparison.scattering`
    changing: Callable[[], np.ndarray]  # computes by how much it makes the ramp change, see `Comparison.changing`
