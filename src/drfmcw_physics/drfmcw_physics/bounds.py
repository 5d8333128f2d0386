"""How well a beat frequency can be estimated by windowed estimators under additive and phase noise.

Every estimator here is, for small errors, a weighted slope of the phase: with window w(t) the peak of the windowed
spectrum moves by integral w (t - t_c) phi dt / (2 pi integral w (t - t_c)^2 dt). Additive noise adds a white phase
error, an oscillator its phase noise, both weighted alike.
"""

import functools

import numpy as np
from scipy.signal import get_window

from .phase_noise import PhaseNoise, combination_gain

_POINTS = 1024  # of the window grid; the window functions are smooth on it


@functools.cache
def _slope_weights(window: str) -> tuple[np.ndarray, np.ndarray]:
    """Return (x, g): grid x in (-1/2, 1/2) of window durations, and unit-duration slope weights, sum g x = 1."""
    w = get_window(window, _POINTS, fftbins=True)
    x = (np.arange(_POINTS) - _POINTS / 2) / _POINTS
    g = w * x
    return x, g / np.sum(g * x)


@functools.cache
def additive_factor(window: str) -> float:
    """Return sigma_f T sqrt(SNR) of the window's spectral peak, SNR = line power / noise power in a bin 1/T [1].

    The rectangular window gives the Cramer-Rao bound of a single tone, sqrt(6)/(2 pi) (Rife and Boorstyn 1974).
    """
    _, g = _slope_weights(window)
    # at this SNR per bin, the additive noise gives each of the N window points a phase variance of N / (2 SNR)
    return float(np.sqrt(np.sum(g**2) * _POINTS / 2.0) / (2.0 * np.pi))


def additive_std(snr, duration: float, window: str = 'boxcar'):
    """Return the standard deviation of the frequency of a tone in white noise [Hz].

    Args:
        snr: line power over noise power in one bin of 1/duration [1], array or scalar.
        duration: of the window [s].
        window: scipy.signal.get_window name.
    """
    return additive_factor(window) / (duration * np.sqrt(snr))


@functools.cache
def _transfer(window: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (frequency, width of each step, |G|^2) of the slope estimate of a window of unit duration."""
    x, g = _slope_weights(window)
    f = np.concatenate([np.linspace(0.02, 20.0, 1000), np.geomspace(20.05, _POINTS / 4, 400)])
    g_of_f = np.exp(-2j * np.pi * np.outer(f, x)) @ g
    return f, np.gradient(f), np.abs(g_of_f / (2.0 * np.pi)) ** 2


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
    return float(np.sqrt(np.sum(density * step) / duration**3))  # rad^2/Hz x (1/T) x (1/T)^2


def image_noise_ratio(noise: PhaseNoise, frequency, duration: float, sample_rate: float):
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
