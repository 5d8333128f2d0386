"""What a filter with a memory adds where the signal begins: means of the samples, at the phase of the line."""

import numpy as np

from drfmcw_physics.sweep import SweepSettings

from .coherence import phasor
from .limits import SPECTRUM


def times(sweep: SweepSettings) -> np.ndarray:
    """Return when the spans begin and end (V, 2) [s]: the first where the window begins, each one twice as long."""
    first, last = sweep.analysis_window()
    lengths = SPECTRUM.shortest_transient * 2.0 ** np.arange(SPECTRUM.transients)
    edges = first + np.concatenate([[0.0], np.cumsum(lengths)]) / sweep.sample_rate
    return np.minimum(np.stack([edges[:-1], edges[1:]], axis=1), last)


def measured(samples: np.ndarray, frequency: np.ndarray, weights: np.ndarray, sweep: SweepSettings) -> np.ndarray:
    """Return means of the samples in spans of the sweep over the line (n, 2 V): real, then imaginary parts.

    Each is the mean beside a line of any amplitude and phase in its span, by least squares: the line itself, and what
    the ramp does to it, leave nothing. It counts at the phase with which the line begins, so that what is added to the
    samples, or begins at a phase of its own, has no mean over sweeps. 0 of a span outside of the window.

    Args:
        samples: of a station (n, N), real or complex [LSB].
        frequency: of its line (n,) [Hz].
        weights: that keep the line's mirror out, their sum 1 (N,).
        sweep: its settings.
    """
    cycles = frequency / sweep.sample_rate
    turn = phasor(-cycles[:, None] * np.arange(samples.shape[1]))
    line = np.einsum('ij,j,ij->i', samples, weights.astype(np.float32), turn)
    is_real = not np.iscomplexobj(samples)
    found = np.zeros((len(samples), SPECTRUM.transients), complex)
    for span, (begin, end) in enumerate(np.round(times(sweep) * sweep.sample_rate).astype(int)):
        if end - begin < SPECTRUM.shortest_transient:
            continue
        x, t = samples[:, begin:end].astype(np.complex128), turn[:, begin:end].astype(np.complex128)
        basis = np.stack([np.ones_like(t), t.conj(), *([t] if is_real else [])], axis=1)  # (n, 2 or 3, span)
        squares = np.einsum('ikj,ilj->ikl', basis.conj(), basis)
        overlap = np.einsum('ikj,ij->ik', basis.conj(), x)
        mean = np.linalg.solve(squares, overlap[..., None])[:, 0, 0]
        found[:, span] = (mean.real if is_real else mean) / np.where(np.abs(line) > 0.0, line, np.inf)
    return np.concatenate([found.real, found.imag], axis=1)
