"""Physical constants, exact by definition (The International System of Units, 9th edition), and reference values."""

import math

SPEED_OF_LIGHT = 299_792_458.0
"""Velocity of light in vacuum [m/s]."""

BOLTZMANN = 1.380649e-23
"""Boltzmann constant [J/K]."""

STANDARD_NOISE_TEMPERATURE = 290.0
"""Standard noise temperature T_0 of IEEE noise figures [K]."""

ZERO_CELSIUS = 273.15
"""0 degC [K]."""

DECIBELS_PER_NEPER = 20.0 / math.log(10.0)
"""Of a ratio of amplitudes [dB]."""
