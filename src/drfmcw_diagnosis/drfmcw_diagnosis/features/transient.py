"""What a filter with a memory adds where the signal begins: means of the samples, at the phase of the line."""

import numpy as np

from drfmcw_physics.sweep import SweepSettings

from .limits import SPECTRUM
from .spectra import at_line, turning


def times(sweep: SweepSettings) -> np.ndarray:
    """Return when the spans begin and end (V, 2) [s]: the first where the window begins, each one twice as long."""
    first, last = sweep.analysis_window()
    lengths = SPECTRUM.shortest_transient * 2.0 ** np.arange(SPECTRUM.transients)
    edges = first + np.concatenate([[0.0], np.cumsum(lengths)]) / sweep.sample_rate
    return np.minimum(np.stack([edges[:-1], edges[1:]], axis=1), last)


def measured(samples: np.ndarray, frequency: np.ndarray, weights: np.ndarray, sweep: SweepSettings) -> np.ndarray:
    """Return means of the samples in spans of the sweep over the line (n, 2 V): real, then imaginary parts.

    Each is the mean beside a line of any amplitude, phase and frequency near its own in its span, by least squares: the
    line itself, and what the ramp does to it, leave hardly anything. It counts at the phase with which the line begins,
    so that what is added to the samples, or begins at a phase of its own, has no mean over sweeps. 0 of a span outside
    of the window.

    Args:
        samples: of a station (n, N), real or complex [LSB].
        frequency: of its line (n,) [Hz].
        weights: that keep the line's mirror out, their sum 1 (N,).
        sweep: its settings.
    """
    cycles = frequency / sweep.sample_rate
    line = at_line(samples, cycles, weights)
    spans = np.round(times(sweep) * sweep.sample_rate).astype(int)
    used = spans[:, 1] - spans[:, 0] >= SPECTRUM.shortest_transient
    first, last = spans[used].min(), spans[used].max()
    starts = spans[used, 0] - first
    about = samples[:, first:last]
    turned = about * turning(-cycles, first, last)
    length = np.diff(spans[used])[:, 0]
    place = np.concatenate([(np.arange(count) - 0.5 * (count - 1)) / count for count in length])  # in its span
    mean, tone, moment = (np.add.reduceat(x, starts, axis=1, dtype=complex) for x in (about, turned, turned * place))
    squares = _products(cycles[:, None], spans[used, 0] + 0.5 * (length - 1), length.astype(float))
    sums = np.stack([mean, tone, tone.conj(), moment, moment.conj()], axis=-1)
    if np.iscomplexobj(samples):  # without a mirror
        kept = [0, 1, 3]
        squares, sums = squares[..., kept, :][..., kept], sums[..., kept]
    found = np.zeros((len(samples), SPECTRUM.transients), complex)
    found[:, used] = np.linalg.solve(squares, sums[..., None])[..., 0, 0]
    found /= np.where(np.abs(line) > 0.0, line, np.inf)[:, None]
    return np.concatenate([found.real, found.imag], axis=1)


def _products(cycles: np.ndarray, middle: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Return the products of 1, e, e*, u e and u e* over spans (n, V, 5, 5).

    With e = exp(2j pi cycles t), and u from -1/2 to 1/2 over a span.

    Args:
        cycles: of a line per sample (n, 1).
        middle: of each span (V,) [samples].
        length: of each span (V,) [samples].
    """
    (line, moved, _), (twice, twice_moved, spread) = (_sums(k * cycles, middle, length) for k in (1.0, 2.0))
    result = np.zeros((*line.shape, 5, 5), complex)
    for i, j, value in (
        (0, 1, line), (0, 2, line.conj()), (0, 3, moved), (0, 4, moved.conj()), (1, 2, twice.conj()),
        (1, 4, twice_moved.conj()), (2, 3, twice_moved), (3, 4, spread.conj()),
    ):  # fmt: skip
        result[..., i, j], result[..., j, i] = value, value.conj()
    for i in range(5):
        result[..., i, i] = length if i < 3 else (length**2 - 1.0) / (12.0 * length)
    return result


def _sums(cycles: np.ndarray, middle: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the sums of e, u e and u^2 e over spans (n, V): a geometric series, and its derivatives by the angle."""
    angle = 2.0 * np.pi * cycles
    a, b = 0.5 * length, 0.5
    over, below = np.sin(a * angle), np.sin(b * angle)
    below = np.where(np.abs(below) > 1e-9, below, 1e-9)
    over_1, below_1 = a * np.cos(a * angle), b * np.cos(b * angle)
    once = over_1 * below - over * below_1
    first = once / below**2
    second = (b**2 - a**2) * over / below - 2.0 * below_1 * once / below**3
    turned = np.exp(1j * angle * middle)
    return turned * over / below, -1j * turned * first / length, -turned * second / length**2
