"""What is measured on the sweeps for the page: spectra, the line, its frequency over ramp time, power."""

import dataclasses

import numpy as np

from drfmcw_physics.sweep import SweepSettings

from ..convert.spectra import local_maxima
from ..formats.base import Numbers
from .sweeps import StationSweeps

_RUN = 64  # sweeps of one line position taken together at most
_PADDED = 4  # bins per resolution cell
_FRAMES = 240  # columns of a spectrogram at most


@dataclasses.dataclass(frozen=True)
class Spectrum:
    """An averaged spectrum."""

    frequency: Numbers  # (m,) increasing [Hz]
    run: Numbers  # (m,) mean over the run of sweeps whose line stands still [dBFS]
    all: Numbers  # (m,) mean over all sweeps [dBFS]
    line: float  # frequency of the strongest line of the run, 0 Hz left out [Hz]; 0: there is none
    level: float  # of that line [dBFS]
    floor: float  # median of the run's spectrum [dBFS]

    @property
    def has_line(self) -> bool:
        """False for samples that never change."""
        return self.line != 0.0


@dataclasses.dataclass(frozen=True)
class Mark:
    """A frequency with a name."""

    name: str
    frequency: float  # [Hz]


@dataclasses.dataclass(frozen=True)
class RampCourse:
    """The beat frequency over ramp time."""

    time: Numbers  # (m,) since the sweep's start [s]
    frequency: Numbers  # (m,) mean over the run [Hz]
    scatter: Numbers  # (m,) standard deviation from sweep to sweep, NaN for fewer than four sweeps [Hz]
    straight: float  # what a straight ramp predicts: the same all along [Hz]
    width: float  # of the filter [s]


def decibels(power: Numbers) -> Numbers:
    """Return 10 lg of powers, floored where there is nothing."""
    return np.asarray(10.0 * np.log10(np.maximum(power, 1e-30)))


def _window(count: int) -> Numbers:
    return np.hanning(count + 2)[1:-1]


def _power_spectra(signal: Numbers, padded: int) -> Numbers:
    """Return power spectra of (n, N) sweeps, a sine at full scale being 1, frequencies increasing."""
    window = _window(signal.shape[1])
    flat = (signal - signal.mean(axis=1, keepdims=True)) * window / window.sum()
    if np.iscomplexobj(signal):
        return np.asarray(np.abs(np.fft.fftshift(np.fft.fft(flat, padded), axes=1)) ** 2)
    power = np.abs(np.fft.rfft(flat, padded)) ** 2
    power[:, 1:] *= 4.0
    return np.asarray(power)


def _frequencies(padded: int, rate: float, iq: bool) -> Numbers:
    if iq:
        return np.asarray(np.fft.fftshift(np.fft.fftfreq(padded, 1.0 / rate)))
    return np.asarray(np.fft.rfftfreq(padded, 1.0 / rate))


def still_run(data: StationSweeps) -> slice:
    """Return the longest run of consecutive sweeps, 64 at most, in which the strongest line keeps its position."""
    signal = data.signal
    count = signal.shape[1]
    power = _power_spectra(signal, count)
    frequency = _frequencies(count, 1.0, data.iq)
    peaks = np.where(np.abs(frequency) * count < 2.5, 0.0, local_maxima(power))
    peak = np.argmax(peaks, axis=1)
    best = slice(0, 1)
    start = 0
    for i in range(1, len(peak) + 1):
        if i == len(peak) or abs(int(peak[i]) - int(peak[start])) > 1 or i - start >= _RUN:
            if i - start > best.stop - best.start:
                best = slice(start, i)
            start = i
    return best


def averaged(data: StationSweeps, run: slice) -> Spectrum:
    """Return the averaged spectrum and its line."""
    signal, rate = data.signal, data.sweep.sample_rate
    count = signal.shape[1]
    padded = _PADDED * count
    frequency = _frequencies(padded, rate, data.iq)
    mine = np.mean(_power_spectra(signal[run], padded), axis=0)
    step = max(1, len(signal) * padded // (1 << 24))
    everything = np.mean(_power_spectra(signal[::step], padded), axis=0)
    away = np.where(np.abs(frequency) < 2.5 * rate / count, 0.0, local_maxima(mine))
    at = int(np.argmax(away))
    line = float(frequency[at])
    if 0 < at < len(mine) - 1:
        left, middle, right = np.log(np.maximum(mine[at - 1 : at + 2], 1e-300))
        bend = left - 2.0 * middle + right
        line += float(0.5 * (left - right) / bend * (frequency[1] - frequency[0])) if bend < 0.0 else 0.0
    run_level = decibels(mine)
    return Spectrum(frequency, run_level, decibels(everything), line, float(run_level[at]), float(np.median(run_level)))


def fold(frequency: float, rate: float, iq: bool) -> float:
    """Return where a frequency shows after sampling [Hz]."""
    folded = (frequency + rate / 2) % rate - rate / 2
    return folded if iq else abs(folded)


def marks(spectrum: Spectrum, sweep: SweepSettings, iq: bool) -> list[Mark]:
    """Return what stands where: 0 Hz, Nyquist, line, image (I/Q only), second and third harmonic, folded."""
    rate = sweep.sample_rate
    found = [Mark('0 Hz', 0.0), Mark('Nyquist', rate / 2)]
    if iq:
        found.append(Mark('Nyquist', -rate / 2))
    if not spectrum.has_line:
        return found
    found.append(Mark('line', spectrum.line))
    if iq:
        found.append(Mark('image', -spectrum.line))
    for order in (2, 3):
        found.append(Mark(f'{order}×', fold(order * spectrum.line, rate, iq)))
    return found


def spectrogram(data: StationSweeps, run: slice, longest: float = 0.0) -> tuple[Numbers, Numbers, Numbers]:
    """Return (times [s], frequencies [Hz], level [dBFS]) of the mean short-time spectrum of the run.

    Args:
        data: the sweeps.
        run: which of them.
        longest: window to use where it is longer than three times the root of the sweep's samples [s].
    """
    signal = data.signal[run]
    signal = signal - signal.mean(axis=1, keepdims=True)
    count, rate = signal.shape[1], data.sweep.sample_rate
    length = int(min(max(16, 2 ** round(np.log2(3.0 * np.sqrt(count))), longest * rate), count // 4))
    hop = max(1, (count - length) // _FRAMES)
    starts = np.arange(0, count - length + 1, hop)
    padded = max(128, 2 * length)
    window = _window(length)
    power: Numbers = np.zeros(1)
    for row in signal:
        pieces = np.lib.stride_tricks.sliding_window_view(row, length)[starts] * (window / window.sum())
        bins = np.fft.fftshift(np.fft.fft(pieces, padded), axes=1) if data.iq else 2.0 * np.fft.rfft(pieces, padded)
        power = power + np.abs(bins) ** 2
    return (starts + (length - 1) / 2) / rate, _frequencies(padded, rate, data.iq), decibels(power / len(signal)).T


def ramp_course(data: StationSweeps, run: slice, line: float) -> RampCourse | None:
    """Return the beat frequency over ramp time, None where the line has too few turns.

    Samples are mixed down by the line, filtered by a Hann window of four turns (two of an I/Q line) or a twelfth of the
    sweep, whichever is longer; the advance of phase, summed over the sweeps of the run, is the frequency.
    """
    signal, rate = data.signal[run], data.sweep.sample_rate
    signal = signal - signal.mean(axis=1, keepdims=True)
    count = signal.shape[1]
    turns = abs(line) * count / rate
    if turns < 4.0:
        return None
    length = int(min(max(count / 12, (2.0 if data.iq else 4.0) * count / turns, 6), count / 3))
    instants = np.arange(count)
    mixed = signal * np.exp(-2j * np.pi * line / rate * instants)
    window = _window(length) / _window(length).sum()
    smooth = np.stack([np.convolve(row, window, 'valid') for row in mixed])
    lag = max(1, length // 4)
    advance = smooth[:, lag:] * np.conj(smooth[:, :-lag])
    mean = np.angle(advance.sum(axis=0)) / (2.0 * np.pi * lag) * rate
    each = np.angle(advance * np.exp(-1j * np.angle(advance.sum(axis=0)))) / (2.0 * np.pi * lag) * rate
    scatter = each.std(axis=0) if len(signal) >= 4 else np.full(mean.shape, np.nan)
    time = (np.arange(len(mean)) + (length - 1) / 2 + lag / 2) / rate
    return RampCourse(time, line + mean, scatter, line, length / rate)


def sweep_powers(data: StationSweeps) -> tuple[Numbers, Numbers]:
    """Return (total, strongest line) of each sweep, its mean removed, (n,) [dBFS]; a sine at full scale has 0."""
    signal = data.signal
    signal = signal - signal.mean(axis=1, keepdims=True)
    total = decibels(np.mean(np.abs(signal) ** 2, axis=1) * (1.0 if data.iq else 2.0))
    spectra = _power_spectra(signal, signal.shape[1])
    near = np.abs(_frequencies(signal.shape[1], 1.0, data.iq)) * signal.shape[1] < 2.5
    return total, decibels(np.where(near, 0.0, local_maxima(spectra)).max(axis=1))
