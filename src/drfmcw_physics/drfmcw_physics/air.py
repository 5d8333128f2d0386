"""Refractive index of air at microwave frequencies.

The default is ITU-R P.453-14. The paper's eq. 23 is kept as printed, to show what it does: its wet coefficient 0.373
belongs to hPa while the pressures are in kPa, so humid air comes out up to 60 ppm short (docs/paper_errata.md).
"""

from typing import Any

import numpy as np

from .constants import ZERO_CELSIUS
from .quantities import Quantity

MODELS = ('itu_r_p453', 'paper_eq23_as_printed', 'paper_eq23_corrected')
"""Names of the selectable models of the refractive index."""


def saturation_vapour_pressure(temperature: Quantity, pressure: Quantity) -> Any:
    """Return the saturation water-vapour pressure over water [hPa], ITU-R P.453-14 eqs. 9 and 10.

    Args:
        temperature: air temperature [degC], -40 ... 50.
        pressure: total atmospheric pressure [Pa].
    """
    t, p = temperature, pressure / 100.0
    enhancement = 1.0 + 1e-4 * (7.2 + p * (0.0320 + 5.9e-6 * t * t))
    return enhancement * 6.1121 * np.exp((18.678 - t / 234.5) * t / (t + 257.14))


def refractive_index(
    temperature: Quantity, pressure: Quantity, relative_humidity: Quantity, model: str = 'itu_r_p453'
) -> Any:
    """Return the refractive index of air [1].

    Args:
        temperature: air temperature [degC].
        pressure: total atmospheric pressure [Pa].
        relative_humidity: [0..1].
        model: one of `MODELS`; ITU-R P.453-14 eqs. 1-4: N = 77.6 p_d/T + 72 e/T + 3.75e5 e/T^2, p_d and e in hPa;
            the paper's eq. 23 with p in kPa, wet coefficient 0.373 as printed or 3.73 corrected.

    Raises:
        ValueError: unknown model.
    """
    vapour = relative_humidity * saturation_vapour_pressure(temperature, pressure)  # hPa
    kelvin = temperature + ZERO_CELSIUS
    if model == 'itu_r_p453':
        dry = pressure / 100.0 - vapour
        return 1.0 + 1e-6 * (77.6 * dry / kelvin + 72.0 * vapour / kelvin + 3.75e5 * vapour / kelvin**2)
    if model in MODELS:
        wet = 0.373 if model.endswith('as_printed') else 3.73
        return 1.0 + 77.6e-5 * (pressure / 1000.0) / kelvin + wet * (vapour / 10.0) / kelvin**2
    raise ValueError(f"unknown refractive-index model '{model}'; one of {', '.join(MODELS)}")
