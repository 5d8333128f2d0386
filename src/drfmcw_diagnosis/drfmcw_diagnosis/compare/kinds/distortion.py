"""What a distortion of the IF leaves: harmonics at the line's own phase, and samples piled up at a limit."""

import dataclasses

import numpy as np

from ...features import adc_codes
from ..groups import variance_factor
from ..limits import MODEL, SCATTER
from ..measuring import Evidence
from ..predicting import Expected
from .kind import Kind, Measured, Trust


@dataclasses.dataclass(frozen=True, kw_only=True)
class Harmonic(Kind):
    """Harmonics of the line over the line (G, S, 2 H): real, then imaginary parts; NaN where one cannot be measured."""

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean over each group."""
        return evidence.mean('harmonic'), _scatter(evidence) / evidence.roots[:, None, None]

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return those of sweeps without effects, and what a distortion adds."""
        plain = expected.plain.features.harmonic
        return plain + expected.distortion.harmonic if expected.distorting else plain


@dataclasses.dataclass(frozen=True, kw_only=True)
class Piled(Kind):
    """Samples of a sweep at its outermost codes, more than beside them (G, S)."""

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean over each group; not compared where noise does not make the histogram of codes smooth."""
        piled = evidence.mean('piled')
        std = np.where(_smooth(evidence), np.sqrt(piled + SCATTER.piled), np.inf)
        return piled, std / evidence.roots[:, None]

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return what a distortion piles up."""
        if expected.distorting:
            return expected.distortion.piled
        return np.zeros(expected.features.line.shape)


def _scatter(evidence: Evidence) -> np.ndarray:
    """Return by what harmonics scatter from sweep to sweep (G, S, 2 H), alike in both parts of each."""
    sweeps = evidence.recorded.sweeps
    if not evidence.recorded.scatters:
        return np.full((len(sweeps), *sweeps[0].harmonic.shape[1:]), np.inf)
    variance = np.array([s.harmonic.var(axis=0, ddof=1) for s in sweeps])
    both = variance.reshape(*variance.shape[:2], 2, -1).mean(axis=2)
    both *= variance_factor(2 * (evidence.counts - 1))[:, None, None]
    std: np.ndarray = np.sqrt(np.nan_to_num(np.tile(both, 2), nan=np.inf))
    return std


def _smooth(evidence: Evidence) -> np.ndarray:
    """Return at which stations noise makes the histogram of codes smooth (S,)."""
    recorded = evidence.recorded
    rows = np.concatenate(recorded.members)
    noise = np.min([np.median(s.quiet, axis=(0, 2)) for s in recorded.sweeps], axis=0)
    samples = (recorded.data.samples_of(i)[rows] for i in recorded.heard)
    parts = recorded.topology.parts
    return np.array([adc_codes.smooth(x, np.sqrt(n / parts)) for x, n in zip(samples, noise, strict=True)])


HARMONIC = Harmonic(
    name='harmonic',
    of_converter=True,
    level='if_spectrum',
    axis='range',
    label='harmonics of the line',
    has_gaps=True,
    trust=Trust(beside_distortion=MODEL.coherent_harmonics),
    scatter_freedom=2,  # real and imaginary part
)
PILED = Piled(
    name='piled',
    of_converter=True,
    level='if_samples',
    axis='range',
    label='samples at the outermost codes',
    trust=Trust(beside_distortion=MODEL.piled),
    unmistakable=True,
    fewest=1,
)
