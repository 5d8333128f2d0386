"""Tones and chirps in blocks of a demodulated sweep: where they are, how strong, and how they turn."""

import numpy as np
import scipy

from .estimation import TINY

_PADDING = 4  # of the transform in which a tone is searched
_NEAR = 2 * _PADDING  # around the frequency at which a tone is expected: two bins of the sweep
_FAR_STRONGER = 4.0  # power of a tone elsewhere over that of one where it is expected: noise is not, a line is
_STEPS = 2  # of Newton's method
_STEADY = 0.1  # relative variance of the blocks' power, below which no noise feigns a chirp: a line holds 0.95 of it


def chirp_of(blocks: np.ndarray, size: int, multiple: int) -> np.ndarray:
    """Return the chirp of which `blocks` (B, K) of `size` samples have a multiple (B,) [cycles per sample^2]."""
    lag = blocks.shape[1] // 2
    beat = blocks[:, lag:] * blocks[:, :-lag].conj()
    return mean_turn(beat) / (2.0 * np.pi * multiple * lag * size**2)


def mean_turn(values: np.ndarray) -> np.ndarray:
    """Return by how much complex values (B, K) turn from one to the next (B,) [rad], strong ones counting more."""
    turn: np.ndarray = np.angle((values[:, 1:] * values[:, :-1].conj()).astype(complex).sum(axis=1))
    return turn


def total_power(values: np.ndarray) -> np.ndarray:
    """Return the squared magnitude of complex values, summed over the first axis."""
    power: np.ndarray = np.sum(values.real**2 + values.imag**2, axis=0)
    return power


def is_steady(blocks: np.ndarray) -> np.ndarray:
    """Return where the power of each station's blocks (S, B, K) hardly varies (B,), whatever their phases do."""
    power = blocks.real**2 + blocks.imag**2
    steady: np.ndarray = np.all(power.var(axis=-1) < _STEADY * power.mean(axis=-1) ** 2, axis=0)
    return steady


def rotation(rate: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return exp(2j pi rate time), complex64 (..., K), of rates (...) [cycles per unit] and times (..., K)."""
    angle = (2.0 * np.pi * (rate[..., None] * time)).astype(np.float32)
    result = np.empty(angle.shape, np.complex64)
    np.cos(angle, out=result.real)
    np.sin(angle, out=result.imag)
    return result


def tone(
    blocks: np.ndarray, time: np.ndarray, size: int, expected: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return (frequency [cycles per sample], complex amplitude at time 0) of the strongest tone of each row (...).

    Args:
        blocks: (..., K), one value each `size` samples.
        time: of the blocks (..., K) [samples].
        size: of a block [samples].
        expected: frequency near which the tone is, unless another one is far stronger (...) [cycles per sample].
    """
    length = scipy.fft.next_fast_len(_PADDING * blocks.shape[-1])
    spectrum = scipy.fft.fft(blocks, length)
    power = spectrum.real**2 + spectrum.imag**2
    peak = power.argmax(axis=-1)
    if expected is not None:
        around = np.rint(expected * size * length).astype(int)[..., None] + np.arange(-_NEAR, _NEAR + 1)
        around %= length
        beside = np.take_along_axis(power, around, axis=-1)
        near = np.take_along_axis(around, beside.argmax(axis=-1)[..., None], axis=-1)[..., 0]
        strongest = np.take_along_axis(power, peak[..., None], axis=-1)[..., 0]
        peak = np.where(strongest > _FAR_STRONGER * beside.max(axis=-1), peak, near)
    frequency = scipy.fft.fftfreq(length, size)[peak]
    spread = 2.0 * np.pi * time.var(axis=-1)
    for step in range(_STEPS + 1):
        still = blocks * rotation(-frequency, time)
        value = still.astype(complex).mean(axis=-1)  # a mean that converts depends on the rows around
        if step < _STEPS:
            slope = (still * time).mean(axis=-1) / np.where(value == 0.0, TINY, value)
            frequency = frequency + slope.imag / spread
    return frequency, value
