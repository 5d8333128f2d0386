"""Additive noise of a sweep, separated from the oscillators' phase-noise skirt around the line.

All densities here are variances per sample [LSB^2]: white noise of variance v has the periodogram v sum(w^2).
"""

import dataclasses
import math

import numpy as np

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.phase_noise import PhaseNoise, combination_gain
from drfmcw_physics.sweep import SweepSettings

_BINS = 256  # of the spectrum in which the noise is measured
_SKIRT_POINTS = 16  # at which the smooth skirt is evaluated across them
_CLIP = 5.5  # times the mean: what lies above is a spur, not noise
_KEPT_MEAN = 1.0 - _CLIP * math.exp(-_CLIP) / (1.0 - math.exp(-_CLIP))  # mean of what the clip keeps, white noise
_SKIRT_UNCERTAINTY = 0.15  # relative, of a calibrated phase-noise level (0.6 dB)
_FLOOR_UNCERTAINTY = 0.25  # relative, of a calibrated noise floor (1 dB)
QUANTISATION = 1.0 / 12.0  # [LSB^2], Bennett 1948


def oscillators(*calibrations: Calibration | None) -> tuple[PhaseNoise, ...]:
    """Return the phase noise of each station's oscillator, empty where any of them is not characterised."""
    noises = tuple(PhaseNoise(c.phase_noise_level, c.phase_noise_corner) for c in calibrations if c is not None)
    return noises if len(noises) == len(calibrations) and all(n.known for n in noises) else ()


@dataclasses.dataclass(frozen=True)
class NoiseMeter:
    """Measures the additive noise of sweeps with one setting.

    Where the phase noise is known, the noise is read at the end of the spectrum that is farther from the line. The
    predicted skirt is subtracted, and the calibrated floor and the rest are averaged by their uncertainties. Near the
    transmitter the skirt hides the floor, and the calibrated value prevails. Far away, or where the floor has risen
    beyond what the skirt's uncertainty explains, the measurement prevails. Where the phase noise is unknown, the noise
    is read around the line, which counts its skirt as additive noise.
    """

    sweep: SweepSettings
    noises: tuple[PhaseNoise, ...]  # empty: unknown
    floor: float  # calibrated noise floor, NaN if unknown [dBm/Hz]
    iq: bool
    length: int  # of the FFT
    first_bin: int  # lowest and highest bin of the search (of the part shown, positive frequencies)
    last_bin: int
    guard: int  # bins kept off the line
    correlated_bins: float  # bins of the window's noise per independent value
    window_sum: float  # sum w
    window_power: float  # sum w^2
    skirts: dict[int, float] = dataclasses.field(default_factory=dict, repr=False, compare=False)
    """Skirt by the bin of the line, as far as it was needed: it depends on nothing else."""

    @property
    def quantisation(self) -> float:
        """Quantisation noise [LSB^2]."""
        return QUANTISATION * (2.0 if self.iq else 1.0)

    def calibrated(self, full_scale: np.ndarray) -> np.ndarray:
        """Return the calibrated floor and quantisation noise [LSB^2], NaN where unknown; `full_scale` (B,) in LSB."""
        decibel = self.floor - self.sweep.full_scale_power
        tone = full_scale**2 * (1.0 if self.iq else 0.25)  # of 1 Hz of the density, at the sample rate
        return 10.0 ** (decibel / 10.0) * tone * self.sweep.sample_rate + self.quantisation

    def measure(self, power: np.ndarray, peak: np.ndarray, line: np.ndarray, full_scale: np.ndarray) -> np.ndarray:
        """Return the additive noise of each sweep [LSB^2].

        Args:
            power: squared magnitude of the windowed sweeps' bins from 0 Hz up (B, K).
            peak: bin of the line (B,).
            line: squared magnitude of the line's peak (B,).
            full_scale: ADC code of full scale (B,) [LSB].
        """
        read, skirt = self._read(power, peak)
        total, relative_std = self._clipped_mean(read)
        skirt = skirt * (line / self.window_sum**2)
        measured = total - skirt
        if not (math.isfinite(self.floor) and math.isfinite(self.sweep.full_scale_power)):
            return np.maximum(measured, self.quantisation)
        floor = self.calibrated(full_scale)
        # the predicted variance, not the measured one: small values would else weigh more and pull the mean down
        variance = (relative_std * (floor + skirt)) ** 2 + (_SKIRT_UNCERTAINTY * skirt) ** 2
        # a calibrated floor that the measurement contradicts beyond chance loses its weight
        doubt = np.maximum((measured - floor) ** 2 - 4.0 * variance, 0.0)
        floor_variance = (_FLOOR_UNCERTAINTY * floor) ** 2 + doubt
        blended = (measured * floor_variance + floor * variance) / (floor_variance + variance)
        return np.maximum(blended, self.quantisation)

    def _read(self, power: np.ndarray, peak: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the power in the bins in which the noise is read (B, K), and the skirt there per line power (B,)."""
        first, last = self.first_bin, self.last_bin
        count = min(_BINS, max((last - first + 1) // 4, 1))
        if self.noises:
            lower, high = 2 * peak < first + last, last - count + 1
            read = np.where(lower[:, None], power[:, high : high + count], power[:, first : first + count])
            starts = np.where(lower, high, first).tolist()
            return read, np.array([self._skirt_of(s, count, p) for s, p in zip(starts, peak.tolist(), strict=True)])
        half = np.arange(self.guard, self.guard + max(count // 2, 1))
        bins = peak[:, None] + np.concatenate([-half[::-1], half])
        bins = np.where(bins < first, bins + 4 * half[-1], bins)  # past the end: on the other side
        bins = np.clip(np.where(bins > last, bins - 4 * half[-1], bins), first, last)
        return power[np.arange(len(peak))[:, None], bins], np.zeros(len(peak))

    def _clipped_mean(self, power: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the noise level of bins, free of spurs [LSB^2], and its relative standard deviation."""
        count = power.shape[1]
        limit = np.partition(power, count // 2, axis=1)[:, count // 2, None] * (_CLIP / math.log(2.0))
        kept = power <= limit
        mean = np.where(kept, power, 0.0).sum(axis=1) / kept.sum(axis=1)
        return mean / (_KEPT_MEAN * self.window_power), math.sqrt(self.correlated_bins / count)

    def _skirt_of(self, start: int, count: int, peak: int) -> float:
        """Return `_skirt` of a line in bin `peak`; lines stay in few bins, so it is computed once for each."""
        if peak not in self.skirts:
            self.skirts[peak] = self._skirt(np.arange(start, start + count), peak)
        return self.skirts[peak]

    def _skirt(self, bins: np.ndarray, peak: int) -> float:
        """Return the mean phase-noise skirt over `bins` (K,) per line power (amplitude of the complex line squared)."""
        stride = max(len(bins) // _SKIRT_POINTS, 1)
        width, rate = self.sweep.sample_rate / self.length, self.sweep.sample_rate
        at, line = bins[stride // 2 :: stride] * width, peak * width
        # a real line has its mirror image, which repeats at the sample rate
        offsets = [at - line] if self.iq else [at - line, np.minimum(at + line, rate - at - line)]
        density = np.sum([noise.single_sideband(np.stack(offsets)) for noise in self.noises], axis=(0, 1))
        if self.sweep.hears_itself:
            density *= combination_gain(at - line, line / abs(self.sweep.chirp_rate))
        return float(density.mean() * rate)
