"""When a station's signal begins and ends within the sweep."""

import numpy as np

from drfmcw_physics.sweep import SweepSettings

from .limits import SPECTRUM
from .spectra import turning


def measured(samples: np.ndarray, frequency: np.ndarray, sweep: SweepSettings) -> np.ndarray:
    """Return how many samples come before the signal begins, and before it ends (n, 2).

    The line's amplitude is that of the samples about an end, and of as many inside. The former's part at the phase of
    the latter is the share of the samples in which there is a signal: noise alone has none on average, as it would by
    its magnitude. Nothing later than the last sample is seen.

    Args:
        samples: of a station (n, N), real or complex [LSB].
        frequency: of its line (n,) [Hz].
        sweep: its settings.
    """
    cycles = frequency / sweep.sample_rate
    first, end = (round(t * sweep.sample_rate) for t in sweep.analysis_window())
    count, last = SPECTRUM.edge_samples, end - SPECTRUM.edge_inside
    before, after = max(first - count, 0), min(last + count, samples.shape[1])
    outside, inside, latest, later = (
        _amplitude(samples[:, a:b], cycles, a)
        for a, b in ((before, first), (first, first + count), (last - count, last), (last, after))
    )
    begins = first - (first - before) * _share(outside, inside)
    ends = last + (after - last) * _share(later, latest)
    return np.stack([begins, ends], axis=1)


def _share(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Return what part of an amplitude another one has at its phase (n,)."""
    share: np.ndarray = (part * whole.conj()).real / np.maximum(np.abs(whole) ** 2, 1e-9)
    return share


def _amplitude(samples: np.ndarray, cycles: np.ndarray, first: int) -> np.ndarray:
    """Return a line's complex amplitude in samples (n, N) from the `first` on, by its cycles per sample (n,): (n,).

    Of real samples beside that of its mirror, which a short span does not keep out.
    """
    count = samples.shape[1]
    if not count:
        return np.zeros(len(samples), complex)
    turn = turning(-cycles, first, first + count)
    line = np.einsum('ij,ij->i', samples, turn).astype(complex) / count
    if np.iscomplexobj(samples):
        return line
    mirror = np.einsum('ij,ij->i', turn, turn).astype(complex) / count
    return (line - mirror * line.conj()) / np.maximum(1.0 - np.abs(mirror) ** 2, SPECTRUM.edge_alike)
