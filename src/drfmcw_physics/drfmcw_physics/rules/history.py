"""Values that hold from a stamp on, looked up by stamp: what makes live and offline results equal."""

import bisect
from collections.abc import Iterator
from typing import Generic, TypeVar

T = TypeVar('T')

WHOLE = 100_000
"""Values of one kind that are kept, at most, where those of a whole recording are given before its sweeps."""

LIVE = 4096
"""The same in a node: an hour of readings once a second, and no sweep arrives an hour late."""


class History(Generic[T]):
    """Values in order of their stamps; the newest not later than a stamp is the one that holds there."""

    def __init__(self, limit: int = WHOLE) -> None:
        """Keep at most `limit` values, dropping the oldest."""
        self._stamps: list[int] = []
        self._values: list[T] = []
        self._limit = limit

    def __len__(self) -> int:
        """Return the number of values kept."""
        return len(self._stamps)

    def __iter__(self) -> Iterator[tuple[int, T]]:
        """Return an iterator over (stamp, value), in order."""
        return zip(self._stamps, self._values, strict=True)

    def add(self, stamp: int, value: T) -> None:
        """Add a value that holds from `stamp` [ns] on; one with the same stamp is replaced."""
        index = bisect.bisect_left(self._stamps, stamp)
        if index < len(self._stamps) and self._stamps[index] == stamp:
            self._values[index] = value
            return
        self._stamps.insert(index, stamp)
        self._values.insert(index, value)
        if len(self._stamps) > self._limit:
            del self._stamps[0], self._values[0]

    def at(self, stamp: int) -> tuple[int, T] | None:
        """Return (its stamp, the value) that holds at `stamp` [ns], None where none does yet."""
        index = bisect.bisect_right(self._stamps, stamp) - 1
        return (self._stamps[index], self._values[index]) if index >= 0 else None

    def latest(self) -> T | None:
        """Return the newest value, None where there is none."""
        return self._values[-1] if self._values else None

    def first(self) -> T | None:
        """Return the oldest value kept, None where there is none."""
        return self._values[0] if self._values else None

    def keep(self, start: int, end: int) -> None:
        """Drop values that hold nowhere between two stamps [ns]; where all are later, the first one stays."""
        last = max(bisect.bisect_right(self._stamps, end), 1)
        first = min(max(bisect.bisect_right(self._stamps, start) - 1, 0), last - 1)
        for kept in (self._stamps, self._values):
            del kept[last:], kept[:first]
