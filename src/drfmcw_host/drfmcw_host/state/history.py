"""History of one number with a bounded memory: minimum, mean and maximum per interval, on six time scales."""

import dataclasses
import math

import numpy as np

WINDOWS = (10, 60, 600, 3600, 21_600, 86_400)
"""Spans that can be shown [s]: 10 s to 24 h, one level each."""

_POINTS = 600  # intervals per level
_WIDTHS = (0.02, 0.1, 1.0, 6.0, 36.0, 144.0)  # of an interval, each a multiple of the one before [s]
_NANOSECONDS = 1_000_000_000


@dataclasses.dataclass(frozen=True)
class Curve:
    """One span of a history, in order of time; arrays of equal shape (n,), n at most 600."""

    times: np.ndarray  # centre of each interval [s]
    low: np.ndarray
    mean: np.ndarray
    high: np.ndarray


class _Level:
    """Ring of intervals of one width; an interval's slot is its number modulo the length."""

    def __init__(self, width: float) -> None:
        self.width = round(width * _NANOSECONDS)  # [ns]
        self._number = np.full(_POINTS, -1, dtype=np.int64)
        self._low = np.zeros(_POINTS)
        self._high = np.zeros(_POINTS)
        self._sum = np.zeros(_POINTS)
        self._count = np.zeros(_POINTS, dtype=np.int64)

    def add(self, times: np.ndarray, values: np.ndarray) -> None:
        """Take values at non-decreasing `times` [ns]."""
        numbers = times // self.width
        starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))[-_POINTS:]
        first = starts[0]
        values, inner = values[first:], starts - first
        numbers = numbers[starts]
        slots = numbers % _POINTS
        new = self._number[slots] < numbers
        low, high = np.minimum.reduceat(values, inner), np.maximum.reduceat(values, inner)
        total, count = np.add.reduceat(values, inner), np.diff(inner, append=len(values))
        self._low[slots] = np.where(new, low, np.minimum(low, self._low[slots]))
        self._high[slots] = np.where(new, high, np.maximum(high, self._high[slots]))
        self._sum[slots] = np.where(new, total, self._sum[slots] + total)
        self._count[slots] = np.where(new, count, self._count[slots] + count)
        self._number[slots] = np.maximum(numbers, self._number[slots])

    def curve(self, now: int) -> Curve:
        """Return the intervals of the last 600 widths before `now` [ns]."""
        newest = now // self.width
        order = np.argsort(self._number)
        order = order[(self._number[order] > newest - _POINTS) & (self._number[order] >= 0)]
        times = (self._number[order] + 0.5) * (self.width / _NANOSECONDS)
        return Curve(times, self._low[order], self._sum[order] / self._count[order], self._high[order])


class History:
    """Keeps one number's last 24 h: 6 x 600 intervals, 144 kB, whatever the rate."""

    def __init__(self) -> None:
        """Start empty."""
        self._levels = [_Level(width) for width in _WIDTHS]
        self._last = 0

    def add(self, times: np.ndarray, values: np.ndarray) -> None:
        """Take values as they arrived.

        Args:
            times: of arrival, shape (n,), integer [ns]; one earlier than those before counts as the latest.
            values: shape (n,); what is not finite is left out.
        """
        finite = np.isfinite(values)
        if not finite.any():
            return
        times = np.maximum.accumulate(np.maximum(np.asarray(times, dtype=np.int64)[finite], self._last))
        self._last = int(times[-1])
        values = np.asarray(values, dtype=float)[finite]
        for level in self._levels:
            level.add(times, values)

    def curve(self, span: float, now: int) -> Curve:
        """Return the last `span` seconds before `now` [ns] on the coarsest scale that still covers them.

        Raises:
            ValueError: `span` is longer than 24 h or not above zero.
        """
        if not 0.0 < span <= WINDOWS[-1] or not math.isfinite(span):
            raise ValueError(f'span = {span:g} s is not within 0 ... {WINDOWS[-1]} s')
        level = next(level for level, window in zip(self._levels, WINDOWS, strict=True) if span <= window)
        curve = level.curve(now)
        inside = curve.times >= now / _NANOSECONDS - span - level.width / _NANOSECONDS
        return Curve(*(getattr(curve, field.name)[inside] for field in dataclasses.fields(Curve)))
