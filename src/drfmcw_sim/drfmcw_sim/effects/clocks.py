"""The clocks of a station: its reference oscillator drives them all."""

import numpy as np

from ..measurements import Station


def shift_reference(station: Station, deviation: np.ndarray | float) -> None:
    """Add `deviation` [1] to alpha; the ADC runs from the reference and changes in proportion."""
    before = station.alpha.copy()
    station.alpha += deviation
    station.sample_clock *= station.alpha / before


def own_time(station: Station, u: np.ndarray) -> np.ndarray:
    """Return true time since the sweep start [n, samples] in the station's own seconds."""
    return station.alpha[:, None] * u
