"""Phase noise of a PLL synthesiser: one-pole shape, flat inside the loop, -20 dB per decade above its corner."""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from .quantities import Quantity

LEVEL_OFFSET = 100e3
"""Offset at which StationCalibration states the level [Hz]."""

_LAGS = 512  # at which a covariance is averaged
_ORDERS = 10  # of phase noise in a line's skirts; the next one is below 1e-5 up to a variance of 2 rad^2
_LEAST = 1e-6  # power of an order over that of the first one [1], below which it is left out


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

    @property
    def variance(self) -> float:
        """Return the variance of the phase, the integral of `phase_density` over all offsets [rad^2]."""
        return math.pi * self.corner * self.plateau

    def single_sideband(self, offset: Quantity) -> Any:
        """Return L(offset) [1/Hz], offset in Hz (IEEE Std 1139)."""
        return self.plateau / (1.0 + (np.asarray(offset) / self.corner) ** 2)

    def phase_density(self, offset: Quantity) -> Any:
        """Return the one-sided phase density S_phi = 2 L [rad^2/Hz] (IEEE Std 1139)."""
        return 2.0 * self.single_sideband(offset)


def around_line(oscillators: Sequence[PhaseNoise], offset: Quantity) -> Any:
    """Return the density around a line whose phase has the noise of all, over the power that stays in the line [1/Hz].

    exp(i phi) has the spectrum exp(-variance) sum S^n / n!, where S^n is the density of the phase convolved n times
    with itself (the line is n = 0). One-pole shapes convolve to one-pole shapes: variances multiply, corners add.

    Args:
        oscillators: of the line, independent of each other.
        offset: from the line (...) [Hz].
    """
    offset = np.asarray(offset, dtype=float)
    found = np.zeros(offset.shape)
    least = _LEAST * sum(o.variance for o in oscillators)
    for orders in itertools.product(range(_ORDERS + 1), repeat=len(oscillators)):
        if 0 < sum(orders) <= _ORDERS:
            pairs = list(zip(oscillators, orders, strict=True))
            power = math.prod(o.variance**n / math.factorial(n) for o, n in pairs)
            if power < least:
                continue
            corner = sum(o.corner * n for o, n in pairs)
            found += power / (math.pi * corner * (1.0 + (offset / corner) ** 2))
    return found


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


def variance_after_delay(noise: PhaseNoise, delay: Quantity) -> Any:
    """Return the variance of the phase of an oscillator mixed with itself a delay [s] later [rad^2].

    The integral of `PhaseNoise.phase_density` times `combination_gain` over all offsets.
    """
    return -2.0 * noise.variance * np.expm1(-2.0 * math.pi * noise.corner * np.asarray(delay))


def variance_within(noise: PhaseNoise, length: float, delay: Quantity | None = None) -> Any:
    """Return the variance of the phase within a stretch of time, about its mean there [rad^2].

    The covariance of the one-pole shape is `variance` exp(-2 pi corner s). The mean of a stretch takes its mean over
    all pairs of times: what is slower turns the stretch as a whole.

    Args:
        noise: of the oscillator.
        length: of the stretch [s].
        delay: after which the oscillator is mixed with itself (...) [s], None for another, noise-free one.
    """
    lag = (np.arange(_LAGS) + 0.5) / _LAGS * length
    pairs = 2.0 * (1.0 - lag / length) / _LAGS

    def covariance(lags: np.ndarray) -> Any:
        return noise.variance * np.exp(-2.0 * math.pi * noise.corner * np.abs(lags))

    if delay is None:
        return noise.variance - covariance(lag) @ pairs
    later = np.asarray(delay)[..., None]
    mixed = 2.0 * covariance(lag) - covariance(lag - later) - covariance(lag + later)
    return variance_after_delay(noise, delay) - mixed @ pairs
