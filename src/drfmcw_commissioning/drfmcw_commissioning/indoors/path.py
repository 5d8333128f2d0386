"""Delay of a pair's hardware, its temperature slope and T_off, from ranges over a path of known length."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from drfmcw_fusion.pipeline import UNMEASURED, RangeResult
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError

from .curve import Curve, fit

_FEWEST = 3  # sweeps
_STEP = 1.0  # of board temperatures that count as one [K]


@dataclasses.dataclass(frozen=True)
class KnownPath:
    """What the hardware is connected by."""

    length: float  # [m]
    std: float  # one standard deviation of the length [m]
    in_air: bool  # a baseline between antennas; else a cable
    velocity_factor: float = 1.0  # of the cable, 1: its length is the electrical one

    @classmethod
    def of_delay(cls, delay: float, std: float) -> 'KnownPath':
        """Return the path with a delay and its standard deviation [s], as a network analyser states it."""
        return cls(delay * SPEED_OF_LIGHT, std * SPEED_OF_LIGHT, in_air=False)


@dataclasses.dataclass(frozen=True)
class PathCalibration:
    """What ranges over a known path determine."""

    delay: Curve  # of the station, what the peer's delay leaves, over its board temperature; values in seconds
    excess: float  # of T_off over the nominal one, mean [s]; NaN for a station that hears itself
    excess_std: float  # standard deviation of that mean [s]
    jitter: float  # standard deviation of T_off from sweep to sweep [s]
    sweeps: int


def path_calibration(
    results: Sequence[RangeResult],
    temperatures: Sequence[float] | np.ndarray,
    peer_delays: Sequence[float] | np.ndarray,
    path: KnownPath,
    reference: float = 25.0,
) -> PathCalibration:
    """Return one station's delay, constant or linear over its board temperature, and T_off.

    Args:
        results: of the sweeps over the path, evaluated with the clocks already calibrated.
        temperatures: of the station's board at each, (n,) [degC]; NaN where unknown.
        peer_delays: what the peer's calibration states at each, (n,) [s]; zero for a station that hears itself.
        path: that the hardware is connected by.
        reference: board temperature at which the delay is stated, moved into the range of the sweeps [degC].

    Raises:
        ConfigurationError: too few sweeps with a result.
    """
    board = np.asarray(temperatures, float)
    kept = np.array([not r.flags & UNMEASURED and math.isfinite(r.path_delay) for r in results], bool)
    if np.count_nonzero(kept) < _FEWEST:
        raise ConfigurationError(f'{np.count_nonzero(kept)} of {len(results)} sweeps have a usable line; 3 are needed')
    chosen = [r for r, take in zip(results, kept, strict=True) if take]
    board = board[kept]
    board = np.where(np.isfinite(board), board, np.nanmean(board) if np.isfinite(board).any() else reference)
    known = np.array([path.length / SPEED_OF_LIGHT * _slowness(path, r) for r in chosen])
    delay = np.array([r.path_delay for r in chosen]) - known - np.asarray(peer_delays, float)[kept]
    std = np.array([r.white_std * r.refractive_index / SPEED_OF_LIGHT for r in chosen])
    # sweeps at one temperature make one value, so that the shape is judged by temperatures, not by sweeps
    groups = [np.flatnonzero(np.round(board / _STEP) == step) for step in np.unique(np.round(board / _STEP))]
    curve = fit(
        [float(np.average(delay[g], weights=std[g] ** -2)) for g in groups],
        [float(np.mean(board[g])) for g in groups],
        [float(np.sum(std[g] ** -2) ** -0.5) for g in groups],
        path.std / SPEED_OF_LIGHT * _slowness(path, chosen[0]),
        'auto' if len(groups) > 2 else 'constant',
        reference,
        longest='linear',
    )
    excess = np.array([r.start_delay_excess for r in chosen])
    jitter = float(np.std(excess, ddof=1))
    return PathCalibration(curve, float(np.mean(excess)), jitter / math.sqrt(len(excess)), jitter, len(chosen))


def _slowness(path: KnownPath, result: RangeResult) -> float:
    """Return how much longer a path takes than the same length of vacuum."""
    return result.refractive_index if path.in_air else 1.0 / path.velocity_factor
