"""When a station's signal begins and ends within the sweep."""

import numpy as np

from drfmcw_physics.sweep import SweepSettings

from .limits import SPECTRUM
from .spectra import phasor


def measured(samples: np.ndarray, frequency: np.ndarray, sweep: SweepSettings) -> np.ndarray:
    """Return how many samples come before the signal begins, and before it ends (n, 2).

    The line is summed over the samples about an end, and over as many inside: their ratio is the share of the former in
    which there is a signal. Nothing later than the last sample is seen.

    Args:
        samples: of a station (n, N), real or complex [LSB].
        frequency: of its line (n,) [Hz].
        sweep: its settings.
    """
    cycles = frequency / sweep.sample_rate
    first, end = (round(t * sweep.sample_rate) for t in sweep.analysis_window())
    count, last = SPECTRUM.edge_samples, end - SPECTRUM.edge_inside
    outside, inside, latest, after = (
        _line_sum(samples[:, a:b], cycles)
        for a, b in ((max(first - count, 0), first), (first, first + count), (last - count, last), (last, last + count))
    )
    begins = first - count * outside / np.maximum(inside, 1e-9)
    ends = last + count * after / np.maximum(latest, 1e-9)
    return np.stack([begins, ends], axis=1)


def _line_sum(samples: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Return the magnitude of the sum of a line over samples (n, N), by its cycles per sample (n,): (n,)."""
    turn = phasor(-cycles[:, None] * np.arange(samples.shape[1]))
    return np.abs(np.einsum('ij,ij->i', samples, turn))
