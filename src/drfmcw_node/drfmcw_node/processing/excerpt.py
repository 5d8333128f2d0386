"""Which sweeps displays get the results of: a few of each second, since nobody can see more of them."""

from .records import Beat, Spectrum, Sweep

INTERVAL = 0.1
"""Between two sweeps of one station and peer whose results are in the excerpt, at least [s]."""


class Excerpt:
    """Chooses sweeps by the time at which they are evaluated, and recognises their results."""

    def __init__(self) -> None:
        """Start with none chosen."""
        self._now = 0.0
        self._newest: dict[tuple[str, str], float] = {}  # when a sweep was chosen, by station and peer [s]
        self._chosen: set[tuple[frozenset[str], int]] = set()

    def begin(self, now: float) -> None:
        """Begin with sweeps that are evaluated at `now` (monotonic [s])."""
        self._now = now
        self._chosen.clear()

    def choose(self, sweep: Sweep) -> bool:
        """Return whether a sweep is in the excerpt; ask once for each, or once for both of a pair."""
        way = sweep.station, sweep.peer
        if self._now - self._newest.get(way, -INTERVAL) < INTERVAL:
            return False
        self._newest[way] = self._now
        self._chosen.add((frozenset(way), sweep.sweep_id))
        return True

    def holds(self, result: Beat | Spectrum) -> bool:
        """Return whether a result is of a sweep that was chosen since `begin`; of a pair, either station's."""
        return (frozenset((result.station, result.peer)), result.sweep_id) in self._chosen
