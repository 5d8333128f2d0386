"""How an error of a reference oscillator moves the clocks made from it."""

import numpy as np

from ..signal_model import Station


def shift_reference(station: Station, deviation: np.ndarray | float) -> None:
    """Add `deviation` [1] to alpha; the ADC runs from the reference and changes in proportion."""
    before = station.alpha.copy()
    station.alpha += deviation
    station.sample_clock *= station.alpha / before
