"""Ranges beside their reference, gathered where distance, settings and board temperatures are the same."""

import csv
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drfmcw_fusion.pipeline import Flag
from drfmcw_fusion.replayed.statistics import EXCLUDED, reference_at
from drfmcw_physics.settings import ConfigurationError, read_text
from drfmcw_physics.sweep import SweepSettings

from ..recordings import Ranges

_FEWEST = 5  # sweeps of a group
_DISTANCE_STEP = 2.0  # within which distances are one [m]
_TEMPERATURE_STEP = 1.0  # within which board temperatures are one [K]
_SAME_MARK = 2.0  # largest distance of a range from its mark [m]


@dataclasses.dataclass(frozen=True)
class Mark:
    """A point whose distance is known."""

    range: float  # [m]
    std: float  # [m]


@dataclasses.dataclass(frozen=True)
class Group:
    """Sweeps under the same conditions."""

    distance: float  # by the reference, mean [m]
    error: float  # mean of range minus reference [m]
    std: float  # standard deviation of that mean: noise of ranges and reference [m]
    shared: float  # part of it that all sweeps share: that of a mark [m]
    excess: float  # mean of T_off beyond nominal [s]
    excess_std: float  # standard deviation of that mean [s]
    board: tuple[float, ...]  # mean board temperatures of the stations [degC]
    index: float  # refractive index, mean
    sweeps: tuple[SweepSettings, ...]
    stamps: tuple[int, ...]  # of the sweeps [ns]
    doubtful: int  # sweeps flagged for another reason than the clocks

    @property
    def count(self) -> int:
        """Number of sweeps."""
        return len(self.stamps)


def read_marks(path: Path | str) -> list[Mark]:
    """Return the marks of a CSV file with the columns range [m] and std [m].

    Raises:
        ConfigurationError: not readable, or a cell is no number.
    """
    rows = list(csv.DictReader(read_text(path).splitlines()))
    marks = []
    for number, row in enumerate(rows, 1):
        try:
            mark = Mark(float(row['range']), float(row['std']))
        except (KeyError, TypeError, ValueError):
            raise ConfigurationError(f"{path}: mark {number}: expected numbers in columns 'range' and 'std'") from None
        if not (mark.range > 0.0 and mark.std >= 0.0 and math.isfinite(mark.range + mark.std)):
            raise ConfigurationError(f'{path}: mark {number}: {mark.range:g} m +- {mark.std:g} m is no distance')
        marks.append(mark)
    if not marks:
        raise ConfigurationError(f'{path}: holds no mark')
    return marks


def gather(ranges: Ranges, marks: Sequence[Mark] = ()) -> list[Group]:
    """Return the groups of a recording, in order of distance, sweeps without a reference left out.

    Args:
        ranges: of the recording.
        marks: instead of the recorded reference; a range belongs to the nearest one within two metres.

    Raises:
        ConfigurationError: no range has a reference.
    """
    results = ranges.results
    measured = np.array([r.range for r in results])
    truth, common, single = _references(ranges, measured, marks)
    usable = np.isfinite(truth) & np.isfinite(measured) & np.array([not r.flags & EXCLUDED for r in results], bool)
    keys: dict[tuple[float | int, ...], list[int]] = {}
    for i in np.flatnonzero(usable):
        sweep = ranges.sweeps[i][0]
        board = np.nan_to_num(np.round(ranges.board[:, i] / _TEMPERATURE_STEP))
        key = (round(truth[i] / _DISTANCE_STEP), results[i].mode, sweep.start_delay, *board)
        keys.setdefault(key, []).append(int(i))
    groups = [_group(ranges, rows, truth, common, single) for rows in keys.values() if len(rows) >= _FEWEST]
    if not groups:
        raise ConfigurationError(
            'no group of five usable ranges at one distance has a reference: record /reference/range, or give --marks'
        )
    return sorted(groups, key=lambda group: (group.distance, group.board))


def _references(
    ranges: Ranges, measured: np.ndarray, marks: Sequence[Mark]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return reference of each range, and its standard deviations: shared by a group, and of each sweep, (n,) [m]."""
    n = len(measured)
    if not marks:
        stamps = np.array([r.stamp for r in ranges.results], dtype=np.int64)
        std = math.sqrt(float(np.mean(ranges.reference.stds**2))) if len(ranges.reference.stds) else math.nan
        return reference_at(ranges.reference, stamps), np.zeros(n), np.full(n, std)
    distances = np.array([mark.range for mark in marks])
    nearest = np.argmin(np.abs(measured[:, None] - distances), axis=1)
    near = np.abs(measured - distances[nearest]) <= _SAME_MARK
    stds = np.array([mark.std for mark in marks])[nearest]
    return np.where(near, distances[nearest], np.nan), stds, np.zeros(n)


def _group(ranges: Ranges, rows: list[int], truth: np.ndarray, common: np.ndarray, single: np.ndarray) -> Group:
    results = [ranges.results[i] for i in rows]
    error = np.array([r.range for r in results]) - truth[rows]
    white = np.array([r.white_std for r in results])
    weights = 1.0 / (white**2 + single[rows] ** 2)
    excess = np.array([r.start_delay_excess for r in results])
    clean = int(Flag.STALE_CALIBRATION | Flag.STALE_ENVIRONMENT | Flag.UNKNOWN_VELOCITY)
    return Group(
        distance=float(np.mean(truth[rows])),
        error=float(np.average(error, weights=weights)),
        std=math.hypot(float(np.sum(weights)) ** -0.5, float(common[rows[0]])),
        shared=float(common[rows[0]]),
        excess=float(np.mean(excess)),
        excess_std=float(np.std(excess, ddof=1)) / math.sqrt(len(rows)),
        board=tuple(float(t) for t in np.mean(ranges.board[:, rows], axis=1)),
        index=float(np.mean([r.refractive_index for r in results])),
        sweeps=ranges.sweeps[rows[0]],
        stamps=tuple(r.stamp for r in results),
        doubtful=sum(bool(r.flags & ~clean) for r in results),
    )
