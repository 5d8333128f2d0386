"""Phase noise of a PLL synthesiser: one-pole shape, flat inside the loop, -20 dB per decade above its corner."""

import dataclasses
import math
from typing import Any

import numpy as np

from .quantities import Quantity

LEVEL_OFFSET = 100e3
"""Offset at which StationCalibration states the level [Hz]."""


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
