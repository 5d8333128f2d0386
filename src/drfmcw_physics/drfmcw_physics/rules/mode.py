"""Which measurement mode a distance requires: short distance up to a limit, long distance beyond, with hysteresis."""

import dataclasses
import math

from ..settings import parameter
from ..sweep import Mode


@dataclasses.dataclass(frozen=True)
class ModeSettings:
    """When to measure in which mode, and with which start delay (the paper's section V-C)."""

    limit: float = parameter(
        650.0, unit='m', bounds=(0.0, 1e7), description='distance beyond which the long-distance mode is used'
    )
    hysteresis: float = parameter(
        20.0, unit='m', bounds=(0.0, 1e6), description='width of the band around the limit in which the mode is kept'
    )
    start_delay_short: float = parameter(
        3.41e-6, unit='s', bounds=(0.0, 1.0), description='T_off of the short-distance mode'
    )
    start_delay_long: float = parameter(
        0.6e-6, unit='s', bounds=(0.0, 1.0), description='T_off of the long-distance mode'
    )

    def start_delay(self, mode: Mode) -> float:
        """Return T_off of a mode [s]."""
        return self.start_delay_long if mode == Mode.LONG_DISTANCE else self.start_delay_short


def choose_mode(current: Mode | None, distance: float, settings: ModeSettings) -> Mode:
    """Return the mode in which to measure a distance.

    Args:
        current: mode in use, kept while the distance is within half the hysteresis of the limit; None where none is.
        distance: between the antennas [m]; NaN keeps the current mode.
        settings: limit and hysteresis.
    """
    if current is None:
        return Mode.LONG_DISTANCE if distance > settings.limit else Mode.SHORT_DISTANCE
    if math.isnan(distance):
        return Mode(current)
    margin = settings.hysteresis / 2
    if current == Mode.LONG_DISTANCE:
        return Mode.SHORT_DISTANCE if distance < settings.limit - margin else Mode.LONG_DISTANCE
    return Mode.LONG_DISTANCE if distance > settings.limit + margin else Mode.SHORT_DISTANCE
