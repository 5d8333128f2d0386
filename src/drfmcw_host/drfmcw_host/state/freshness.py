"""How old a value is, and from when on it counts as stale: by the host's clock alone, though nothing arrives."""

import collections
import dataclasses
import math
import statistics

STALE_AFTER = 0.25
"""Age from which a value is shown as stale [s]; with sampling and sending it is grey within 0.5 s."""

_SLOW = 1.5  # times the usual interval: the same for a site that measures more slowly
_GAPS = 9  # newest intervals, whose median is the usual one
_FEWEST = 3  # of them: a single one may be an interruption


@dataclasses.dataclass
class Arrivals:
    """When the newest value of one kind arrived, and how often they come."""

    newest: float = -math.inf  # monotonic [s]
    gaps: collections.deque[float] = dataclasses.field(default_factory=lambda: collections.deque(maxlen=_GAPS))  # [s]

    def add(self, now: float) -> None:
        """Take an arrival at `now` (monotonic [s])."""
        if math.isfinite(self.newest):
            self.gaps.append(now - self.newest)
        self.newest = now

    def age(self, now: float) -> float:
        """Return the time since the newest arrival [s], infinite before the first."""
        return now - self.newest

    @property
    def limit(self) -> float:
        """Age beyond which the newest value is stale [s]."""
        usual = statistics.median(self.gaps) if len(self.gaps) >= _FEWEST else 0.0
        return max(STALE_AFTER, _SLOW * usual)

    def is_stale(self, now: float) -> bool:
        """Return whether the newest value is no longer current."""
        return self.age(now) > self.limit
