"""Received power and noise of the one-way link (Friis)."""

from typing import Any

import numpy as np

from .constants import BOLTZMANN, SPEED_OF_LIGHT, STANDARD_NOISE_TEMPERATURE
from .quantities import Quantity


def free_space_loss(distance: Quantity, frequency: Quantity) -> Any:
    """Return the one-way free-space basic transmission loss 20 log10(4 pi d f / c) [dB] (ITU-R P.525).

    Args:
        distance: antenna distance [m].
        frequency: [Hz].
    """
    return 20.0 * np.log10(4.0 * np.pi * distance * frequency / SPEED_OF_LIGHT)


def received_power(tx_eirp: Quantity, rx_antenna_gain: Quantity, distance: Quantity, frequency: Quantity) -> Any:
    """Return the power at the receive antenna port [dBm]; EIRP in dBm, gain in dBi, distance in m, frequency in Hz."""
    return tx_eirp + rx_antenna_gain - free_space_loss(distance, frequency)


def noise_density(noise_figure: Quantity) -> Any:
    """Return the thermal noise density referred to the antenna port, k T_0 F [dBm/Hz], of a noise figure [dB]."""
    return 10.0 * np.log10(BOLTZMANN * STANDARD_NOISE_TEMPERATURE * 1e3) + noise_figure
