"""Limit of requests per address: nobody keeps the host, or the computer that it shares with the graph, busy."""

import collections
import math
import time
from collections.abc import Callable

PAGE = 10.0
"""What a page costs, of which the host builds some hundred elements; anything else costs 1."""

_BURST = 1000.0  # at once: forty browsers behind one address open a page with all that belongs to it
_REFILL = 100.0  # per second
_ADDRESSES = 10_000  # that are remembered
_SMALL = ('/static/', '/_nicegui/', '/_nicegui_ws/', '/live')


def cost(path: str) -> float:
    """Return what a request for a path costs."""
    return 1.0 if path.startswith(_SMALL) else PAGE


class Requests:
    """A bucket of tokens per address: each request takes some, and they come back at a constant rate."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start with full buckets; `clock` gives monotonic time [s]."""
        self._clock = clock
        self._buckets: collections.OrderedDict[str, tuple[float, float]] = collections.OrderedDict()

    def wait(self, address: str, tokens: float) -> int:
        """Take tokens for a request; return 0, or after how many seconds there will be enough [s], and take none."""
        now = self._clock()
        left, last = self._buckets.pop(address, (_BURST, now))
        left = min(_BURST, left + (now - last) * _REFILL)
        granted = left >= tokens
        self._buckets[address] = (left - tokens if granted else left, now)
        while len(self._buckets) > _ADDRESSES:
            self._buckets.popitem(last=False)
        return 0 if granted else math.ceil((tokens - left) / _REFILL)
