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
    spans = np.round(times(sweep) * sweep.sample_rate).astype(int)
    used = spans[:, 1] - spans[:, 0] >= SPECTRUM.shortest_transient
    first, last = spans[used].min(), spans[used].max()
    starts = spans[used, 0] - first
    about = samples[:, first:last]
    mean = np.add.reduceat(about, starts, axis=1, dtype=complex)
    at_line = np.add.reduceat(about * turn[:, first:last], starts, axis=1, dtype=complex)
    length = np.diff(spans[used])[:, 0].astype(float)
    once, twice = (_sum_of_phasor(k * cycles[:, None], *spans[used].T) for k in (1.0, 2.0))
    squares = np.empty((*mean.shape, 3, 3), complex)  # of a constant, the line and its mirror
    squares[..., np.arange(3), np.arange(3)] = length[:, None]
    squares[..., 0, 1] = squares[..., 2, 0] = once
    squares[..., 0, 2] = squares[..., 1, 0] = once.conj()
    squares[..., 1, 2], squares[..., 2, 1] = twice.conj(), twice
    sums = np.stack([mean, at_line, at_line.conj()], axis=-1)
    if np.iscomplexobj(samples):  # without a mirror
        squares, sums = squares[..., :2, :2], sums[..., :2]
    found = np.zeros((len(samples), SPECTRUM.transients), complex)
    found[:, used] = np.linalg.solve(squares, sums[..., None])[..., 0, 0]
    found /= np.where(np.abs(line) > 0.0, line, np.inf)[:, None]
    return np.concatenate([found.real, found.imag], axis=1)


def _sum_of_phasor(cycles: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the sums of exp(2j pi cycles t) over the samples t from `begin` to before `end`: a geometric series."""
    half = np.sin(np.pi * cycles)
    ratio = np.where(
        np.abs(half) > 1e-12, np.sin(np.pi * cycles * (end - begin)) / np.where(half == 0.0, 1.0, half), end - begin
    )
    return ratio * np.exp(1j * np.pi * cycles * (begin + end - 1))
