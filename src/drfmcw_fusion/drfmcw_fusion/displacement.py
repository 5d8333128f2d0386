"""By how much a range is off where calibrations other than the true ones are stated."""

from collections.abc import Sequence

from drfmcw_node.processing.records import Beat
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import SweepSettings, beat_frequency

from .combination import Station, delay_on_true_clocks, start_delay_excess


def displacement(
    sweeps: Sequence[SweepSettings],
    stated: Sequence[Calibration],
    actual: Sequence[Calibration],
    distance: float,
    index: float,
) -> tuple[float, float]:
    """Return by how much range [m] and T_off [s] are off. The lines follow from the actual calibrations.

    Args:
        sweeps: of both stations.
        stated: calibrations of both with which the lines are evaluated, as they hold at the temperatures of the boards.
        actual: calibrations of both that the lines follow, likewise.
        distance: between the antennas [m].
        index: refractive index of the air.
    """
    light = SPEED_OF_LIGHT / index
    delay = distance / light + sum(c.delay for c in actual)
    first, second = sweeps
    lines = (
        beat_frequency(first, delay, actual[0].alpha, actual[1].alpha) / actual[0].sample_clock_alpha,
        beat_frequency(second, delay, actual[1].alpha, actual[0].alpha) / actual[1].sample_clock_alpha,
    )
    measured = float(delay_on_true_clocks((first, second), (stated[0], stated[1]), lines))
    hardware = sum(c.delay for c in stated)
    stations = [with_line(s, c, f) for s, c, f in zip((first, second), stated, lines, strict=True)]
    return (measured - hardware) * light - distance, start_delay_excess(stations[0], stations[1], measured)


def with_line(sweep: SweepSettings, calibration: Calibration, frequency: float) -> Station:
    """Return a station that has measured nothing but a line of that frequency [Hz]."""
    return Station(Beat(sweep.station, sweep.peer, 0, 0, frequency, 1.0, 0.0, 0.0, 0.0, 0), sweep, calibration)
