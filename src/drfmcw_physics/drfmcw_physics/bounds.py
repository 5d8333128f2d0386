"""How well a beat frequency can be estimated under additive and phase noise.

A windowed estimator is, for small errors, a weighted slope of the phase: with window w(t) the peak of the windowed
spectrum moves by integral w (t - t_c) phi dt / (2 pi integral w (t - t_c)^2 dt). Additive noise adds a white phase
error, an oscillator its phase noise, both weighted alike. Maximum likelihood weighs by the inverse of the noise's
covariance instead (generalised least squares), which gives the bound for every unbiased estimator.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy

from .phase_noise import PhaseNoise, combination_gain
from .quantities import Quantity
from .windows import symmetric_window

_POINTS = 2048  # of the window grid, about the samples of a sweep
_OVERSAMPLING = 8  # of the transfer function's frequency grid


@functools.cache
def _slope_weights(window: str) -> np.ndarray:
    """Return the slope weights g on a grid x in (-1/2, 1/2) of window durations, sum g x = 1."""
    w = symmetric_window(window, 2 * _POINTS + 1)[1::2]
    x = (np.arange(_POINTS) + 0.5) / _POINTS - 0.5
    g = w * x
    return g / np.sum(g * x)


@functools.cache
def additive_factor(window: str) -> float:
    """Return sigma_f T sqrt(SNR) of the window's spectral peak, SNR = line power / noise power in a bin 1/T [1].

    The rectangular window gives the Cramer-Rao bound of a single tone, sqrt(6)/(2 pi) (Rife and Boorstyn 1974).
    """
    g = _slope_weights(window)
    # at this SNR per bin, the additive noise gives each of the N window points a phase variance of N / (2 SNR)
    return float(np.sqrt(np.sum(g**2) * _POINTS / 2.0) / (2.0 * np.pi))


def additive_std(snr: Quantity, duration: float, window: str = 'boxcar') -> Any:
    """Return the standard deviation of the frequency of a tone in white noise [Hz].

    Args:
        snr: line power over noise power in one bin of 1/duration [1], array or scalar.
        duration: of the window [s].
        window: scipy.signal.get_window name.
    """
    return additive_factor(window) / (duration * np.sqrt(snr))


@functools.cache
def _transfer(window: str) -> tuple[np.ndarray, float, np.ndarray]:
    """Return (frequency, its step, |G|^2) of the slope estimate of a window of unit duration, up to Nyquist."""
    g = _slope_weights(window)
    gain = np.abs(np.fft.rfft(g, _OVERSAMPLING * _POINTS)[1:] / (2.0 * np.pi)) ** 2
    return np.arange(1, len(gain) + 1) / _OVERSAMPLING, 1.0 / _OVERSAMPLING, gain


def phase_noise_std(noise: PhaseNoise, duration: float, window: str = 'boxcar', delay: float | None = None) -> float:
    """Return the standard deviation that one oscillator's phase noise gives the frequency estimate [Hz].

    Args:
        noise: the oscillator.
        duration: of the window [s].
        window: scipy.signal.get_window name.
        delay: path delay where the two stations' frequencies are combined (eq. 5 or 6), so that the noise passes
            through 4 sin^2(pi f tau) [s]; None for a single station's frequency, where it passes whole.
    """
    frequency, step, gain = _transfer(window)
    f = frequency / duration
    density = noise.phase_density(f) * gain
    if delay is not None:
        density = density * combination_gain(f, delay)
    return float(np.sqrt(density.sum() * step / duration**3))  # rad^2/Hz x (1/T) x (1/T)^2


def image_noise_ratio(noise: PhaseNoise, frequency: Quantity, duration: float, sample_rate: float) -> Any:
    """Return the phase noise that a real IF's mirror line at -f puts onto the line, per line power, in a bin 1/T [1].

    At an offset of twice the line frequency the noise no longer cancels in the combination and acts as additive noise;
    it is the floor of about 0.2 mm that a quadrature IF does not have. Add it to 1/SNR.

    Args:
        noise: one oscillator; add the ratios of both.
        frequency: of the line [Hz], array or scalar.
        duration: of the window [s].
        sample_rate: of the real samples [Hz]; the mirror line repeats there.
    """
    offset = np.minimum(2.0 * frequency, sample_rate - 2.0 * frequency)
    return noise.single_sideband(offset) / duration


def outlier_probability(snr: float, bins: int) -> float:
    """Return how often the strongest of orthogonal bins is not the line's (Rife and Boorstyn 1974, section IV).

    The chance that one of the others, of exponentially distributed power, exceeds the line's bin, of Rician amplitude;
    below about 15 dB it grows so steeply that it is called the threshold of maximum likelihood.

    Args:
        snr: line power over noise power in a bin [1].
        bins: searched, the line's own among them.
    """
    power = np.linspace(0.0, (np.sqrt(snr) + 8.0) ** 2, 20001)  # of the line's bin over the noise's
    density = np.exp(-((np.sqrt(power) - np.sqrt(snr)) ** 2)) * scipy.special.i0e(2.0 * np.sqrt(snr * power))
    missed = -np.expm1((bins - 1) * np.log1p(-np.exp(-power[1:])))
    return float(scipy.integrate.trapezoid(density * np.concatenate([[1.0], missed]), power))


@dataclasses.dataclass(frozen=True)
class LineNoise:
    """What disturbs one station's line."""

    carrier_to_noise: float  # line power over additive noise density [Hz]
    frequency: float  # of the line [Hz]
    sample_rate: float  # [Hz]
    iq: bool = False  # quadrature samples, which have no mirror line


@dataclasses.dataclass(frozen=True)
class Bound:
    """Smallest standard deviations that an unbiased estimator can have."""

    frequency: float  # of the beat frequency, or of both stations' sum [Hz]
    phase: float  # of the phase at mid-sweep, or of both stations' sum [rad]


@functools.lru_cache(maxsize=4096)
def coloured_bound(
    lines: Sequence[LineNoise], noises: Sequence[PhaseNoise], duration: float, delay: float | None
) -> Bound:
    """Return the Cramer-Rao bound under additive noise and coloured phase noise.

    Phase of a line: a_0 + 2 pi f t + e(t), e a stationary Gaussian process; the bound is that of generalised least
    squares (Kay 1993, Fundamentals of Statistical Signal Processing, eq. 4.25), C the Toeplitz covariance of e. White
    phase errors of density 1/(C/N0) come from additive noise and, in a real IF, from the oscillators' noise at the
    mirror line.

    Args:
        lines: one station's (a tuple, its bound alone), or both stations' (the bound of their sum, eqs. 5 and 6).
        noises: oscillators (a tuple), both of which act on every line.
        duration: in which both chirps are on [s].
        delay: of the path, where both stations are combined, so that the phase noise passes through
            4 sin^2(pi f tau) [s]; None for a single station, where it passes whole.
    """
    rate = lines[0].sample_rate
    count = int(duration * rate)
    offset = (np.arange(32 * count) + 0.5) * (rate / 2 / (32 * count))
    gain = 1.0 if delay is None else combination_gain(offset, delay)
    density = sum((noise.phase_density(offset) * gain for noise in noises), np.zeros(len(offset)))
    for line in lines:
        inverse = 1.0 / line.carrier_to_noise
        if not line.iq:
            inverse += sum(image_noise_ratio(noise, line.frequency, 1.0, rate) for noise in noises)
        density = density + inverse
    # r(m) = integral of S(f) cos(2 pi f m / f_s) df over the midpoints of the grid
    covariance = scipy.fft.dct(density)[:count] / 2.0 * (offset[1] - offset[0])
    t = (np.arange(count) - (count - 1) / 2) / rate
    ones = np.ones(count)
    weighted = scipy.linalg.solve_toeplitz(covariance, np.column_stack([t, ones]))
    return Bound(
        frequency=float(1.0 / np.sqrt(t @ weighted[:, 0]) / (2.0 * np.pi)),
        phase=float(1.0 / np.sqrt(ones @ weighted[:, 1])),
    )
