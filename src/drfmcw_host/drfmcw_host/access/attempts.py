"""Rate limit of logins: few failures per address, and few per user from all addresses together."""

import collections
import math
import time
from collections.abc import Callable

FREE = 5
"""Failures before waiting begins."""

_FIRST, _LONGEST = 2.0, 900.0  # waiting [s]
_FORGET = 3600.0  # after the last failure [s]
_KEYS = 10_000  # that are remembered


class Attempts:
    """Counts failures per key; after five the wait doubles from 2 s to 15 min."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start without failures; `clock` gives monotonic time [s]."""
        self._clock = clock
        self._failures: collections.OrderedDict[str, tuple[int, float]] = collections.OrderedDict()

    def wait(self, *keys: str) -> int:
        """Return how many seconds to wait before the next attempt under any of these keys, 0 for none."""
        now, longest = self._clock(), 0.0
        for key in keys:
            count, last = self._failures.get(key, (0, now))
            if count >= FREE and now - last < _FORGET:
                longest = max(longest, last + min(_FIRST * 2.0 ** (count - FREE), _LONGEST) - now)
        return math.ceil(longest)

    def failed(self, *keys: str) -> None:
        """Count a failure under each key."""
        now = self._clock()
        for key in keys:
            count, last = self._failures.pop(key, (0, now))
            self._failures[key] = (count + 1 if now - last < _FORGET else 1, now)
        while len(self._failures) > _KEYS:
            self._failures.popitem(last=False)

    def succeeded(self, *keys: str) -> None:
        """Forget the failures under each key."""
        for key in keys:
            self._failures.pop(key, None)
