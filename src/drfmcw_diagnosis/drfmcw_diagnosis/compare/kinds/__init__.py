"""Kinds of numbers that a recording and its model are compared by, each described in one place.

In: `Evidence` of recorded sweeps, `Expected` of simulated ones. Out: `KINDS`, over which comparison, fit, leftovers and
finding go; whatever is appended to it takes part.
"""

from .distortion import HARMONIC, PILED
from .kind import Kind
from .noise import BURST, COHERENCE, NOISE
from .path import AMPLITUDE, BEAT, MOVEMENT, RANGE, VELOCITY
from .ramp import FLUTTER, RAMP
from .spectrum import BASELINE, ENDS, LINES, MEAN, ONSET, TRANSIENT

KINDS: list[Kind] = [
    RAMP,
    FLUTTER,
    LINES,
    MEAN,
    BASELINE,
    TRANSIENT,
    ONSET,
    ENDS,
    HARMONIC,
    PILED,
    BURST,
    NOISE,
    COHERENCE,
    BEAT,
    AMPLITUDE,
    RANGE,
    VELOCITY,
    MOVEMENT,
]
"""All kinds, in the order in which a comparison's vector holds them, those with one number per sweep last."""

__all__ = ['KINDS', 'Kind']
