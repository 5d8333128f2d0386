"""Phase noise of both oscillators of a pair, from the line of one station through a cable."""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy import optimize, signal

from drfmcw_node.processing.records import Sweep
from drfmcw_physics.phase_noise import PhaseNoise
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import SweepSettings

_LOWEST = 6e3  # offset from the line that the fitted phase leaves alone [Hz]
_GUARD = 40e3  # from the image of the line at 0 Hz or half the sampling rate [Hz]
_TREND = 4  # order of the polynomial taken off the phase: the line, its chirp, the chirp's own bend
_FEWEST = 50  # bins that a fit needs
_WIDENED = 1.5  # a Hann window's neighbouring bins are not independent: factor on variances


@dataclasses.dataclass(frozen=True)
class OscillatorNoise:
    """Phase noise of one of two equal oscillators."""

    level: float  # single side-band at 100 kHz [dBc/Hz]
    level_std: float  # [dB]
    corner: float  # [Hz]
    corner_std: float  # [Hz]
    sweeps: int


def oscillator_noise(settings: SweepSettings, sweeps: Sequence[Sweep]) -> OscillatorNoise:
    """Return the phase noise of each oscillator of a pair, both taken as equal.

    The phase of the line holds the sum of both: over a short path neither cancels, since the chirps start T_off apart.
    Its density is fitted by maximum likelihood (Whittle) as one pole over a constant, which is the additive noise.

    Args:
        settings: of the station that hears.
        sweeps: of that station.

    Raises:
        ConfigurationError: the line is too near to 0 Hz or half the sampling rate.
    """
    frequency = _line(np.asarray(sweeps[0].samples, float), sweeps[0].iq, settings.sample_rate)
    highest = min(frequency, settings.sample_rate / 2 - frequency) - _GUARD
    start, end = (round(t * settings.sample_rate) for t in settings.analysis_window())
    count = end - start
    step = settings.sample_rate / count
    bins = np.arange(math.ceil(_LOWEST / step), math.floor(highest / step))
    if len(bins) < _FEWEST:
        raise ConfigurationError(f'the line at {frequency * 1e-3:.0f} kHz leaves no room to see phase noise beside it')
    window = signal.windows.hann(count, sym=False)
    power = np.zeros(count)
    for sweep in sweeps:
        residual = _phase(np.asarray(sweep.samples, float), sweep.iq)[start:end]
        time = np.linspace(-1.0, 1.0, count)
        residual = residual - np.polynomial.Legendre.fit(time, residual, _TREND)(time)
        power += np.abs(np.fft.fft(window * residual)) ** 2
    density = 2.0 * power[bins] / (len(sweeps) * settings.sample_rate * np.sum(window**2))  # one-sided [rad^2/Hz]
    offset = bins * step

    def model(p: np.ndarray) -> np.ndarray:
        return 2.0 * PhaseNoise(p[0], 10.0 ** p[1]).phase_density(offset) + 10.0 ** (p[2] / 10.0)

    def misfit(p: np.ndarray) -> float:
        expected = model(p)
        return float(len(sweeps) * np.sum(np.log(expected) + density / expected))

    floor = 10.0 * math.log10(float(np.median(density[-len(density) // 4 :])))
    begins = [np.array([level, corner, floor]) for level in (-110.0, -95.0, -80.0) for corner in (4.5, 5.3)]
    bounds = [(-160.0, -50.0), (3.8, 6.0), (floor - 40.0, floor + 10.0)]
    best = min(
        (optimize.minimize(misfit, begin, method='L-BFGS-B', bounds=bounds) for begin in begins), key=lambda r: r.fun
    ).x
    slopes = np.stack([_slope(model, best, i) for i in range(len(best))])
    weight = len(sweeps) / _WIDENED / model(best) ** 2
    covariance = np.linalg.pinv(np.einsum('ik,jk,k->ij', slopes, slopes, weight))
    corner = float(10.0 ** best[1])
    return OscillatorNoise(
        level=float(best[0]),
        level_std=math.sqrt(covariance[0, 0]),
        corner=corner,
        corner_std=corner * math.log(10.0) * math.sqrt(covariance[1, 1]),
        sweeps=len(sweeps),
    )


def _line(samples: np.ndarray, iq: bool, rate: float) -> float:
    """Return the frequency of the strongest line within a bin [Hz]."""
    values = samples[0::2] + 1j * samples[1::2] if iq else samples
    power = np.abs(np.fft.fft(values * signal.windows.hann(len(values))))[: len(values) // 2]
    return float(np.argmax(power)) * rate / len(values)


def _phase(samples: np.ndarray, iq: bool) -> np.ndarray:
    """Return the unwrapped phase of one line (n,) [rad]."""
    analytic = samples[0::2] + 1j * samples[1::2] if iq else signal.hilbert(samples)
    return np.unwrap(np.angle(analytic))


def _slope(model: Callable[[np.ndarray], np.ndarray], at: np.ndarray, index: int) -> np.ndarray:
    step = np.zeros(len(at))
    step[index] = 1e-3
    return (model(at + step) - model(at - step)) / 2e-3
