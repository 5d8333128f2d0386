"""Phase noise of an oscillator, sampled where its transmitter is heard and where its own mixer uses it.

One realisation per sweep is drawn in the frequency domain, band-limited to the ADC's Nyquist frequency as behind the
anti-aliasing filter. Evaluating it on a shifted grid is a phase ramp, exact for any sub-sample delay: that is what
makes the noise that both stations see correlated as in reality.
"""

import math

import numpy as np
from scipy import fft

from drfmcw_physics.phase_noise import PhaseNoise

_CORRELATION_TIMES = 8  # of the noise kept between the end of a record and its periodic image
_MARGIN = 64  # samples, for the delay between the two grids


def period(count: int, sample_rate: float, noise: PhaseNoise) -> int:
    """Return the number of samples after which a realisation repeats; longer than the record by the noise's memory.

    Args:
        count: samples in the record.
        sample_rate: [Hz].
        noise: its memory is 1/(2 pi corner); at most 8 records are added.
    """
    memory = _CORRELATION_TIMES * sample_rate / (2.0 * math.pi * noise.corner)
    return fft.next_fast_len(count + _MARGIN + int(min(memory, 8.0 * count)), real=True)


def normal_count(period: int) -> int:
    """Return how many normal deviates one realisation takes."""
    return 2 * (period // 2 + 1)


def spectrum(normals: np.ndarray, period: int, sample_rate: float, noise: PhaseNoise) -> np.ndarray:
    """Return the spectrum of phase-noise realisations, complex64 [sweeps, period // 2 + 1].

    Args:
        normals: standard normal deviates, float32 [sweeps, normal_count(period)].
        period: of `period`.
        sample_rate: [Hz].
        noise: shape; its one-sided density S_phi = 2 L(f) is met at every frequency up to Nyquist.
    """
    frequency = np.arange(period // 2 + 1) * (sample_rate / period)
    # irfft divides by the period: E|X_k|^2 = period * rate * S_phi / 2, half of it in each quadrature
    scale = np.sqrt(noise.phase_density(frequency) * (period * sample_rate / 4.0))
    scale[0] *= math.sqrt(2.0)  # irfft takes the real part alone
    if period % 2 == 0:
        scale[-1] *= math.sqrt(2.0)
    return normals.view(np.complex64) * scale.astype(np.float32)


def phase(spectrum: np.ndarray, period: int, count: int, shift: np.ndarray, rate: np.ndarray | None) -> np.ndarray:
    """Return phase noise on a grid, float32 [sweeps, count] [rad].

    Args:
        spectrum: of `spectrum`.
        period: of `period`.
        count: number of samples.
        shift: where sample 0 of the grid lies on the oscillator's own grid, per sweep [samples], |shift| < 2**20.
        rate: relative excess of the grid's spacing over the oscillator's own, per sweep [1]; None for none. Exact to
            first order in the drift within the record, which 200 ppm of 2048 samples keeps below a quarter sample.
    """
    drift_origin = 0.0 if rate is None else rate * (count / 2)
    turns = ((shift + drift_origin) / period).astype(np.float64)
    if np.any(turns):
        k = np.arange(spectrum.shape[-1])
        angle = turns[:, None] * k
        angle = ((angle - np.rint(angle)) * (2.0 * math.pi)).astype(np.float32)
        ramp = np.empty(spectrum.shape, np.complex64)
        np.cos(angle, out=ramp.real)
        np.sin(angle, out=ramp.imag)
        ramp *= spectrum
        spectrum = ramp
    values = fft.irfft(spectrum, period, axis=-1)
    result = values[:, :count]
    if rate is not None and np.any(rate):
        slope = np.empty_like(result)
        slope[:, 1:] = values[:, 2 : count + 1]
        slope[:, 1:] -= values[:, : count - 1]
        slope[:, 0] = values[:, 1] - values[:, -1]
        offset = np.arange(count, dtype=np.float32) - np.float32(count / 2)
        slope *= offset
        slope *= (rate * 0.5).astype(np.float32)[:, None]
        result = result + slope
    return result
