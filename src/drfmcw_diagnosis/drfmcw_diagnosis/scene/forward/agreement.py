"""Whether lines of different delays show what bends the ramp at the same size: an imitation by many lines does not."""

import dataclasses

import numpy as np

from .joint import Fitted, modelled, simulated
from .limits import NAMING
from .model import Scene
from .tracks import assembled, basis, slopes


@dataclasses.dataclass(frozen=True)
class Agreement:
    """Sizes of one effect that each line shows by itself, over the size fitted to all."""

    size: np.ndarray  # (L,) [1]
    std: np.ndarray  # (L,) by what the fit leaves [1]

    @property
    def beside(self) -> float:
        """Square of the signal-to-noise ratio of the size that all lines but the clearest show."""
        squares = (self.size / self.std) ** 2
        return float(squares.sum() - squares.max(initial=0.0))

    @property
    def uneven(self) -> float:
        """Share of the lines' squared sizes that is scatter beyond their standard deviations [1]."""
        weight = self.std**-2.0
        mean = np.sum(weight * self.size) / np.sum(weight)
        scatter = float(np.sum(weight * (self.size - mean) ** 2)) - (len(self.size) - 1.0)
        return max(scatter, 0.0) / float(np.sum(weight * self.size**2))

    @property
    def testable(self) -> bool:
        """Several lines show the effect."""
        return self.beside > NAMING.clear**2

    @property
    def agrees(self) -> bool:
        """Several lines show the effect, and at one size."""
        return self.testable and self.uneven < NAMING.uneven


def agreement(s: Scene, found: Fitted) -> Agreement | None:
    """Return the sizes that the lines show of the last effect of a fit, None of one that does not bend the ramp.

    The phase that it gives each line is scaled on its own; amplitudes and frequencies of all lines are fitted beside.
    """
    if not found.candidates or not found.candidates[-1].kind.shapes_chirp or len(found.tracks) < 2:
        return None
    sweeps = s.fitted
    solved, whole = modelled(sweeps, found.tracks, simulated(s, found.candidates))
    factor = simulated(s, found.candidates[-1:]).factors(found.tracks.at(sweeps.place))
    bent = solved.waves * 1j * np.unwrap(np.angle(factor), axis=-1) * solved.phasor[..., None]
    jacobian = np.concatenate([slopes(sweeps, solved), bent if sweeps.iq else bent.real], axis=1)
    b = basis(sweeps.place, found.tracks.frequency.shape[1])
    normal = assembled(sweeps, solved, whole, jacobian, b)
    inverse = normal.inverse(NAMING.ridge)
    each = s.floor.mean / (2.0 if sweeps.iq else 1.0) * max(found.misfit, 1.0)
    first = found.tracks.frequency.size
    std = np.sqrt(np.maximum(np.diag(inverse)[first:] * each, 1e-30))
    return Agreement(1.0 + (inverse @ normal.right)[first:], std)
