"""When a station's signal begins and ends within the sweep, and how its line begins."""

import numpy as np

from drfmcw_physics.sweep import SweepSettings

from .limits import SPECTRUM
from .spectra import line_amplitude


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
        line_amplitude(samples[:, a:b], cycles, a)
        for a, b in ((before, first), (first, first + count), (last - count, last), (last, after))
    )
    begins = first - (first - before) * _share(outside, inside)
    ends = last + (after - last) * _share(later, latest)
    return np.stack([begins, ends], axis=1)


def onset_spans(sweep: SweepSettings) -> np.ndarray:
    """Return the first sample of each span and its end (V, 2): those right ahead of the window.

    A near station's signal has begun by then. Negative where the sweep has no such samples.
    """
    first = round(sweep.analysis_window()[0] * sweep.sample_rate)
    begins = first - SPECTRUM.onset_samples * np.arange(SPECTRUM.onsets, 0, -1)
    return np.stack([begins, begins + SPECTRUM.onset_samples], axis=1)


def onset_times(sweep: SweepSettings) -> np.ndarray:
    """Return when the spans begin and end (V, 2) [s]."""
    found: np.ndarray = onset_spans(sweep) / sweep.sample_rate
    return found


def onset(samples: np.ndarray, frequency: np.ndarray, sweep: SweepSettings) -> np.ndarray:
    """Return by how much the line differs in each span (n, 2 V): real, then imaginary parts.

    Of its complex amplitude there over that in the samples after the window's begin, less 1. 0 of a span that the sweep
    does not have.

    Args:
        samples: of a station (n, N), real or complex [LSB].
        frequency: of its line (n,) [Hz].
        sweep: its settings.
    """
    cycles = frequency / sweep.sample_rate
    edges = onset_spans(sweep)
    first = int(edges[-1, 1])
    inside = line_amplitude(samples[:, first : first + SPECTRUM.edge_samples], cycles, first)
    inside = np.where(np.abs(inside) > 0.0, inside, np.inf)
    found = np.zeros((len(samples), len(edges)), complex)
    for span, (begin, end) in enumerate(edges):
        if begin >= 0:
            found[:, span] = line_amplitude(samples[:, begin:end], cycles, int(begin)) / inside - 1.0
    return np.concatenate([found.real, found.imag], axis=1)


def _share(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Return what part of an amplitude another one has at its phase (n,)."""
    share: np.ndarray = (part * whole.conj()).real / np.maximum(np.abs(whole) ** 2, 1e-9)
    return share
