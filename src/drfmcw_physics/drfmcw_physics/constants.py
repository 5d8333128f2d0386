"""Physical constants (CODATA via scipy) and fixed reference values."""

import math

from scipy import constants

SPEED_OF_LIGHT = constants.speed_of_light
"""Velocity of light in vacuum [m/s]."""

BOLTZMANN = constants.Boltzmann
"""Boltzmann constant [J/K]."""

STANDARD_NOISE_TEMPERATURE = 290.0
"""Standard noise temperature T_0 of IEEE noise figures [K]."""

ZERO_CELSIUS = constants.zero_Celsius
"""0 degC [K]."""

DECIBELS_PER_NEPER = 20.0 / math.log(10.0)
"""Of a ratio of amplitudes [dB]."""
