"""Which sweeps are under way between the simulator and those who evaluate them."""

import collections
import time
from collections.abc import Sequence

_PROBE_INTERVAL = 0.1  # between sweeps to a party that has never answered [s]


class Acknowledgements:
    """Which sweeps each party (a station, or fusion for a pair) has answered, so that no more than a window waits.

    The first answers may be lost while the middleware still connects the party's publisher to us: until it has
    answered once it gets a sweep now and then, not a window that nobody would acknowledge.
    """

    def __init__(self, names: Sequence[str]) -> None:
        """Start with nothing under way."""
        self._waiting: dict[str, collections.deque[int]] = {name: collections.deque() for name in names}
        self._progress = dict.fromkeys(names, time.monotonic())
        self._sent_at = dict.fromkeys(names, 0.0)
        self._heard: set[str] = set()
        self._absent: set[str] = set()
        self.silent: set[str] = set()

    @property
    def names(self) -> list[str]:
        """The parties."""
        return list(self._waiting)

    def sent(self, name: str, sweep_id: int) -> None:
        """Note a published sweep; the same one may be noted again."""
        waiting = self._waiting[name]
        if not waiting:
            self._progress[name] = time.monotonic()
        self._sent_at[name] = time.monotonic()
        if self._is_awaited(name) and not (waiting and waiting[-1] == sweep_id):
            waiting.append(sweep_id)

    def answered(self, name: str, sweep_id: int) -> bool:
        """Note an answer, which covers every earlier sweep too; return True where the party was silent before."""
        waiting = self._waiting[name]
        while waiting and waiting[0] <= sweep_id:
            waiting.popleft()
        self._progress[name] = time.monotonic()
        self._heard.add(name)
        back = name in self.silent
        self.silent.discard(name)
        self._absent.discard(name)
        return back

    def expect_nothing(self, name: str) -> None:
        """Do not wait for a party that is not part of the graph, until it answers."""
        self._absent.add(name)

    def _is_awaited(self, name: str) -> bool:
        return name not in self.silent and name not in self._absent

    def full(self, window: int) -> list[str]:
        """Return the parties that must not be sent another sweep yet."""
        return [name for name in self._waiting if not self.room(name, window)]

    def room(self, name: str, window: int) -> bool:
        """Return True where the party may be sent another sweep."""
        if not self._is_awaited(name) or not self._waiting[name]:
            return True
        if name not in self._heard:
            return time.monotonic() - self._sent_at[name] > _PROBE_INTERVAL
        return len(self._waiting[name]) < window

    def outstanding(self) -> int:
        """Return the largest number of sweeps any party has unanswered."""
        return max(len(w) for w in self._waiting.values())

    def give_up(self, name: str, timeout: float) -> bool:
        """Return True where the party has now been silent for `timeout` [s] and is no longer waited for."""
        if not self._is_awaited(name) or time.monotonic() - self._progress[name] < timeout:
            return False
        self.silent.add(name)
        self._waiting[name].clear()
        return True
