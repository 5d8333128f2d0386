"""Beat frequency of a batch of sweeps, with standard deviation, phase, power, signal-to-noise ratio and flags.

Free of ROS. An estimator is made once per setting (`registry.estimator`) and called with the samples of any number of
sweeps. Each sweep's result is bit-identical whatever the batch.

Conventions: frequencies count on the station's own nominal clock. The line is the one at positive frequency,
A cos(phase), and `phase` is its phase at the nominal sweep's centre, T_sw/2 after the first sample. A quadrature
receiver's line may stand at negative frequency; its sweep is then conjugated, so that the frequency reported is
positive there too.
"""

import dataclasses
import enum
import math
from typing import Any, ClassVar

import numpy as np
import scipy

from drfmcw_physics.bounds import additive_std, image_noise_ratio, phase_noise_std
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError, parameter
from drfmcw_physics.sweep import SweepSettings, beat_frequency, residual_chirp
from drfmcw_physics.windows import WINDOWS

from .damage import clipped, has_burst
from .noise import NoiseMeter, oscillators
from .spectral import parabola_vertex, window_samples
from .straightness import contradiction

ESTIMATORS: dict[str, type['Estimator']] = {}
"""Estimators by the name that `EstimatorSettings.estimator` selects; each registers itself."""

TINY = 1e-30
"""Squared magnitude that replaces zero, where a logarithm or a quotient needs more [LSB^2]."""

_DECHIRP_BINS = 0.02  # residual chirp across the window below which the line keeps it [bins]
_FALSE_DETECTION = 1e-6  # probability that noise alone passes for a line, per sweep
_PEAKS_PER_BIN = 2.0  # independent values among which the peak of noise is sought
_METER_MARGIN = 2.0  # what the noise level's own error adds to the exponent: E exp(-e (1 + d)), d of 8 %
_DOUBTED = 3.0  # times the standard deviation of a line, from which on a bent ramp is said
_FASTEST = 100.0  # by which a path may change: what the line's frequency then changes by is no bent ramp [m/s]
_ABSENT = (math.nan, math.inf, math.inf, math.nan, -math.inf, -math.inf)  # results of a sweep without any signal
_LOBE_BINS = 4  # half width of the main lobe of the widest usual window


class Flag(enum.IntFlag):
    """Reasons to doubt a beat frequency (bits of BeatFrequency.flags)."""

    VALID = 0
    WEAK_SIGNAL = 1
    CLIPPED = 2
    NEAR_DC = 4
    NEAR_NYQUIST = 8
    AMBIGUOUS = 16
    BURST = 32
    MODEL_MISMATCH = 64  # a station's own line varies over the sweep as no straight ramp lets it


@dataclasses.dataclass(frozen=True)
class EstimatorSettings:
    """Settings of the beat-frequency estimation."""

    estimator: str = parameter(
        'paper',
        choices=ESTIMATORS,
        description='how the line is found (docs/estimators.md compares them)',
    )
    window: str = parameter(
        'hann',
        choices=WINDOWS,
        description='window over the common part of both sweeps, for an estimator that takes one',
    )
    zoom_points: int = parameter(33, bounds=(5, 1025), description='points of the chirp-z zoom')
    zoom_span: float = parameter(2.0, unit='bins', bounds=(1.0, 16.0), description='width of the chirp-z zoom')
    guard_bins: float = parameter(
        8.0, unit='bins', bounds=(2.0, 1e4), description='not searched next to 0 Hz and to the Nyquist frequency'
    )
    minimum_frequency: float = parameter(
        0.0, unit='Hz', bounds=(0.0, 1e10), description='lowest frequency searched, where above the guard'
    )
    maximum_frequency: float = parameter(
        1e10, unit='Hz', bounds=(1.0, 1e10), description='highest frequency searched, where below the guard'
    )
    search_range_minimum: float = parameter(
        0.0, unit='m', bounds=(0.0, 1e7), description='shortest distance searched: leakage and walls are nearer'
    )
    search_range_maximum: float = parameter(1e7, unit='m', bounds=(1e-3, 1e7), description='longest distance searched')
    weak_threshold: float = parameter(
        13.0, unit='dB', bounds=(0.0, 100.0), description='signal-to-noise ratio below which a line is flagged weak'
    )
    ambiguity_threshold: float = parameter(
        6.0, unit='dB', bounds=(0.0, 60.0), description='a second line less than this below the first is flagged'
    )

    def __post_init__(self) -> None:
        """Refuse an empty search range, and a window that would not be used."""
        taking = [name for name, cls in ESTIMATORS.items() if cls.takes_window]
        if self.window != 'hann' and self.estimator not in taking:
            named = ' and '.join(f"'{name}'" for name in taking)
            raise ConfigurationError(
                f"window = '{self.window}' is for estimator {named}; '{self.estimator}' has its own"
            )
        if self.search_range_minimum >= self.search_range_maximum:
            raise ConfigurationError(
                f'search_range_minimum = {self.search_range_minimum:g} m is not below '
                f'search_range_maximum = {self.search_range_maximum:g} m'
            )
        if self.minimum_frequency >= self.maximum_frequency:
            raise ConfigurationError(
                f'minimum_frequency = {self.minimum_frequency:g} Hz is not below '
                f'maximum_frequency = {self.maximum_frequency:g} Hz'
            )


@dataclasses.dataclass(frozen=True)
class Estimates:
    """Results of a batch of B sweeps; arrays of shape (B,), the fields of BeatFrequency."""

    flags: np.ndarray  # uint8, bits of Flag
    frequency: np.ndarray  # [Hz], on the station's own nominal clock; NaN where the sweep holds no signal at all
    frequency_std: np.ndarray  # of this station's frequency alone [Hz]
    independent_std: np.ndarray  # its part without the oscillators' noise around the line, which the peer shares [Hz]
    phase: np.ndarray  # at the sweep's centre [rad]
    power: np.ndarray  # at the receive antenna port [dBm]; NaN where full_scale_power is unknown
    snr: np.ndarray  # line power over additive noise power in one bin of 1/ramp_duration [dB]
    spectrum: np.ndarray | None  # magnitude (B, K) float32 [dBFS], None where not asked for
    window: str  # by which the estimate weighs the samples
    spectrum_start: float  # frequency of its first bin [Hz]
    spectrum_step: float  # [Hz]


@dataclasses.dataclass
class Sweeps:
    """A chunk of B sweeps between coarse search and refinement; a refinement may move `peak`."""

    samples: np.ndarray  # as the ADC gave them
    record: np.ndarray  # (B, N) less the mean, float32 or complex64 [LSB]
    windowed: np.ndarray  # the same windowed and de-chirped
    spectrum: np.ndarray  # its bins from 0 Hz up (B, K), complex64
    power: np.ndarray  # their squared magnitude (B, K)
    shown: np.ndarray  # power of the published spectrum, which for quadrature samples has negative frequencies too
    peak: np.ndarray  # strongest bin within the search range (B,)

    def parabola(self) -> np.ndarray:
        """Return the offset of the line from `peak`, by a parabola through three log powers (B,) [bins]."""
        near = np.clip(self.peak + np.array([[-1], [0], [1]]), 0, self.power.shape[1] - 1)
        three = self.power[np.arange(len(self.peak)), near].astype(float)
        return parabola_vertex(*np.log(np.maximum(three, TINY)))


class Estimator:
    """What every estimator shares: window, de-chirping, coarse search, noise, standard deviation and flags.

    A subclass gives its name, ``class PaperEstimator(Estimator, name='paper')``, and says in `_refine` how the line is
    found around its strongest bin.
    """

    takes_window: ClassVar[bool] = False
    """True where the window that the settings choose is used; else it is 'hann'."""

    own_weighting: ClassVar[str] = ''
    """Window by which the estimate weighs the samples, where that is not the window of the search."""

    chunk: ClassVar[int] = 1 << 18
    """Samples worked on at once: many, to share the overhead of calls, few enough for the cache."""

    def __init_subclass__(cls, name: str, **kwargs: Any) -> None:
        """Register the estimator under its name."""
        super().__init_subclass__(**kwargs)
        ESTIMATORS[name] = cls
        for known in sorted(ESTIMATORS):  # whichever module was imported first
            ESTIMATORS[known] = ESTIMATORS.pop(known)

    def __init__(
        self,
        sweep: SweepSettings,
        settings: EstimatorSettings,
        iq: bool = False,
        own: Calibration | None = None,
        peer: Calibration | None = None,
    ) -> None:
        """Prepare everything that does not depend on the samples.

        Args:
            sweep: the station's settings.
            settings: of the estimation.
            iq: quadrature samples.
            own: the station's calibration, None where unknown.
            peer: the peer's; ignored where the station hears itself.

        Raises:
            ConfigurationError: the settings leave no window or no frequency to search.
        """
        self.sweep, self.settings, self.iq = sweep, settings, iq
        self.weighting = self.own_weighting or settings.window
        rate, count = sweep.sample_rate, sweep.sample_count
        start, end = sweep.analysis_window()
        self.duration, self.center = end - start, (start + end) / 2
        if self.duration * rate < 16:
            raise ConfigurationError(f'station {sweep.station}: fewer than 16 samples lie in the analysis window')
        # a length without large prime factors keeps the FFT fast; Table 1's 2048 stays as it is
        self.length = _fft_length(count)
        window = window_samples(settings.window, start, end, rate, count)
        self._window = window.astype(np.float32)
        scipy.fft.rfft(self._window, self.length)  # SciPy imports a package when first used: now, not at a sweep
        self.window_sum = float(window.sum())
        window_power = float((window**2).sum())
        bin_width, resolution = rate / self.length, 1.0 / self.duration
        nearest, farthest = self._searched(own, peer)
        lowest = max(settings.guard_bins * resolution, settings.minimum_frequency, nearest)
        highest = min(rate / 2 - settings.guard_bins * resolution, settings.maximum_frequency, farthest)
        self._first, self._last = math.ceil(lowest / bin_width), math.floor(highest / bin_width)
        if self._last - self._first < 2 * _LOBE_BINS:
            raise ConfigurationError(
                f'station {sweep.station}: no frequency to search between {lowest:g} Hz and {highest:g} Hz'
            )
        self._edges = (lowest + 2 * resolution, highest - 2 * resolution)
        # noise's strongest bin follows exp(-power / mean): its SNR, by the weights that give the line's amplitude
        exponent = math.log(_PEAKS_PER_BIN * (self._last - self._first + 1) / _FALSE_DETECTION) + _METER_MARGIN
        weights = window_samples(self.weighting, start, end, rate, count)
        spread = float((weights**2).sum() / weights.sum() ** 2)
        detection = 10.0 * math.log10(exponent * spread * rate * sweep.ramp_duration)
        self._detection = max(settings.weak_threshold, detection)  # [dB]
        self.chirp = self._residual_chirp(own, peer)
        """Residual chirp of the line, 0 where it is negligible or unknown [Hz/s]."""
        self._dechirp = self._chirp_factor()
        calibrations = (own,) if sweep.hears_itself else (own, peer)
        self.noises = oscillators(*calibrations)
        autocorrelation = np.abs(np.fft.fft(window**2, self.length)[: 2 * _LOBE_BINS] / window_power) ** 2
        self.meter = NoiseMeter(
            sweep=sweep,
            noises=self.noises,
            floor=own.noise_floor if own is not None else math.nan,
            iq=iq,
            length=self.length,
            first_bin=self._first,
            last_bin=self._last,
            guard=2 * _LOBE_BINS,
            correlated_bins=float(1.0 + 2.0 * autocorrelation[1:].sum()),
            window_sum=self.window_sum,
            window_power=window_power,
        )
        # each oscillator's noise passes whole into a single station's frequency
        self._phase_noise_variance = sum(
            phase_noise_std(n, self.duration, self.weighting) ** 2 for n in self.noises if not sweep.hears_itself
        )

    def _searched(self, own: Calibration | None, peer: Calibration | None) -> tuple[float, float]:
        """Return the frequencies of a line between which the range searched lies [Hz]; all where none is set."""
        settings, lines = self.settings, []
        hardware = sum(c.delay for c in ((own,) if self.sweep.hears_itself else (own, peer)) if c is not None)
        limits = settings.search_range_minimum, settings.search_range_maximum
        if limits == (0.0, 1e7):
            return 0.0, math.inf
        for distance in limits:
            lines.append(abs(beat_frequency(self.sweep, hardware + distance / SPEED_OF_LIGHT, 1.0, 1.0)))
        return min(lines), max(lines)

    def __call__(
        self, samples: np.ndarray, full_scale: np.ndarray | float, spectrum: np.ndarray | None = None
    ) -> Estimates:
        """Estimate the beat frequency of each sweep.

        Args:
            samples: int16 (B, sample_count), or (B, 2 sample_count) I, Q, I, Q, ... of a quadrature receiver.
            full_scale: ADC code of full scale [LSB], scalar or (B,).
            spectrum: mask (B,) of the sweeps whose magnitude spectra are wanted; None for no spectra.
        """
        full_scale = np.full(len(samples), full_scale, float)
        rows = max(self.chunk // self.sweep.sample_count, 1)
        parts = []
        for i in range(0, len(samples), rows):
            chunk = slice(i, i + rows)
            wanted = None if spectrum is None else spectrum[chunk]
            parts.append(self._estimate(samples[chunk], full_scale[chunk], wanted))
        return self.collect(parts)

    def collect(self, parts: list[list[np.ndarray]]) -> Estimates:
        """Return the results of several chunks, each of `conclude`, as one."""
        fields = parts[0] if len(parts) == 1 else [np.concatenate(p) for p in zip(*parts, strict=True)]
        flags, frequency, frequency_std, independent_std, phase, power, snr, *spectrum = fields
        return Estimates(
            flags=flags,
            frequency=frequency,
            frequency_std=frequency_std,
            independent_std=independent_std,
            phase=phase,
            power=power,
            snr=snr,
            spectrum=spectrum[0] if spectrum else None,
            window=self.weighting,
            spectrum_start=-(self.length // 2) * self.sweep.sample_rate / self.length if self.iq else 0.0,
            spectrum_step=self.sweep.sample_rate / self.length,
        )

    def _refine(self, sweeps: 'Sweeps') -> tuple[np.ndarray, np.ndarray]:
        """Return (frequency [bins], complex amplitude of the windowed line at the window centre), each (B,)."""
        raise NotImplementedError

    def _residual_chirp(self, own: Calibration | None, peer: Calibration | None) -> float:
        """Return the residual chirp that the calibrations predict, 0 where it is negligible or unknown [Hz/s]."""
        if own is None or peer is None or self.sweep.hears_itself:
            return 0.0
        # the station counts time with its own ADC clock
        chirp = residual_chirp(self.sweep, own.alpha, peer.alpha) / own.sample_clock_alpha**2
        return 0.0 if abs(chirp) * self.duration**2 < _DECHIRP_BINS else chirp

    def _chirp_factor(self) -> np.ndarray | None:
        """Return the factor (N,) that removes the residual chirp from the line, None where there is none."""
        if not self.chirp:
            return None
        t = np.arange(self.sweep.sample_count) / self.sweep.sample_rate - self.center
        return np.exp(-1j * np.pi * self.chirp * t**2).astype(np.complex64)

    def _estimate(self, samples: np.ndarray, full_scale: np.ndarray, wanted: np.ndarray | None) -> list[np.ndarray]:
        """Return the seven result arrays of one chunk and, where asked for, the spectra of the sweeps `wanted`."""
        sweeps = self.search(samples)
        return self.conclude(sweeps, *self._refine(sweeps), full_scale, wanted)

    def search(self, samples: np.ndarray) -> 'Sweeps':
        """Return the sweeps and the strongest bin of each; `samples` as for a call, few enough for the cache."""
        samples = np.ascontiguousarray(samples)
        record, windowed, spectrum, shown = self._transform(samples)
        power = spectrum.real**2
        power += spectrum.imag**2
        peak = power[:, self._first : self._last + 1].argmax(axis=1) + self._first
        return Sweeps(samples, record, windowed, spectrum, power, power if shown is None else shown, peak)

    def conclude(
        self,
        sweeps: 'Sweeps',
        bins: np.ndarray,
        amplitude: np.ndarray,
        full_scale: np.ndarray,
        wanted: np.ndarray | None,
    ) -> list[np.ndarray]:
        """Return the seven result arrays of a chunk and, where asked for, the spectra of the sweeps `wanted`.

        Args:
            sweeps: of `search`; their power is overwritten.
            bins: frequency of each line (B,) [bins].
            amplitude: of each windowed line at the window's centre, complex (B,) [LSB].
            full_scale: ADC code of full scale (B,) [LSB].
            wanted: mask (B,), None for no spectra.
        """
        line = amplitude.real**2 + amplitude.imag**2
        noise = self.meter.measure(sweeps.power, sweeps.peak, line, full_scale)
        magnitude = [] if wanted is None else [self._decibel_full_scale(sweeps.shown[wanted], full_scale[wanted])]
        results = self._results(sweeps, bins, amplitude, line, noise, full_scale)
        results[0][has_burst(sweeps.record, self.weighting != 'boxcar')] |= np.uint8(Flag.BURST)
        return results + magnitude

    def _transform(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """Return the sweeps less their mean, the same windowed and de-chirped, bins from 0 Hz up, power to show.

        float32 suffices: its 1e-7 lies below the rounding of a 16-bit ADC. A quadrature sweep whose line has a negative
        frequency is conjugated. The power to show is that of all bins as received for quadrature samples, else None.
        """
        positive = self.length // 2 + 1
        if self.iq:
            record = self._without_mean(samples.reshape(len(samples), -1, 2)).view(np.complex64)[..., 0]
            windowed = record * self._window
            spectrum = scipy.fft.fft(windowed, self.length)
            power = spectrum.real**2 + spectrum.imag**2
            above = power[:, self._first : self._last + 1].max(axis=1)
            below = power[:, self.length - self._last : self.length - self._first + 1].max(axis=1)
            reversed_rows = (below > above)[:, None]
            record = np.where(reversed_rows, record.conj(), record)
            windowed = np.where(reversed_rows, windowed.conj(), windowed)
            shown = np.fft.fftshift(power, axes=1)
            if self._dechirp is None and not reversed_rows.any():
                return record, windowed, spectrum[:, :positive], shown
        else:
            record, shown = self._without_mean(samples), None
            windowed = record * self._window
            if self._dechirp is None:
                return record, windowed, scipy.fft.rfft(windowed, self.length), shown
        if self._dechirp is not None:
            windowed = windowed * self._dechirp
        return record, windowed, scipy.fft.fft(windowed, self.length)[:, :positive], shown

    @staticmethod
    def _without_mean(samples: np.ndarray) -> np.ndarray:
        """Return sweeps (B, N) or (B, N, 2) as float32 less their mean, which would leak into the search range."""
        if samples.dtype.kind == 'i':  # integer sums are exact, whatever their order
            mean = samples.sum(axis=1, dtype=np.int64) / samples.shape[1]
        else:  # a model's samples before the ADC
            mean = samples.mean(axis=1)
        record = samples.astype(np.float32)
        record -= mean[:, None].astype(np.float32)
        return record

    def _results(
        self,
        sweeps: 'Sweeps',
        bins: np.ndarray,
        amplitude: np.ndarray,
        line: np.ndarray,
        noise: np.ndarray,
        full_scale: np.ndarray,
    ) -> list[np.ndarray]:
        """Return the seven result arrays from the refined line.

        Args:
            sweeps: of `search`.
            bins: frequency of each line (B,) [bins].
            amplitude: of each windowed line at the window's centre, complex (B,) [LSB].
            line: squared magnitude of `amplitude` (B,).
            noise: additive noise (B,) [LSB^2].
            full_scale: ADC code of full scale (B,) [LSB].
        """
        sweep, settings = self.sweep, self.settings
        frequency = bins * (sweep.sample_rate / self.length)
        absent = line <= 0.0
        any_absent = bool(absent.any())
        line = np.where(absent, TINY, line) if any_absent else line
        ratio = line / self.window_sum**2 / noise * sweep.sample_rate  # of line to noise density [Hz]
        snr = ratio * sweep.ramp_duration
        lead = sweep.ramp_duration / 2 - self.center
        phase = np.angle(amplitude) + 2.0 * np.pi * (frequency * lead + 0.5 * self.chirp * lead**2)
        level = self._decibel_full_scale(line, full_scale)
        snr_decibel = 10.0 * np.log10(snr)
        std, independent = self._frequency_std(frequency, ratio * self.duration)
        second = self._second_line(sweeps.power, sweeps.peak) / line  # counts only if it is not weak itself
        ambiguous = (second > 10.0 ** (-settings.ambiguity_threshold / 10.0)) & (
            second * snr > 10.0 ** (settings.weak_threshold / 10.0)
        )
        bent = np.zeros(len(line))
        if sweep.hears_itself:  # a pair has tests of its own: T_off, powers, continuity
            drift = np.sqrt(np.maximum(std**2 - independent**2, 0.0))
            moving = 2.0 * abs(sweep.chirp_rate) * _FASTEST / SPEED_OF_LIGHT  # by the delay, and by the Doppler shift
            known = np.where(absent, np.nan, frequency)
            bent = contradiction(sweeps.record, known, ratio, sweep.sample_rate, drift, moving)
            bent[bent < _DOUBTED * std] = 0.0
            std, independent = np.hypot(std, bent), np.hypot(independent, bent)
        flags = (snr_decibel < self._detection).astype(np.uint8) * np.uint8(Flag.WEAK_SIGNAL)
        for flag, raised in (
            (Flag.CLIPPED, clipped(sweeps.samples, full_scale)),
            (Flag.NEAR_DC, frequency < self._edges[0]),
            (Flag.NEAR_NYQUIST, frequency > self._edges[1]),
            (Flag.AMBIGUOUS, ambiguous),
            (Flag.MODEL_MISMATCH, bent > 0.0),
        ):
            flags[raised] |= np.uint8(flag)
        phase = np.remainder(phase + np.pi, 2.0 * np.pi) - np.pi
        estimates = frequency, std, independent, phase, level, snr_decibel
        if any_absent:
            for values, value in zip(estimates, _ABSENT, strict=True):
                values[absent] = value
        level += sweep.full_scale_power
        return [flags, *estimates]

    def _frequency_std(self, frequency: np.ndarray, snr: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the standard deviation of a single station's frequency, with and without the oscillators' noise.

        Args:
            frequency: of the line (B,) [Hz].
            snr: line power over additive noise power in a bin of 1/duration (B,) [1].
        """
        inverse = 1.0 / snr
        variance: np.ndarray | float = self._phase_noise_variance
        if not self.iq:
            for noise in self.noises:
                inverse = inverse + image_noise_ratio(noise, frequency, self.duration, self.sweep.sample_rate)
        if self.sweep.hears_itself and self.noises:
            noise, window = self.noises[0], self.weighting
            delays = frequency / abs(self.sweep.chirp_rate)
            variance = np.array([phase_noise_std(noise, self.duration, window, d) for d in delays]) ** 2
        independent = additive_std(1.0 / inverse, self.duration, self.weighting)
        return np.sqrt(independent**2 + variance), independent

    def _second_line(self, power: np.ndarray, peak: np.ndarray) -> np.ndarray:
        """Return the power of the strongest bin outside the line's main lobe (B,); zeroes the line in `power`."""
        lobe = _LOBE_BINS * max(1, round(self.length / (self.duration * self.sweep.sample_rate)))
        around = peak + np.arange(-lobe, lobe + 1)[:, None]
        np.maximum(around, 0, out=around)
        np.minimum(around, power.shape[1] - 1, out=around)
        power[np.arange(len(peak)), around] = 0.0
        return power[:, self._first : self._last + 1].max(axis=1)

    def _decibel_full_scale(self, power: np.ndarray, full_scale: np.ndarray) -> np.ndarray:
        """Return squared bin magnitudes in dBFS; a full-scale sine reads 0. float32 for spectra."""
        per_amplitude = (1.0 if self.iq else 0.5) * self.window_sum * full_scale
        if power.ndim == 1:
            return 10.0 * np.log10(power / per_amplitude**2)
        scaled = np.maximum(power * (1.0 / per_amplitude**2)[:, None], 1e-30).astype(np.float32)
        np.log10(scaled, out=scaled)
        scaled *= np.float32(10.0)
        return scaled


def _fft_length(count: int) -> int:
    """Return the smallest length from `count` on with no prime factor above 7."""
    while True:
        rest = count
        for prime in (2, 3, 5, 7):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return count
        count += 1
