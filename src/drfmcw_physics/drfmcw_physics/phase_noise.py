"""Phase noise of a PLL synthesiser: one-pole shape, flat inside the loop, -20 dB per decade above its corner."""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.fft

from .quantities import Quantity

LEVEL_OFFSET = 100e3
"""Offset at which StationCalibration states the level [Hz]."""

_COUNT = 2**14  # samples of a covariance; more than the memory of the slowest oscillator of interest
_MOST = 200.0  # variance [rad^2] beyond which a line counts as gone


@dataclasses.dataclass(frozen=True)
class PhaseNoise:
    """One oscillator's phase noise."""

    level: float  # single side-band at 100 kHz offset [dBc/Hz]
    corner: float  # [Hz]

    @property
    def known(self) -> bool:
        """False where level or corner is not characterised (NaN)."""
        return math.isfinite(self.level) and math.isfinite(self.corner)

    @property
    def plateau(self) -> float:
        """Single side-band density inside the loop, L(0) [1/Hz]."""
        return 10.0 ** (self.level / 10.0) * (1.0 + (LEVEL_OFFSET / self.corner) ** 2)

    def single_sideband(self, offset: Quantity) -> Any:
        """Return L(offset) [1/Hz], offset in Hz (IEEE Std 1139)."""
        return self.plateau / (1.0 + (np.asarray(offset) / self.corner) ** 2)

    def phase_density(self, offset: Quantity) -> Any:
        """Return the one-sided phase density S_phi = 2 L [rad^2/Hz] (IEEE Std 1139)."""
        return 2.0 * self.single_sideband(offset)


def covariance(noise: PhaseNoise, sample_rate: float, delay: Quantity = 0.0, count: int = _COUNT) -> np.ndarray:
    """Return the covariance of a sampled phase at lags of whole samples and a delay [rad^2].

    Its noise ends at the Nyquist frequency, as behind an anti-aliasing filter.

    Args:
        noise: of the oscillator.
        sample_rate: [Hz].
        delay: added to the lags (...) [s].
        count: of lags L, from 0; negative ones follow, as in a discrete Fourier transform.

    Returns:
        An array (..., L).
    """
    frequency = scipy.fft.rfftfreq(count, 1.0 / sample_rate)
    turns = frequency * np.asarray(delay, dtype=float)[..., None]
    found: np.ndarray = scipy.fft.irfft(noise.single_sideband(frequency) * np.exp(2j * np.pi * turns), count)
    return found * sample_rate


def around_line(oscillators: Sequence[PhaseNoise], offset: Quantity, sample_rate: float) -> Any:
    """Return the density around a sampled line whose phase has the noise of all, over the power it keeps [1/Hz].

    Args:
        oscillators: of the line, independent of each other.
        offset: from the line (...) [Hz].
        sample_rate: [Hz].
    """
    density = sum(components_around_line(oscillators, sample_rate, _COUNT))
    folded = np.abs(offset - sample_rate * np.rint(np.asarray(offset) / sample_rate))
    return np.interp(folded, scipy.fft.rfftfreq(_COUNT, 1.0 / sample_rate), density)


def components_around_line(
    oscillators: Sequence[PhaseNoise], sample_rate: float, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the densities of a sampled line's quadrature and in-phase components, over the power that stays in it.

    With the covariance C of the phase phi, those of sin phi and cos phi are exp(-C(0)) sinh C and
    exp(-C(0)) (cosh C - 1), and the line has the power exp(-C(0)).

    Args:
        oscillators: of the line, independent of each other; none for no noise.
        sample_rate: [Hz].
        count: number of samples N.

    Returns:
        Two arrays (N // 2 + 1,) [1/Hz] at multiples of sample_rate / N.
    """
    return _components(tuple(oscillators), sample_rate, count)


@functools.lru_cache(maxsize=64)
def _components(oscillators: tuple[PhaseNoise, ...], sample_rate: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what `components_around_line` does; read-only."""
    together = sum((covariance(o, sample_rate, count=count) for o in oscillators), np.zeros(count))
    quadrature, in_phase = (density.real for density in _densities(together, sample_rate))
    quadrature.setflags(write=False)
    in_phase.setflags(write=False)
    return quadrature, in_phase


def components_between_lines(
    one: PhaseNoise, two: PhaseNoise, delay: Quantity, sample_rate: float, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the cross densities of two stations' quadrature and in-phase components, see `components_around_line`.

    Each line has the phase of its own oscillator less that of the other one `delay` ago; both stations at once.

    Args:
        one: oscillator of the first station.
        two: of the second station.
        delay: of the path (...) [s].
        sample_rate: [Hz].
        count: number of samples N.

    Returns:
        Two complex arrays (..., N // 2 + 1) [1/Hz] at multiples of sample_rate / N.
    """
    delay = np.asarray(delay, dtype=float)
    ahead, behind = covariance(one, sample_rate, delay, count), covariance(two, sample_rate, -delay, count)
    return _densities(-(ahead + behind), sample_rate)


def _densities(covariance: np.ndarray, sample_rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the spectra of sinh and cosh - 1 of a covariance (..., N) [1/Hz]."""
    limited = np.clip(covariance, -_MOST, _MOST)
    odd, even = np.sinh(limited), np.cosh(limited) - 1.0
    return scipy.fft.rfft(odd, axis=-1) / sample_rate, scipy.fft.rfft(even, axis=-1) / sample_rate


def combination_gain(frequency: Quantity, delay: Quantity) -> Any:
    """Return 4 sin^2(pi f tau): power gain of an oscillator's phase noise through the combination of both stations.

    Args:
        frequency: offset frequency [Hz].
        delay: of the path [s].
    """
    return 4.0 * np.sin(np.pi * np.asarray(frequency) * delay) ** 2


def coherent_loss(variance: Quantity) -> Any:
    """Return by how much phase noise lowers the power of a line [dB]: |E exp(i phi)|^2 = exp(-variance).

    Args:
        variance: of the line's phase, of normal distribution [rad^2].
    """
    return 10.0 / math.log(10.0) * np.asarray(variance)


def variance_within(noise: PhaseNoise, count: int, sample_rate: float, delay: Quantity | None = None) -> Any:
    """Return the variance of a sampled phase within a stretch of time, about its mean there [rad^2].

    The mean of a stretch follows what is slower, which turns the stretch as a whole.

    Args:
        noise: of the oscillator.
        count: samples of the stretch.
        sample_rate: [Hz].
        delay: after which the oscillator is mixed with itself (...) [s], None for another, noise-free one.
    """
    frequency, left = _beside_mean(noise, count, sample_rate)
    if delay is None:
        return np.sum(left)
    return combination_gain(frequency, np.asarray(delay, dtype=float)[..., None]) @ left


@functools.lru_cache(maxsize=64)
def _beside_mean(noise: PhaseNoise, count: int, sample_rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies [Hz] and what each adds to the variance of a phase about the mean of a stretch [rad^2].

    Args:
        noise: of the oscillator.
        count: samples of the stretch.
        sample_rate: [Hz].
    """
    frequency = scipy.fft.rfftfreq(_COUNT, 1.0 / sample_rate)
    turns = frequency / sample_rate
    followed = (np.sinc(count * turns) / np.sinc(turns)) ** 2
    left = noise.phase_density(frequency) * (1.0 - followed) * (sample_rate / _COUNT)
    left[-1] /= 2.0  # the Nyquist frequency has no negative of its own
    frequency.setflags(write=False)
    left.setflags(write=False)
    return frequency, left
