"""Ranges of one pair gathered into few messages, for displays: a reader of each range costs fusion latency."""

import collections
import dataclasses
import math
from collections.abc import Sequence

from .pipeline import RangeResult

INTERVAL = 1.0 / 40.0
"""Between two messages, where ranges come faster [s]: whoever looks 30 times a second finds a new one each time."""

_MOST = 4000  # ranges that wait


@dataclasses.dataclass(frozen=True)
class Batch:
    """The fields of the message RangeBatch, whose definition has their units; sequences with one element per range."""

    stamp: int  # of the newest range [ns]
    frame_id: str
    first_station: str
    second_station: str
    sweep_id: Sequence[int]
    sweep_start: Sequence[int]
    age: Sequence[float]
    mode: Sequence[int]
    flags: Sequence[int]
    range: Sequence[float]
    range_std: Sequence[float]
    velocity: Sequence[float]
    protection_level: Sequence[float]
    failed_tests: Sequence[int]


class Gathering:
    """Ranges of one pair that no message holds yet."""

    def __init__(self) -> None:
        """Start with none."""
        self._waiting: collections.deque[tuple[float, RangeResult]] = collections.deque(maxlen=_MOST)
        self._newest = self._sent = -math.inf  # when a range was added and a batch was taken [s]
        self._gap = math.inf  # between the newest two additions [s]

    def add(self, result: RangeResult, now: float) -> None:
        """Take a range that was published at `now` (monotonic [s])."""
        self._waiting.append((now, result))
        self._gap, self._newest = now - self._newest, now

    def due(self, now: float) -> bool:
        """Return whether a batch should be sent: to wait for the next range would make it later than `INTERVAL`."""
        return bool(self._waiting) and now - self._sent + self._gap > INTERVAL

    def take(self, now: float) -> Batch | None:
        """Return all ranges that wait, oldest first, and forget them; None where there are none."""
        if not self._waiting:
            return None
        published, results = zip(*self._waiting, strict=True)
        self._waiting.clear()
        self._sent = now
        newest: RangeResult = results[-1]
        return Batch(
            stamp=newest.stamp,
            frame_id=newest.frame_id,
            first_station=newest.first_station,
            second_station=newest.second_station,
            sweep_id=[r.sweep_id for r in results],
            sweep_start=[r.stamp for r in results],
            age=[now - at for at in published],
            mode=[r.mode for r in results],
            flags=[r.flags for r in results],
            range=[r.range for r in results],
            range_std=[r.range_std for r in results],
            velocity=[r.velocity for r in results],
            protection_level=[r.protection_level for r in results],
            failed_tests=[r.failed_tests for r in results],
        )
