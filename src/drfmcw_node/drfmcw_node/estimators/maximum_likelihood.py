"""Maximum likelihood: line, mirror line, constant and the known residual chirp fitted to the samples themselves.

Model of a sweep in the analysis window, t counted from its centre:

    x(t) = a exp(j psi(t)) + a* exp(-j psi(t)) + c,    psi(t) = 2 pi (f t + chirp t^2 / 2)

A quadrature sweep has no second term. The errors are white: additive noise, and the oscillators' noise around the
mirror line, which is flat over the few kHz that matter. The oscillators' noise around the line itself passes the
combination of both stations through 4 sin^2(pi f tau) and is then so small that weighing by its covariance would gain
less than 0.3 % at Table 1 up to 1 km (`test_white_weights_lose_almost_nothing`).

With white errors, maximum likelihood is least squares. At its solution the derivative's residual vanishes,

    Im[a* (S_1 - a* M_1 - c D_1)] = 0,
    S_k = sum x t^k exp(-j psi),   M_k = sum t^k exp(-2j psi),   D_k = sum t^k exp(-j psi)

(a from the same sums of order 0). Newton's method finds it. The samples are read once, for the moments of the
demodulated sweep; S_k at any nearby frequency follow from these by a Taylor series.
"""

import math
from typing import Any

import numpy as np
import scipy

from .estimation import TINY, Estimator, Sweeps
from .spectral import whole_turns

FINE = 16
"""Demodulation frequencies per bin."""

_TERMS = 7  # of the Taylor series, good to 1e-7 for a quarter bin
_STEPS = 3  # of Newton's method
_SEARCH_LIMIT = 10.0 ** (19.0 / 10.0)  # of bin power over noise, below which the search is repeated without window
_PADDING = 4  # of that search
_SIDE_LOBE = 1.0 / 16.0  # of a line's power in the windowed spectrum, below which it is none; 3.7 sigma at 13 dB
_STRIDE = 8  # of the bins whose median gives the noise


class MaximumLikelihoodEstimator(Estimator, name='ml'):
    """Maximum likelihood with mirror line and constant: at the Cramer-Rao bound, 1.53 times below a Hann window."""

    own_weighting = 'boxcar'

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Prepare tables; arguments as for `Estimator`."""
        super().__init__(*args, **kwargs)
        rate = self.sweep.sample_rate
        start, end = self.sweep.analysis_window()
        # a reference 100 ppm fast ends its ramp up to a tenth of a sample early
        self.samples = slice(math.ceil(start * rate - 1e-6), math.floor(end * rate - 0.5) + 1)
        self.origin = self.center * rate
        u = np.arange(self.samples.start, self.samples.stop) - self.origin
        self._ends = u[0], u[-1] + 1.0
        self._count = len(u)
        scaled = u / (self._count / 2.0)
        self._powers = np.ascontiguousarray((scaled ** np.arange(_TERMS + 1)[:, None]).astype(np.float32))
        self._spread = float((scaled**2).mean() - scaled.mean() ** 2)  # of time
        self._curvature = self.chirp / rate**2  # [cycles per sample^2]
        turn = FINE * self.length
        self._rotation = np.exp(-2j * np.pi * np.arange(turn) / turn).astype(np.complex64)
        self._number = np.arange(self.samples.start, self.samples.stop)
        self._chirped = None if self._dechirp is None else self._dechirp[self.samples]

    def _refine(self, sweeps: Sweeps) -> tuple[np.ndarray, np.ndarray]:
        record = sweeps.record[:, self.samples]
        coarse = self.coarse(sweeps)
        moments, total = self._moments(record, coarse)
        offset, amplitude = self._climb(moments, total, coarse)
        return coarse / FINE + offset, amplitude * self.window_sum

    def coarse(self, sweeps: Sweeps) -> np.ndarray:
        """Return the line's frequency to a sixteenth of a bin (B,) [1/16 bin]; weak lines are searched for again.

        The Hann window costs 1.8 dB, and up to 1.4 dB between bins, which near the threshold would lose lines that the
        whole record still shows.
        """
        record, peak = sweeps.record[:, self.samples], sweeps.peak
        coarse = np.rint(FINE * (peak + sweeps.parabola())).astype(np.int64)
        noise = np.median(sweeps.power[:, self._first : self._last + 1 : _STRIDE], axis=1) / math.log(2.0)
        weak = np.flatnonzero(sweeps.power[np.arange(len(peak)), peak] < _SEARCH_LIMIT * noise)
        if len(weak):
            searched = record[weak] if self._chirped is None else record[weak] * self._chirped
            transform = scipy.fft.fft if np.iscomplexobj(searched) else scipy.fft.rfft
            spectrum = transform(searched, _PADDING * self.length)[:, : _PADDING * self.length // 2 + 1]
            power = spectrum.real**2 + spectrum.imag**2
            allowed = slice(_PADDING * self._first, _PADDING * self._last + 1)
            top = power[:, allowed].argmax(axis=1) + allowed.start
            found = np.rint(top / _PADDING).astype(peak.dtype)
            # a side lobe of a line outside the search range appears only in the spectrum without window
            expected = power[np.arange(len(weak)), top] * (self.window_sum / self._count) ** 2
            real = sweeps.power[weak, found] > _SIDE_LOBE * expected
            coarse[weak[real]] = top[real] * (FINE // _PADDING)
            peak[weak[real]] = found[real]
        return coarse

    def _moments(self, record: np.ndarray, coarse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the moments sum x v^k exp(-j psi) / N, k = 0 ... _TERMS, (B, _TERMS + 1), v in +-1, and the mean."""
        baseband = self.carrier(coarse) * record
        parts = baseband.view(np.float32).reshape(len(record), self._count, 2)
        moments = np.matmul(self._powers, parts).view(np.complex64)[..., 0].astype(complex)
        return moments / self._count, record.astype(np.result_type(record, float)).mean(axis=1)

    def carrier(self, coarse: np.ndarray) -> np.ndarray:
        """Return exp(-j psi) of the samples within the window, complex64 (B, N); phase 0 at the window's centre.

        Args:
            coarse: frequency at the centre (B,) [1/FINE bin]; the known chirp is in it.
        """
        result = self._rotation[whole_turns(coarse[:, None], self._number, len(self._rotation))]
        # the table starts at sample 0
        turned = np.remainder(coarse * (self.origin / len(self._rotation)), 1.0)
        result *= np.exp(2j * np.pi * turned).astype(np.complex64)[:, None]
        if self._chirped is not None:
            result *= self._chirped
        return result

    def _climb(self, moments: np.ndarray, total: np.ndarray, coarse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (offset from the coarse frequency [bins], amplitude a) by Newton's method, each (B,)."""
        offset, constant = np.zeros(len(coarse)), np.zeros(len(coarse), complex)
        amplitude = moments[:, 0]
        scale = self.length / self._count / np.pi  # bins per unit of the phase's slope over v
        for step in range(_STEPS + 1):
            zeroth, first = _shifted(moments, -1j * offset / scale)
            frequency = (coarse / FINE + offset) / self.length
            d0, d1 = self._leakage(frequency, 1)
            m0, m1 = (0.0, 0.0) if self.iq else self._leakage(frequency, 2)
            for _ in range(2):
                mirror = np.conj(amplitude)
                leaked = amplitude * np.conj(d0)
                constant = total - leaked if self.iq else total - 2.0 * leaked.real
                amplitude = zeroth - mirror * m0 - constant * d0
            if step == _STEPS:
                break
            residual = first - np.conj(amplitude) * m1 - constant * d1
            power = np.maximum(amplitude.real**2 + amplitude.imag**2, TINY)
            slope = (amplitude.real * residual.imag - amplitude.imag * residual.real) / (power * self._spread)
            offset = np.clip(offset + slope * scale, -0.75, 0.75)
        return offset, amplitude

    def _leakage(self, frequency: np.ndarray, multiple: int) -> tuple[np.ndarray, np.ndarray]:
        """Return sum v^k exp(-j multiple psi) / N for k = 0 and 1, (B,) each, from the window's two ends.

        Summation by parts: exact without chirp, good to chirp / frequency^2 with it.

        Args:
            frequency: of the line at the window centre (B,) [cycles per sample].
            multiple: of its phase, 1 for the constant and 2 for the mirror line.
        """
        zeroth, first = np.zeros(len(frequency), complex), np.zeros(len(frequency), complex)
        for sign, u in zip((1.0, -1.0), self._ends, strict=True):
            turns = multiple * (frequency * u + 0.5 * self._curvature * u * u)
            value = np.exp(-2j * np.pi * np.remainder(turns, 1.0))
            rotation = np.exp(-2j * np.pi * multiple * (frequency + self._curvature * (u - 0.5)))
            inverse = sign / (1.0 - rotation)
            zeroth += value * inverse
            first += value * inverse * (u + rotation / (1.0 - rotation))
        return zeroth / self._count, first / (self._count * self._count / 2.0)


def _shifted(moments: np.ndarray, exponent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the moments of order 0 and 1 of the same samples times exp(`exponent` v), (B,) each, as Taylor series."""
    zeroth, first = np.zeros(len(moments), complex), np.zeros(len(moments), complex)
    for k in reversed(range(_TERMS)):  # Horner
        zeroth = (zeroth * exponent) / (k + 1) + moments[:, k]
        first = (first * exponent) / (k + 1) + moments[:, k + 1]
    return zeroth, first
