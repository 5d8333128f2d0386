"""The numbers by which a recording and its model are compared: a few thousand per recording, on all levels.

The same functions evaluate measured and simulated samples. Each sweep pair has its own amplitude, phase and start
delay, which are no mismatch and are removed. What remains is

- ramp: log amplitude of both lines, and sum and difference of both phases, over the time in the sweep. The oscillators'
  noise appears in the sum alone, a second path in both, a synthesiser's error in the sum;
- flutter: by how much that changes from sweep to sweep beyond the noise, as under a modulation of random phase;
- spectrum: narrow lines beside the stations' own, and the mean of the samples;
- ends: when the signal begins and ends;
- onset: the line in the first samples of the signal over that after them, as a settling synthesiser changes it;
- baseline: how that mean changes over the sweep, as while a receiver settles;
- harmonic: the line's harmonics at the line's own phase, to which a distortion is locked and noise is not;
- piled: excess of samples at the outermost codes, which a limiter causes;
- burst: how unevenly the power beside the line is spread over sweeps and spans of a sweep;
- noise: power of the spectrum in bands, without lines;
- coherence: what the oscillators' noise in both lines has in common, which shows whose noise it is (`coherence`);
- beat: what both beat frequencies have in common, 2 k T_off and the references' difference;
- amplitude: received power;
- range: combined delay, as range beyond the reference;
- movement: range by the carrier phase within a group.

One station alone has neither sum nor difference: its own amplitude and phase over the sweep are compared, and the
range from its line. Where it hears a peer, that range takes T_off as nominal, whose jitter hides a movement in the
phase. Where it hears itself, most of its oscillator's noise cancels because the delay is short.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import scipy.fft

from drfmcw_fusion.combination import PathDelay, combine, delay_on_true_clocks
from drfmcw_fusion.combination import Station as Share
from drfmcw_node.estimators.blocks import Basebands, SingleEstimator
from drfmcw_node.estimators.estimation import Estimates, EstimatorSettings
from drfmcw_node.estimators.pair import PairEstimator
from drfmcw_node.estimators.spectral import window_samples
from drfmcw_node.processing.records import Beat
from drfmcw_physics.constants import DECIBELS_PER_NEPER, SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import SweepSettings

from ..recording.dataset import delay_of_one
from ..recording.topology import Topology
from . import adc_codes, coherence, signal_ends, surges, transient
from .limits import SIDEBANDS, SPECTRUM
from .spectra import at_line, near_line


@dataclasses.dataclass(frozen=True)
class SweepFeatures:
    """Features of n sweeps of one setting; S stations with samples, K blocks, B bins, Q parts of a sample (I and Q)."""

    ramp: np.ndarray  # (n, 2 S, K): log amplitudes, then phases [rad], of a pair their sum and difference over sqrt(2)
    time: np.ndarray  # (K,) of the blocks in the first station's sweep [s]
    power: np.ndarray  # (n, S, B) squared magnitude of the Hann-windowed samples [LSB^2]
    line: np.ndarray  # (n, S) frequency of each line [Hz]
    mean: np.ndarray  # (n, S, Q) of the samples, weighted by a Hann window that keeps the line out [LSB]
    ends: np.ndarray  # (n, S, 2) samples before the signal begins, and before it ends
    baseline: np.ndarray  # (n, S, Q V) means of the samples in V spans of the sweep, less the mean of these [LSB]
    onset: (
        np.ndarray
    )  # (n, S, 2 V) change of the line in the first samples, real, then imaginary parts, see `signal_ends.onset`
    transient: np.ndarray  # (n, S, 2 V) means in spans after the begin, at the line's phase, see `transient.measured`
    harmonic: np.ndarray  # (n, S, 2 H) real, then imaginary parts of the line's harmonics over the line, NaN in its way
    piled: np.ndarray  # (n, S) samples at the outermost codes, more than beside them, see `adc_codes.piled`
    quiet: np.ndarray  # (n, S, T) power of the IF without its line in equal spans of the sweep [LSB^2]
    surge: np.ndarray  # (n, S, W) largest power in windows of that, as standard normals, see `surges.measured`
    beat: np.ndarray  # (n,) f_1 + f_2 (difference in long-distance mode), or the one line's frequency [Hz]
    amplitude: np.ndarray  # (n, S) of each line [dB of 1 LSB]
    range: np.ndarray  # (n,) from the combined delay, hardware and air taken off [m]
    range_std: np.ndarray  # (n,) or (n, 0), as fusion reports it [m]
    # phase from which a movement follows: sum of both, or that of a station that hears itself (n,) or (n, 0) [rad]
    carrier: np.ndarray
    phase_std: np.ndarray  # (n,) or (n, 0) of it, by additive noise and mirror lines [rad]

    @functools.cached_property
    def free(self) -> np.ndarray:
        """Which sweeps hold no burst (n, S), see `quiet_sweeps`."""
        return quiet_sweeps(self.quiet, self.power)

    @property
    def calm(self) -> np.ndarray:
        """Which sweeps hold no burst at any station (n,)."""
        return np.asarray(np.all(self.free, axis=1))


class Extractor:
    """Turns the samples of one or two stations, of one setting, into features."""

    def __init__(
        self,
        sweeps: tuple[SweepSettings, ...],
        calibrations: tuple[Calibration, ...],
        topology: Topology,
        blocks: range | None = None,
        most: int | None = None,
    ) -> None:
        """Prepare the estimators.

        Args:
            sweeps: settings of the first and the second station, or of the one that hears itself.
            calibrations: of the same.
            topology: of the same.
            blocks: lengths of a block to choose from [samples]; None: those of `block_lengths`.
            most: blocks of the ramp that are compared, the first ones; None: all.
        """
        self._most = most
        self.sweeps, self.calibrations, self.topology = sweeps, calibrations, topology
        settings, iq, own = EstimatorSettings(estimator='pair'), topology.iq, topology.heard[0]
        blocks = blocks or block_lengths(sweeps[own].sample_count)
        self.sign = sweeps[0].line_sign() * sweeps[-1].line_sign()
        self.way_per_phase = topology.way_per_phase(sweeps)
        self.beat_per_start_delay = topology.beat_per_start_delay(sweeps)
        self.estimator: PairEstimator | SingleEstimator
        if topology.both_heard:
            (first, second), (calibration, other) = sweeps, calibrations
            self.estimator = PairEstimator(
                first, second, settings, iq, calibration, other, blocks=blocks, chirp_known=False
            )
        else:
            calibrated = calibrations[own], calibrations[-1 - own]
            self.estimator = SingleEstimator(sweeps[own], settings, iq, *calibrated, blocks)
        self.time = np.zeros(0)
        """Of the blocks in the first station's sweep, once sweeps have come [s]."""

        window = self.estimator.stations[0].duration
        # standard deviation of the phase in mid-window over that of the frequency [rad/Hz]
        self.phase_per_frequency = 2.0 * np.pi * window / np.sqrt(12.0)
        self.window_power = tuple(s.meter.window_power for s in self.estimator.stations)
        self._weights = [
            window_samples('hann', *s.sweep.analysis_window(), s.sweep.sample_rate, s.sweep.sample_count) / s.window_sum
            for s in self.estimator.stations
        ]
        self._spans = [spans(s.sweep) for s in self.estimator.stations]

    def __call__(
        self,
        samples: tuple[np.ndarray, ...],
        full_scale: float,
        index: np.ndarray | float,
        harmonic: bool = True,
        quiet: bool = True,
        noisy: bool = True,
        shape: bool = True,
    ) -> SweepFeatures:
        """Return the features of sweeps.

        Args:
            samples: of each station with samples (n, N) or (n, 2 N), int16, or float before the ADC.
            full_scale: ADC code of full scale [LSB].
            index: refractive index of the air (n,), or one for all.
            harmonic: compute `harmonic` and `piled`; otherwise they are (n, S, 0) and 0.
            quiet: compute `quiet` and `surge`; otherwise they are (n, S, 0).
            noisy: compute `range_std`, `carrier` and `phase_std`; otherwise they are (n, 0).
            shape: compute `ramp`, `mean`, `ends`, `onset`, `baseline`, `transient`, `beat`, `amplitude`, `range`;
                otherwise they are (n, 0), `noisy` or not, and `line` is that of a first round.
        """
        functions = (
            (self._harmonics, harmonic),
            (self._piled, harmonic),
            (self._without_line, quiet),
            (surges.measured, quiet),
        )
        taken = tuple(f for f, wanted in functions if wanted)
        parts = [self._chunk(chunk, full_scale, taken, noisy, shape) for chunk in _chunks(samples)]
        found = [np.concatenate(values) for values in zip(*parts, strict=True)]
        ramp, power, line, mean, ends, begun, baseline, fading, beat, amplitude, *rest = found
        delay, std, carrier, phase_std, *rest = rest
        nothing = np.zeros((*line.shape, 0))
        harmonics, piles, quiets, surge = (rest.pop(0) if wanted else nothing for _, wanted in functions)
        hardware = sum(c.delay for c in self.calibrations)
        velocity = SPEED_OF_LIGHT / index
        return SweepFeatures(
            ramp=ramp,
            time=self.time,
            power=power,
            line=line,
            mean=mean,
            ends=ends,
            baseline=baseline,
            onset=begun,
            transient=fading,
            harmonic=harmonics,
            piled=piles[..., 0] if harmonic else np.zeros(line.shape),
            quiet=quiets,
            surge=surge,
            beat=beat,
            amplitude=amplitude,
            range=(delay - hardware) * velocity if shape else delay,
            range_std=(std.T * velocity).T,
            carrier=carrier,
            phase_std=phase_std,
        )

    def amplitude(self, samples: tuple[np.ndarray, ...]) -> np.ndarray:
        """Return only the amplitude of each line (n, S) [dB of 1 LSB], of `samples` as a call takes them."""
        return np.concatenate([self._ramp(self.estimator.basebands(chunk))[1] for chunk in _chunks(samples)])

    @property
    def covered(self) -> int:
        """Samples of the analysis window."""
        return min(s.samples.stop - s.samples.start for s in self.estimator.stations)

    def white_noise(self, sweeps: SweepFeatures, noise: np.ndarray) -> dict[str, np.ndarray]:
        """Return variances that additive noise alone makes of one sweep.

        Of its ramp (2 S,), mean (S, Q), ends (S, 2) and baseline (S, Q V).

        Args:
            sweeps: features of a group, of one station.
            noise: variance per sample (S,) [LSB^2].
        """
        parts = self.topology.parts
        line = 10.0 ** (sweeps.amplitude.mean(axis=0) / 10.0) * self.topology.line_share
        ramp = noise / (2.0 * self.estimator.block * line)
        mean = noise / parts * np.array([w @ w for w in self._weights])
        baseline = (noise / parts)[:, None] * np.array([np.sum(w**2, axis=0) for w in self._spans])
        ends = SPECTRUM.edge_samples * noise / line
        return {
            'ramp': np.tile(ramp, 2),
            'ends': np.repeat(ends[:, None], 2, axis=1),
            'mean': np.repeat(mean[:, None], parts, axis=1),
            'baseline': np.tile(baseline, (1, parts)),
        }

    def shared_noise(self, samples: tuple[np.ndarray, ...], sweeps: SweepFeatures) -> np.ndarray:
        """Return each quiet sweep's share in the coherence of both lines' phase noise (m, C), see `coherence`.

        A burst would count for more than all other sweeps. Where few sweeps are quiet, all count. Zero for one station
        alone, and for quadrature samples, whose line may be at negative frequency.

        Args:
            samples: of each station with samples (n, N).
            sweeps: their features.
        """
        if not self.topology.shares_noise:
            return np.zeros((len(samples[0]), SIDEBANDS.bands))
        time = sweeps.time - sweeps.time.mean()
        total, difference = sweeps.ramp[:, 2:].mean(axis=0)
        phases = (total + difference) / np.sqrt(2.0), self.sign * (total - difference) / np.sqrt(2.0)
        chirp = np.array([np.polyfit(time, phase, 2)[0] / np.pi for phase in phases])
        later = self.sweeps[0].start_delay + (sweeps.beat - sweeps.beat.mean()) / self.beat_per_start_delay
        quiet = sweeps.calm
        if quiet.sum() < SIDEBANDS.quiet:
            quiet[:] = True
        samples = tuple(x[quiet] for x in samples)
        return coherence.measured(samples, sweeps.line[quiet], chirp, later[quiet], self._weights, self.sweeps)

    def _chunk(
        self,
        samples: tuple[np.ndarray, ...],
        full_scale: float,
        taken: Sequence[Callable[..., np.ndarray]],
        noisy: bool,
        shape: bool,
    ) -> tuple[np.ndarray, ...]:
        """Return the feature arrays of a chunk, those that take single stations' samples last; delays, not ranges."""
        n = len(samples[0])
        nothing = np.zeros((n, 0))
        noise_features = (nothing,) * 3
        if not shape:
            power, lines = self.estimator.spectra(samples)
            ramp = mean = ends = begun = baseline = fading = beat = amplitude = delay = nothing
        else:
            if noisy:
                estimates, base = self.estimator.with_basebands(samples, full_scale)
                noise_features = self._noisy(estimates)
            else:
                base = self.estimator.basebands(samples)
            power, lines = base.power, base.beat
            ramp, amplitude = self._ramp(base)
            beat, delay = self._delay(lines)
            mean = self._means(samples, [w[:, None] for w in self._weights])
            each = [
                (as_complex(x.astype(np.float32), self.topology.iq), at, w, s.sweep)
                for x, at, w, s in zip(samples, lines, self._weights, self.estimator.stations, strict=True)
            ]
            ends = np.stack([signal_ends.measured(x, at, sweep) for x, at, _, sweep in each], axis=1)
            begun = np.stack([signal_ends.onset(x, at, sweep) for x, at, _, sweep in each], axis=1)
            fading = np.stack([transient.measured(*of_station) for of_station in each], axis=1)
            baseline = self._means(samples, self._spans)
        stations = self.estimator.stations
        of_stations = tuple(
            np.stack(
                [
                    take(as_complex(x.astype(np.float32), self.topology.iq), at, w, s.sweep)
                    for x, at, w, s in zip(samples, lines, self._weights, stations, strict=True)
                ],
                axis=1,
            )
            for take in taken
        )
        of_line = ramp, np.stack(power, axis=1), lines.T, mean, ends, begun, baseline, fading, beat, amplitude, delay
        return (*of_line, *noise_features, *of_stations)

    def _means(self, samples: tuple[np.ndarray, ...], weights: Sequence[np.ndarray]) -> np.ndarray:
        """Return weighted means of each station's samples (n, S, Q V), of I and Q apart; `weights` (N, V) each."""
        parts = self.topology.parts
        means = [
            np.concatenate([x.reshape(len(x), -1)[:, i::parts] @ w for i in range(parts)], axis=1)
            for x, w in zip(samples, weights, strict=True)
        ]
        return np.stack(means, axis=1)

    def _ramp(self, base: Basebands) -> tuple[np.ndarray, np.ndarray]:
        """Return `ramp` and `amplitude` of sweeps, see `SweepFeatures`."""
        lines, time = base.lines[..., : self._most], base.time[..., : self._most]
        self.time = time[0]
        log = np.log(np.maximum(np.abs(lines), 1e-9))
        level = log.mean(axis=-1)
        t = (time - time.mean(axis=-1, keepdims=True))[:, None]
        phase = np.unwrap(np.angle(lines), axis=-1)
        phase -= phase.mean(axis=-1, keepdims=True)
        phase -= (phase * t).sum(axis=-1, keepdims=True) / (t * t).sum(axis=-1, keepdims=True) * t
        if self.topology.both_heard:
            one, two = phase[0], self.sign * phase[1]
            phase = np.array([(one + two) / np.sqrt(2.0), (one - two) / np.sqrt(2.0)])
        ramp = np.concatenate([log - level[..., None], phase]).swapaxes(0, 1)
        return ramp, DECIBELS_PER_NEPER * level.T + 20.0 * np.log10(self.topology.amplitude_factor)

    def _delay(self, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `beat` [Hz] and the combined delay [s] of sweeps, by their lines' frequencies (S, n) [Hz]."""
        if not self.topology.both_heard:
            own = self.topology.heard[0]
            calibrated = self.calibrations[own], self.calibrations[-1 - own]
            return lines[0], delay_of_one(self.sweeps[own], lines[0], *calibrated)
        (first, second), (calibration, other) = self.sweeps, self.calibrations
        delay = delay_on_true_clocks((first, second), (calibration, other), (lines[0], lines[1]))
        return lines[0] + self.sign * lines[1], np.asarray(delay)

    def _noisy(self, estimates: Sequence[Estimates]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return of each sweep the delay's standard deviation [s], the carrier's phase and its own [rad]."""
        independent = np.sqrt(sum(e.independent_std**2 for e in estimates))
        if len(estimates) == 1:
            (only,) = estimates
            std, carrier = only.frequency_std / abs(self.sweeps[self.topology.heard[0]].chirp_rate), only.phase
        else:
            paths = [self._path(estimates, row) for row in range(len(independent))]
            std, carrier = np.array([p.std for p in paths]), np.array([p.carrier_phase for p in paths])
        return std, carrier, independent * self.phase_per_frequency

    def _harmonics(
        self, samples: np.ndarray, frequency: np.ndarray, weights: np.ndarray, sweep: SweepSettings
    ) -> np.ndarray:
        """Return the harmonics of one station's line over the line (n, 2 H), at the line's own phase.

        Multiples of the line's phase fold back at 0 Hz and at the Nyquist frequency by themselves; NaN where one falls
        on the line, its mirror or 0 Hz.
        """
        cycles = frequency / sweep.sample_rate
        line = at_line(samples, cycles, weights)
        if not self.topology.has_mirror:  # a quadrature receiver's line may be at negative frequency
            mirror = at_line(samples.conj(), cycles, weights)
            below = np.abs(mirror) > np.abs(line)
            samples = np.where(below[:, None], samples.conj(), samples)
            line = np.where(below, mirror, line)
        found = []
        for order in SPECTRUM.harmonics:
            # cos^3 and sin^3 of I and Q hold cos(3 psi) and -sin(3 psi): a line at three times the negative frequency
            multiple = -order if self.topology.iq and order % 4 == 3 else order
            value = at_line(samples, multiple * cycles, weights)
            value = value * np.exp(-1j * multiple * np.angle(line)) / np.abs(line)
            # in cycles per sample, between -1/2 and 1/2
            at, own = ((f + 0.5) % 1.0 - 0.5 for f in (multiple * cycles, cycles))
            apart = np.min([np.abs((at - other + 0.5) % 1.0 - 0.5) for other in (own, -own, 0.0)], axis=0)
            found.append(np.where(apart * len(weights) < SPECTRUM.clear, np.nan, value))
        stacked = np.stack(found, axis=1)
        return np.concatenate([stacked.real, stacked.imag], axis=1)

    def _piled(
        self, samples: np.ndarray, frequency: np.ndarray, weights: np.ndarray, sweep: SweepSettings
    ) -> np.ndarray:
        """Return what one station's samples pile up at its outermost codes (n, 1)."""
        return adc_codes.piled(samples)[:, None]

    def _without_line(
        self, samples: np.ndarray, frequency: np.ndarray, weights: np.ndarray, sweep: SweepSettings
    ) -> np.ndarray:
        """Return the power of one station's IF without its line in spans of the sweep (n, T) [LSB^2]."""
        weights = (weights / weights.max()).astype(np.float32)
        transform = np.fft.fft if self.topology.iq else np.fft.rfft
        spectrum = transform(samples * weights, axis=1)
        bins = len(weights) // 2 + 1
        masked = near_line(bins, frequency, sweep.sample_rate / len(weights), sweep.sample_rate)
        spectrum[:, :bins][masked] = 0.0
        if self.topology.iq:
            spectrum[:, bins:][masked[:, -2:0:-1]] = 0.0
        left = np.fft.ifft(spectrum) if self.topology.iq else np.fft.irfft(spectrum, len(weights))
        clear = self._clear_spans
        return _by_span(np.abs(left) ** 2)[:, clear] / _by_span(weights**2)[clear]

    @functools.cached_property
    def _clear_spans(self) -> np.ndarray:
        """Which equal spans of the sweep every station's window leaves (T,): one may leave out an end of its sweep."""
        left = [_by_span((w / w.max()) ** 2) > SPECTRUM.span_share for w in self._weights]
        return np.asarray(np.all(left, axis=0))

    def _path(self, estimates: Sequence[Estimates], row: int) -> PathDelay:
        """Return what fusion makes of one sweep pair."""
        shares = []
        for sweep, calibration, e in zip(self.sweeps, self.calibrations, estimates, strict=True):
            beat = Beat(
                station=sweep.station,
                peer=sweep.peer,
                sweep_id=row,
                flags=0,
                frequency=float(e.frequency[row]),
                frequency_std=float(e.frequency_std[row]),
                phase=float(e.phase[row]),
                power=float(e.power[row]),
                snr=float(e.snr[row]),
                stamp=0,
                independent_std=float(e.independent_std[row]),
                window=e.window,
            )
            shares.append(Share(beat, sweep, calibration))
        first, second = shares
        return combine(first, second)


def block_lengths(count: int) -> range:
    """Return the lengths of a block to choose from for sweeps of `count` samples [samples]."""
    lengths = SPECTRUM.blocks
    times = max(1, -(-count // (lengths.start * SPECTRUM.most_blocks)))
    return range(times * lengths.start, times * (lengths.stop - 1) + 1, lengths.step)


def _by_span(values: np.ndarray) -> np.ndarray:
    """Return the means of values over the sweep (..., N) in equal spans (..., T)."""
    spans = values.shape[-1] // SPECTRUM.span
    of_spans = values[..., : spans * SPECTRUM.span].reshape(*values.shape[:-1], spans, SPECTRUM.span)
    return np.asarray(of_spans.mean(axis=-1))


def span_times(sweep: SweepSettings) -> np.ndarray:
    """Return when the spans of a sweep begin and end (V, 2) [s]: short ones where its window begins, then equal ones.

    The equal ones overlap by half and cover the window. Before it begins, the line comes in, which no window keeps out.
    """
    begin, end = sweep.analysis_window()
    step = (end - begin) / (SPECTRUM.spans + 1)
    first = [(begin, begin + count / sweep.sample_rate) for count in SPECTRUM.first_spans]
    return np.array(first + [(at, at + 2.0 * step) for at in begin + step * np.arange(SPECTRUM.spans)])


def spans(sweep: SweepSettings) -> np.ndarray:
    """Return weights of means of the samples in spans of the sweep (N, V), see `span_times`, which keep lines out.

    Each column is a span's mean less the mean of all equal spans.
    """
    windows = [
        window_samples('blackmanharris', begin, end, sweep.sample_rate, sweep.sample_count)
        for begin, end in span_times(sweep)
    ]
    each = np.stack([w / w.sum() for w in windows], axis=1)
    return each - each[:, -SPECTRUM.spans :].mean(axis=1, keepdims=True)


def _chunks(samples: tuple[np.ndarray, ...]) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield the samples of each station (n, N) some sweeps at a time."""
    for first in range(0, len(samples[0]), SPECTRUM.chunk):
        yield tuple(x[first : first + SPECTRUM.chunk] for x in samples)


def as_complex(samples: np.ndarray, iq: bool) -> np.ndarray:
    """Return floating-point samples as complex numbers where they are I/Q pairs in turn (n, N), else as they are."""
    return samples[:, ::2] + 1j * samples[:, 1::2] if iq else samples


def quiet_sweeps(quiet: np.ndarray, power: np.ndarray, usual: slice = slice(None)) -> np.ndarray:
    """Return which sweeps hold no burst (n, S), all of a station where hardly any is free.

    A strong burst at the edge of the window shows in no span, but in the spectrum.

    Args:
        quiet: power in spans without the line (n, S, T).
        power: spectra (n, S, B).
        usual: sweeps that say what there is usually.
    """
    burst = np.any(quiet > SPECTRUM.burst * np.median(quiet[usual], axis=(0, 2), keepdims=True), axis=2)
    noise = np.median(power, axis=2)
    most = 1.0 + SPECTRUM.noisier / np.sqrt(power.shape[2])
    free = ~burst & (noise < most * np.median(noise[usual], axis=0))
    return free | (free.sum(axis=0) < SPECTRUM.free_sweeps)


def ramp_spectrum(ramp: np.ndarray) -> np.ndarray:
    """Return ramp features (..., K) as orthonormal cosine series, in which their noise is uncorrelated enough."""
    return scipy.fft.dct(ramp, norm='ortho', axis=-1)
