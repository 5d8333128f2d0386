"""Phase noise of an oscillator, sampled where its transmitter is heard and where its own mixer uses it.

One realisation per sweep is drawn in the frequency domain, band-limited to the ADC's Nyquist frequency as behind the
anti-aliasing filter. Evaluating it on a shifted grid is a phase ramp, exact for any sub-sample delay: that is what
makes the noise that both stations see correlated as in reality.
"""

import functools
import math

import numpy as np
import scipy

from drfmcw_physics.phase_noise import PhaseNoise

_CORRELATION_TIMES = 8  # of the noise kept between the end of a record and its periodic image
_MARGIN = 64  # samples, for the delay between the two grids
_BLOCK = 64  # bins of a phase ramp made from one factor


def period(count: int, sample_rate: float, noise: PhaseNoise, start_delay: float = 0.0) -> int:
    """Return the number of samples after which a realisation repeats; longer than the record by the noise's memory.

    Args:
        count: samples in the record.
        sample_rate: [Hz].
        noise: its memory is 1/(2 pi corner); at most 8 records are added.
        start_delay: between the stations' records [s].
    """
    memory = _CORRELATION_TIMES * sample_rate / (2.0 * math.pi * noise.corner)
    added = _MARGIN + math.ceil(start_delay * sample_rate) + int(min(memory, 8.0 * count))
    return scipy.fft.next_fast_len(count + added, real=True)


def bin_count(period: int) -> int:
    """Return the number of bins of one realisation's spectrum, one pair of normal deviates each."""
    return period // 2 + 1


@functools.lru_cache(maxsize=16)
def _scale(period: int, sample_rate: float, noise: PhaseNoise) -> np.ndarray:
    """Return the standard deviation of each bin's real and of its imaginary part, float32 [bins]."""
    frequency = np.arange(bin_count(period)) * (sample_rate / period)
    # irfft divides by the period: E|X_k|^2 = period * rate * S_phi / 2, half of it in each quadrature
    scale = np.sqrt(noise.phase_density(frequency) * (period * sample_rate / 4.0))
    scale[0] *= math.sqrt(2.0)  # irfft takes the real part alone
    if period % 2 == 0:
        scale[-1] *= math.sqrt(2.0)
    scale = scale.astype(np.float32)
    scale.setflags(write=False)
    return scale


def spectrum(
    radius: np.ndarray, cosine: np.ndarray, sine: np.ndarray, period: int, sample_rate: float, noise: PhaseNoise
) -> np.ndarray:
    """Return the spectrum of phase-noise realisations, complex64 [sweeps, bins].

    Args:
        radius: of pairs of standard normal deviates in polar form, float32 [sweeps, bin_count(period)].
        cosine: of their angle.
        sine: of their angle.
        period: of `period`.
        sample_rate: [Hz].
        noise: shape; its one-sided density S_phi = 2 L(f) is met at every frequency up to Nyquist.
    """
    result = np.empty(radius.shape, np.complex64)
    radius = radius * _scale(period, sample_rate, noise)
    np.multiply(radius, cosine, out=result.real)
    np.multiply(radius, sine, out=result.imag)
    return result


def shifted(spectrum: np.ndarray, period: int, shift: np.ndarray) -> np.ndarray:
    """Return the spectrum of the same noise on a grid that begins `shift` samples later, complex64 [sweeps, bins].

    Args:
        spectrum: of `spectrum`.
        period: of `period`.
        shift: per sweep [samples], |shift| < 2**20.
    """
    bins = spectrum.shape[-1]
    turns = shift[:, None] / period
    # exp(j 2 pi turns k) with k = _BLOCK a + b, a product of two short tables: exact angles, one multiplication
    coarse = _unit(turns * (_BLOCK * np.arange(-(-bins // _BLOCK))))
    ramp = coarse[:, :, None] * _unit(turns * np.arange(_BLOCK))[:, None, :]
    return ramp.reshape(len(spectrum), -1)[:, :bins] * spectrum


def _unit(turns: np.ndarray) -> np.ndarray:
    """Return exp(j 2 pi turns), complex64."""
    angle = ((turns - np.rint(turns)) * (2.0 * math.pi)).astype(np.float32)
    result = np.empty(turns.shape, np.complex64)
    np.cos(angle, out=result.real)
    np.sin(angle, out=result.imag)
    return result


def phase(spectrum: np.ndarray, period: int, count: int) -> np.ndarray:
    """Return phase noise on the grid of its spectrum, float32 [sweeps, count] [rad]."""
    return scipy.fft.irfft(spectrum, period, axis=-1)[:, :count]


def drift_phase(spectrum: np.ndarray, period: int, count: int, drift: np.ndarray) -> np.ndarray:
    """Return what phase noise gains on a grid whose spacing differs, float32 [sweeps, count] [rad].

    To first order in the drift within the record, which 200 ppm of 2048 samples keeps below a quarter sample.

    Args:
        spectrum: of the noise on the grid that agrees with the differing one in the middle of the record.
        period: of `period`.
        count: number of samples.
        drift: relative excess of the grid's spacing over the oscillator's own, per sweep [1].
    """
    angular = (2j * math.pi / period * np.arange(spectrum.shape[-1])).astype(np.complex64)
    slope = scipy.fft.irfft(spectrum * angular, period, axis=-1)[:, :count]
    slope *= np.arange(count, dtype=np.float32) - np.float32(count / 2)
    slope *= drift.astype(np.float32)[:, None]
    return slope
