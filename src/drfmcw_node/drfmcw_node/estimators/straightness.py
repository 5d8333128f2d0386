"""Whether a sweep that a station hears of itself is one line of a straight ramp: the line's frequency, part by part."""

import numpy as np

_PERIODS = 3.0  # of the line in a part, at least: fewer do not separate it from its mirror and from 0 Hz
_PARTS = 16  # at most
_FEWEST = 4  # parts
_SIGNIFICANT = 8.0  # standard deviations of the mean square beyond that of noise: no false alarm in 1e6 sweeps
_HANN = 1.5  # noise bandwidth of a part's window [1/duration]


def parts_of(frequency: float, duration: float) -> int:
    """Return the number of parts of a sweep in which a line [Hz] is followed, 0 where it has too few periods."""
    parts = int(min(_PARTS, frequency * duration / _PERIODS))
    return parts if parts >= _FEWEST else 0


def local_frequencies(record: np.ndarray, frequency: float, rate: float, parts: int) -> tuple[np.ndarray, float]:
    """Return by how much the line's frequency differs between neighbouring parts of a sweep.

    Args:
        record: one sweep less its mean (N,), real or complex.
        frequency: of the line [Hz].
        rate: of the samples [Hz].
        parts: number of parts.

    Returns:
        deviations from the line's frequency (parts - 1,) [Hz], and the time between the parts' centres [s].
    """
    length = len(record) // parts
    samples = record[: parts * length].reshape(parts, length)
    window = np.hanning(length + 2)[1:-1]
    turn = np.exp(-2j * np.pi * frequency / rate * np.arange(parts * length)).reshape(parts, length)
    phase = np.angle((samples * turn) @ window)
    step = np.remainder(np.diff(phase) + np.pi, 2.0 * np.pi) - np.pi
    return step * rate / (2.0 * np.pi * length), length / rate


def contradiction(
    record: np.ndarray, frequency: np.ndarray, ratio: np.ndarray, rate: float, other: np.ndarray, fastest: float
) -> np.ndarray:
    """Return the standard deviation of each line's frequency that a bent ramp or a further line causes, (B,) [Hz].

    Zero where noise, and the steady change by a target that moves, explain how the frequency varies over the sweep. A
    rate that varies over the sweep may be off as a whole by as much, so it is not averaged.

    Args:
        record: sweeps less their means (B, N).
        frequency: of each line (B,) [Hz].
        ratio: of line power to noise density (B,) [Hz].
        rate: of the samples [Hz].
        other: standard deviation of the frequency of a part by the oscillator's noise, at one part per sweep (B,) [Hz].
        fastest: change of the frequency that a moving target may cause [Hz/s].
    """
    result = np.zeros(len(record))
    for row, (sweep, line) in enumerate(zip(record, frequency, strict=True)):
        parts = parts_of(float(line), len(sweep) / rate) if np.isfinite(line) else 0
        if not parts:
            continue
        deviations, apart = local_frequencies(sweep, float(line), rate, parts)
        phase_variance = _HANN / (2.0 * max(float(ratio[row]), 1e-30) * apart)
        noise = 2.0 * phase_variance / (2.0 * np.pi * apart) ** 2 + 2.0 * (parts * float(other[row])) ** 2
        step = np.arange(parts - 1) - (parts - 2) / 2.0
        change = float(step @ deviations / (step @ step))
        square = float(np.mean((deviations - np.clip(change, -fastest * apart, fastest * apart) * step) ** 2))
        if square > noise * (1.0 + _SIGNIFICANT * np.sqrt(2.0 / (parts - 1))):
            result[row] = np.sqrt(square - noise)
    return result
