"""What arrived from the graph: one record per kind, with the names of the messages' fields."""

import dataclasses
import math

import numpy as np

_WATCH = 'Model '  # task of a watch node, before the name of its pair


@dataclasses.dataclass(frozen=True)
class RangeReading:
    """One range; the fields of RangeEstimate that the page shows."""

    sweep_id: int
    stamp: int  # [ns]
    mode: int
    flags: int
    failed_tests: int
    range: float  # [m]
    range_std: float  # [m]
    velocity: float  # [m/s]
    protection_level: float  # [m]


@dataclasses.dataclass(frozen=True)
class Line:
    """One station's beat frequency; the fields of BeatFrequency that the page shows."""

    sweep_id: int
    flags: int
    frequency: float  # [Hz]
    frequency_std: float  # [Hz]
    power: float  # [dBm]
    snr: float  # [dB]


@dataclasses.dataclass(frozen=True)
class SpectrumReading:
    """One sweep's magnitude spectrum, decimated."""

    sweep_id: int
    start_frequency: float  # [Hz]
    frequency_step: float  # [Hz]
    magnitude: np.ndarray  # [dBFS]


@dataclasses.dataclass(frozen=True)
class SiteReading:
    """One reading of the weather."""

    value: float  # in the message's unit
    stamp: int  # [ns]
    received: float  # monotonic [s]


@dataclasses.dataclass(frozen=True)
class Health:
    """One station's housekeeping; the fields of StationStatus."""

    temperature: float  # [degC]
    pll_locked: bool
    sweeps: int
    dropped: int
    link_quality: float  # [1]

    @property
    def loss(self) -> float:
        """Share of sweeps without a valid result [1], NaN before the first."""
        return self.dropped / self.sweeps if self.sweeps else math.nan


@dataclasses.dataclass(frozen=True)
class Diagnostic:
    """One line of /diagnostics."""

    level: int  # 0 OK, 1 warning, 2 error, 3 stale
    name: str
    message: str
    hardware: str
    values: tuple[tuple[str, str], ...]
    received: float  # monotonic [s]

    @property
    def watched(self) -> str:
        """The pair 'first/second' that this line of the live diagnosis is about, '' for another node's."""
        task = self.name.partition(': ')[2]
        return task.removeprefix(_WATCH) if task.startswith(_WATCH) else ''


LOG_LEVELS = (0, 30, 40)
"""Severities from which on log lines can be shown: all, warnings, errors (rcl_interfaces/Log)."""


@dataclasses.dataclass(frozen=True)
class LogLine:
    """One line of /rosout."""

    stamp: int  # by the node's clock [s]
    level: int  # 10 debug, 20 info, 30 warning, 40 error, 50 fatal
    name: str  # of the logger
    message: str


def decimated(magnitude: np.ndarray, bins: int) -> tuple[np.ndarray, int]:
    """Return (at most `bins` maxima of groups of equal size, size of a group): no line is lost between bins.

    Args:
        magnitude: shape (n,) [dBFS].
        bins: largest number returned.
    """
    group = max(1, math.ceil(len(magnitude) / bins))
    whole = len(magnitude) // group * group
    return magnitude[:whole].reshape(-1, group).max(axis=1), group
