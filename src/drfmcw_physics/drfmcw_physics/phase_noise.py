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


@functools.lru_cache(maxsize=64)
def _covariance(noise: PhaseNoise, sample_rate: float) -> np.ndarray:
    """Return what `covariance` does without a delay; read-only."""
    found = covariance(noise, sample_rate)
    found.setflags(write=False)
    return found


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

    The mean of a stretch takes the covariance's mean over all pairs of times: what is slower turns the stretch as a
    whole.

    Args:
        noise: of the oscillator.
        count: samples of the stretch.
        sample_rate: [Hz].
        delay: after which the oscillator is mixed with itself (...) [s], None for another, noise-free one.
    """
    if delay is None:
        found = _covariance(noise, sample_rate)
    else:
        delay = np.asarray(delay, dtype=float)
        found = 2.0 * covariance(noise, sample_rate)
        found = found - covariance(noise, sample_rate, delay) - covariance(noise, sample_rate, -delay)
    lag = np.arange(count)
    pairs = np.where(lag > 0, 2.0, 1.0) * (1.0 - lag / count) / count
    return found[..., 0] - found[..., :count] @ pairs
