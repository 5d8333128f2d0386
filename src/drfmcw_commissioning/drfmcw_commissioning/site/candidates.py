"""What may be wrong with a calibration on site, and what each does to ranges and to T_off."""

import dataclasses
import enum
import math
from collections.abc import Callable, Sequence

import numpy as np

from drfmcw_fusion.displacement import displacement
from drfmcw_physics.oscillators import Calibration

from .groups import Group

Change = Callable[[Calibration, float], Calibration]
Pair = tuple[Calibration, Calibration]


class Kind(enum.StrEnum):
    """What is changed."""

    DELAY = 'hardware delay'
    CLOCK = 'reference clock'
    CLOCK_SLOPE = 'temperature slope of the reference clock'
    DELAY_SLOPE = 'temperature slope of the delay'
    SAMPLE_CLOCK = 'ADC clock beside the reference'
    AIR = 'refractivity of the air'


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One number that a calibration or the weather states, in a unit in which a typical error is about 1."""

    kind: Kind
    station: int  # 0 or 1; -1: of both, or of neither
    unit: str
    scale: float  # of one unit, in SI
    prior: float  # standard deviation that the calibration states, else what is plausible [units]
    change: Change | None  # of a calibration by so many units; None for the air

    def title(self, stations: Sequence[str]) -> str:
        """Return what it is, in words."""
        return self.kind.value if self.station < 0 else f"{self.kind} of '{stations[self.station]}'"


def candidates(calibrations: Pair, groups: Sequence[Group], air_std: float) -> list[Candidate]:
    """Return everything that a pair's ranges may show, what is likeliest first.

    Args:
        calibrations: of both stations, as the ranges were computed with.
        groups: of the ranges.
        air_std: standard deviation of the refractivity by the sensors [1e-6].
    """
    stated = math.hypot(*(c.delay_std for c in calibrations))
    found = [Candidate(Kind.DELAY, 1, 'ns', 1e-9, 1e9 * stated or 100.0, _delay)]
    for i, c in enumerate(calibrations):
        found.append(Candidate(Kind.CLOCK, i, 'ppm', 1e-6, 1e6 * c.alpha_std or 50.0, _clock))
    for i in range(2):
        board = np.array([group.board[i] for group in groups])
        if np.isfinite(board).all() and np.ptp(board) > 0.0:
            found.append(Candidate(Kind.CLOCK_SLOPE, i, 'ppm/K', 1e-6, 2.0, _clock_slope))
            found.append(Candidate(Kind.DELAY_SLOPE, i, 'ps/K', 1e-12, 50.0, _delay_slope))
    for i, c in enumerate(calibrations):
        prior = 1e6 * c.sample_clock_alpha_std or 50.0
        found.append(Candidate(Kind.SAMPLE_CLOCK, i, 'ppm', 1e-6, prior, _sample_clock))
    found.append(Candidate(Kind.AIR, -1, 'N', 1e-6, air_std, None))
    return found


def response(candidate: Candidate, groups: Sequence[Group], calibrations: Pair) -> np.ndarray:
    """Return by how much one unit displaces error [m] and T_off [s] of each group, (2, groups).

    The true lines follow from the changed calibrations; they are evaluated with the unchanged ones.
    """
    if candidate.change is None:
        return np.array([[candidate.scale * group.distance, 0.0] for group in groups]).T
    return np.array([_displaced(candidate, group, calibrations) for group in groups]).T


def changed(candidate: Candidate, calibrations: Pair, amount: float) -> Pair:
    """Return the calibrations with `amount` units more of what a candidate changes."""
    if candidate.change is None:
        return calibrations
    first, second = calibrations
    if candidate.station == 0:
        return candidate.change(first, amount * candidate.scale), second
    return first, candidate.change(second, amount * candidate.scale)


def _displaced(candidate: Candidate, group: Group, calibrations: Pair) -> tuple[float, float]:
    true = changed(candidate, calibrations, 1.0)
    stated, actual = ([c.at(t) for c, t in zip(pair, group.board, strict=True)] for pair in (calibrations, true))
    return displacement(group.sweeps, stated, actual, group.distance, group.index)


def _delay(c: Calibration, amount: float) -> Calibration:
    return dataclasses.replace(c, delay=c.delay + amount)


def _delay_slope(c: Calibration, amount: float) -> Calibration:
    return dataclasses.replace(c, delay_slope=c.delay_slope + amount)


def _clock(c: Calibration, amount: float) -> Calibration:
    """The ADC runs from the reference."""
    return dataclasses.replace(c, alpha=c.alpha + amount, sample_clock_alpha=c.sample_clock_alpha + amount)


def _clock_slope(c: Calibration, amount: float) -> Calibration:
    return dataclasses.replace(
        c, alpha_linear=c.alpha_linear + amount, sample_clock_linear=c.sample_clock_linear + amount
    )


def _sample_clock(c: Calibration, amount: float) -> Calibration:
    return dataclasses.replace(c, sample_clock_alpha=c.sample_clock_alpha + amount)
