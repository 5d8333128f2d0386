"""What the bench compares with: the same jobs in plain NumPy and SciPy, and in scikit-radar for the part it can do.

Written straight from the textbook, with nothing of drfmcw in it, so that they are independent in result as well as
in speed. Estimators take int16 samples of a real IF [sweeps, samples] and the sample rate [Hz].
"""

import importlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
from scipy import fft, signal

_ZOOM = 64  # points of the fine spectrum
_SPAN = 2.0  # its width, bins
_SKIP = 4  # bins at either end in which no line is looked for
_SEGMENT = 16  # samples averaged before the phase is taken
_PINS = Path(__file__).parents[1] / 'setup' / 'bench.txt'


def two_station_if(
    trials: int,
    seed: int,
    delay: float = 700e-9,
    start_delay: float = 3.41e-6,
    alphas: tuple[float, float] = (1.0, 1.0),
    line_amplitude: float = 82.0,
    noise_std: float = 8.0,
    phase_noise_level: float = -90.0,
    phase_noise_corner: float = 200e3,
    start_delay_jitter: float = 0.0,
    sample_count: int = 2048,
    sample_rate: float = 2.048e6,
    start_frequency: float = 5.725e9,
    chirp_rate: float = 150e9,
) -> tuple[np.ndarray, np.ndarray]:
    """Return both stations' IF samples, int16 [trials, samples] each: eqs. 14-17, phase noise and noise, float64.

    Args:
        trials: number of measurements, each with a start delay and phases of its own.
        seed: of the random numbers.
        delay: of the path [s].
        start_delay: T_off [s].
        alphas: reference frequencies / nominal; each station's ADC shares its reference.
        line_amplitude: of both lines [LSB].
        noise_std: of the additive noise [LSB].
        phase_noise_level: single side-band at 100 kHz [dBc/Hz], one-pole shape.
        phase_noise_corner: its corner [Hz].
        start_delay_jitter: standard deviation of T_off from trial to trial [s].
        sample_count: per sweep.
        sample_rate: [Hz].
        start_frequency: f_0 [Hz].
        chirp_rate: k [Hz/s].
    """
    generator = np.random.default_rng(seed)
    period = sample_count + sample_count // 16
    frequency = np.fft.rfftfreq(period, 1.0 / sample_rate)
    plateau = 10.0 ** (phase_noise_level / 10.0) * (1.0 + (100e3 / phase_noise_corner) ** 2)
    density = 2.0 * plateau / (1.0 + (frequency / phase_noise_corner) ** 2)
    scale = np.sqrt(density * period * sample_rate / 4.0)
    spectra = [
        scale * (generator.standard_normal((trials, len(scale))) + 1j * generator.standard_normal((trials, len(scale))))
        for _ in alphas
    ]
    phi = 2.0 * np.pi * generator.random((2, trials, 1))
    between = start_delay + start_delay_jitter * generator.standard_normal((trials, 1))
    results = []
    for own, peer, later in ((0, 1, between), (1, 0, -between)):
        u = np.arange(sample_count) / (sample_rate * alphas[own])
        d = later + delay
        v = u - d
        clean = alphas[own] * start_frequency * u + 0.5 * alphas[own] ** 2 * chirp_rate * u**2
        clean = clean - (alphas[peer] * start_frequency * v + 0.5 * alphas[peer] ** 2 * chirp_rate * v**2)
        heard = spectra[peer] * np.exp(-2j * np.pi * frequency * d)
        noise = np.fft.irfft(spectra[own], period)[:, :sample_count] - np.fft.irfft(heard, period)[:, :sample_count]
        phase = 2.0 * np.pi * clean + phi[own] - phi[peer] + noise
        samples = line_amplitude * np.cos(phase) + noise_std * generator.standard_normal((trials, sample_count))
        results.append(np.rint(samples).astype(np.int16))
    return results[0], results[1]


def _vertex(left: np.ndarray, middle: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return where the parabola through three equidistant values has its maximum, from the middle one."""
    return 0.5 * (left - right) / (left - 2.0 * middle + right)


def frequency_by_zoom_fft(samples: np.ndarray, sample_rate: float) -> np.ndarray:
    """Return each sweep's line frequency [Hz]: Hann, FFT, scipy.signal.zoom_fft and parabola, sweep by sweep."""
    count = samples.shape[1]
    window = signal.windows.hann(count, sym=False)
    bin_width = sample_rate / count
    result = np.empty(len(samples))
    for row, sweep in enumerate(samples):
        windowed = sweep * window
        coarse = np.argmax(np.abs(fft.rfft(windowed))[_SKIP:-_SKIP]) + _SKIP
        low = (coarse - _SPAN / 2.0) * bin_width
        step = _SPAN * bin_width / _ZOOM
        fine = signal.zoom_fft(windowed, [low, low + _ZOOM * step], _ZOOM, fs=sample_rate)
        level = np.log(np.abs(fine))
        peak = int(np.clip(np.argmax(level), 1, _ZOOM - 2))
        result[row] = low + step * (peak + _vertex(*level[peak - 1 : peak + 2]))
    return result


def frequency_by_matrix(samples: np.ndarray, sample_rate: float) -> np.ndarray:
    """Return each sweep's line frequency [Hz]: Hann, one FFT of the batch, the fine spectrum as matrix product."""
    count = samples.shape[1]
    bin_width = sample_rate / count
    sample = np.arange(count)
    windowed = samples * signal.windows.hann(count, sym=False).astype(np.float32)
    coarse = np.argmax(np.abs(fft.rfft(windowed))[:, _SKIP:-_SKIP], axis=1) + _SKIP
    bins = np.arange(_ZOOM) * (_SPAN / _ZOOM) - _SPAN / 2.0
    zoom = np.exp(-2j * np.pi / count * np.outer(sample, bins)).astype(np.complex64)
    roots = np.exp(-2j * np.pi / count * sample).astype(np.complex64)
    fine = (windowed * roots[np.outer(coarse, sample) % count]) @ zoom
    level = np.log(np.abs(fine))
    peak = np.clip(np.argmax(level, axis=1), 1, _ZOOM - 2)
    rows = np.arange(len(samples))
    vertex = _vertex(level[rows, peak - 1], level[rows, peak], level[rows, peak + 1])
    return (coarse - _SPAN / 2.0 + (peak + vertex) * (_SPAN / _ZOOM)) * bin_width


def beat_sum_by_product(first: np.ndarray, second: np.ndarray, sample_rate: float, sign: int = 1) -> np.ndarray:
    """Return f_1 + sign f_2 of each pair [Hz]: product of both analytic IF signals, straight line through its phase.

    Samples of the same number are multiplied, which are T_off apart in time.

    Args:
        first: samples of station 1, int16 [pairs, samples].
        second: of station 2.
        sample_rate: [Hz].
        sign: 1 long distance, -1 short distance.
    """
    count = first.shape[1]
    product = signal.hilbert(first.astype(np.float32))
    other = signal.hilbert(second.astype(np.float32))
    product = product * (other if sign > 0 else np.conj(other))
    window = signal.windows.hann(count, sym=False).astype(np.float32)
    coarse = np.argmax(np.abs(fft.fft(product * window)), axis=1)
    roots = np.exp(-2j * np.pi / count * np.arange(count)).astype(np.complex64)
    product = product * roots[np.outer(coarse, np.arange(count)) % count]
    segments = product[:, : count - count % _SEGMENT].reshape(len(first), -1, _SEGMENT).mean(axis=2)
    phase = np.unwrap(np.angle(segments), axis=1)
    time = (np.arange(phase.shape[1]) - 0.5 * (phase.shape[1] - 1)) * (_SEGMENT / sample_rate)
    slope = phase @ time / np.sum(time**2)
    return np.where(coarse > count // 2, coarse - count, coarse) * (sample_rate / count) + slope / (2.0 * np.pi)


def bare_rfft(samples: np.ndarray) -> np.ndarray:
    """Return the spectra of a batch of sweeps, float32 and no window: what no estimator that needs one can beat."""
    return fft.rfft(samples.astype(np.float32))


def scikit_radar() -> ModuleType:
    """Return the package skradar, installed on first use into a folder of its own inside .venv.

    Raises:
        ImportError: it cannot be installed or imported; the message is one line.
    """
    folder = Path(sys.prefix) / 'bench'
    pins = _PINS.read_text(encoding='utf-8')
    stamp = folder / 'installed.txt'
    if not stamp.exists() or stamp.read_text(encoding='utf-8') != pins:
        _install(folder, pins, stamp.name)
    os.environ.setdefault('MPLBACKEND', 'Agg')  # it switches matplotlib to interactive
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    return importlib.import_module('skradar')


def _install(folder: Path, pins: str, stamp: str) -> None:
    with tempfile.TemporaryDirectory(prefix='.bench-', dir=folder.parent) as temporary:
        target = Path(temporary) / 'bench'
        options = ('--quiet', '--no-deps', '--no-input', '--disable-pip-version-check', '--only-binary', ':all:')
        command = [sys.executable, '-m', 'pip', 'install', *options, '--target', str(target), '-r', str(_PINS)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            reason = (done.stderr.strip().splitlines() or ['pip failed'])[-1]
            raise ImportError(f'scikit-radar cannot be installed: {reason}')
        (target / stamp).write_text(pins, encoding='utf-8')
        shutil.rmtree(folder, ignore_errors=True)
        target.rename(folder)


def scikit_radar_if(trials: int, sample_count: int = 2048, sample_rate: float = 2.048e6) -> np.ndarray:
    """Return tones in noise by scikit-radar [trials, samples]: one station, no phase noise, not digitised.

    Raises:
        ImportError: as `scikit_radar`.
    """
    skradar = scikit_radar()
    result = np.empty((trials, sample_count))
    for row in range(trials):
        tone = skradar.sim_FMCW_if(400.0, 150e6, 5.8e9, sample_count, 1.0 / sample_rate)
        result[row] = tone + skradar.AWGN(sample_count, sample_rate)
    return result


def frequency_by_scikit_radar(samples: np.ndarray, sample_rate: float) -> np.ndarray:
    """Return each sweep's line frequency [Hz] from scikit-radar's range profile, padded 8 times, and a parabola.

    Raises:
        ImportError: as `scikit_radar`.
    """
    skradar = scikit_radar()
    count = samples.shape[1]
    window = signal.windows.hann(count, sym=False)
    result = np.empty(len(samples))
    for row, sweep in enumerate(samples):
        profile, _ = skradar.range_compress_FMCW(sweep, window, 150e6, 8, flatten_phase=False)
        padded = len(profile)
        level = np.abs(profile[: padded // 2])
        skip = _SKIP * padded // count
        peak = int(np.argmax(level[skip:-skip])) + skip
        result[row] = (peak + _vertex(*np.log(level[peak - 1 : peak + 2]))) * (sample_rate / padded)
    return result


FREQUENCY: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    'FFT + zoom_fft + parabola': frequency_by_zoom_fft,
    'rfft + 64-point zoom as matrix': frequency_by_matrix,
    'scikit-radar': frequency_by_scikit_radar,
}
"""Estimators of one station's frequency, by name."""
