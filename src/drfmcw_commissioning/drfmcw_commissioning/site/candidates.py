"""What may be wrong with a calibration on site, and what each does to ranges and to T_off."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from drfmcw_fusion.displacement import displacement
from drfmcw_fusion.uncertainty import delay_std
from drfmcw_physics.oscillators import Calibration
from drfmcw_sim.effects import Stated

from .groups import Group

Change = Callable[[Calibration, float], Calibration]
Pair = tuple[Calibration, Calibration]


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One number that a calibration or the weather states, in the unit of the effect that is its error."""

    kind: Stated
    station: int  # 0 or 1; -1: of both, or of neither
    unit: str
    scale: float  # of one unit, in SI
    prior: float  # standard deviation that the calibration states, else what is plausible [units]
    change: Change | None  # of a calibration by so many units; None for the air

    def title(self, stations: Sequence[str]) -> str:
        """Return what it is, in words."""
        return title(self.kind, stations[self.station] if self.station >= 0 else '')


def title(kind: Stated, station: str) -> str:
    """Return what a number is, in words; a station '' is none."""
    return f"{kind} of '{station}'" if station else kind.value


def candidates(calibrations: Pair, groups: Sequence[Group], air_std: float) -> list[Candidate]:
    """Return everything that a pair's ranges may show, what is likeliest first.

    Args:
        calibrations: of both stations, as the ranges were computed with.
        groups: of the ranges.
        air_std: standard deviation of the refractivity by the sensors [1e-6].
    """
    found = [Candidate(Stated.DELAY, 1, 'ns', 1e-9, _delay_prior(*calibrations), _delay)]
    for i, c in enumerate(calibrations):
        found.append(Candidate(Stated.CLOCK, i, 'ppm', 1e-6, 1e6 * c.alpha_std or 50.0, _clock))
    for i, c in enumerate(calibrations):
        board = np.array([group.board[i] for group in groups])
        if np.isfinite(board).all() and np.ptp(board) > 0.0:
            found.append(Candidate(Stated.CLOCK_SLOPE, i, 'ppm/K', 1e-6, _clock_slope_prior(c), _clock_slope))
            found.append(Candidate(Stated.DELAY_SLOPE, i, 'ps/K', 1e-12, 50.0, _delay_slope))
    for i, c in enumerate(calibrations):
        prior = 1e6 * c.sample_clock_alpha_std or 50.0
        found.append(Candidate(Stated.SAMPLE_CLOCK, i, 'ppm', 1e-6, prior, _sample_clock))
    found.append(Candidate(Stated.AIR, -1, 'N', 1e-6, air_std, None))
    return found


def states_delay(first: Calibration, second: Calibration) -> bool:
    """Return whether two calibrations say how uncertain the delay of the pair is."""
    together = any(own.delay_peer == peer.station for own, peer in ((first, second), (second, first)))
    return delay_std(first, second) > 0.0 and (together or min(first.delay_std, second.delay_std) > 0.0)


def _delay_prior(first: Calibration, second: Calibration) -> float:
    """Return the standard deviation of the pair's delay [ns]."""
    return 1e9 * delay_std(first, second) if states_delay(first, second) else 100.0


def _clock_slope_prior(c: Calibration) -> float:
    """Return the standard deviation of a clock's slope [ppm/K]; one stated over a range of temperatures bounds it."""
    widest = max(c.temperature_high - c.temperature, c.temperature - c.temperature_low)
    if c.covers(c.temperature) is None or not c.alpha_std:
        return 2.0
    return min(1e6 * c.alpha_std / widest, 2.0)


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
