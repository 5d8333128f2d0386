"""Time division: which pair of stations measures in which slot, by rates and priorities.

A frame of slots repeats until another schedule follows. Every pair has at least one slot in it, so none starves; a slot
lasts as long whether its pair's stations answer or not, so a silent one costs its own slots and nothing else.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence

import numpy as np

from ..settings import ConfigurationError

LARGEST_RATE = 1e5
"""Sweeps per second that a pair may ask for [Hz]."""
LARGEST_PRIORITY = 1000
"""Of a pair; the smallest is its negative."""

Turns = tuple[float, int]
"""Rate [Hz] and priority of a pair; `NO_TURNS` where none is asked for or stated."""

NO_TURNS: Turns = (0.0, 0)
"""Neither rate nor priority."""

_LONGEST_FRAME = 1000  # slots; rates are granted to a thousandth of all


@dataclasses.dataclass(frozen=True)
class Demand:
    """What one pair asks for."""

    rate: float = math.nan  # at least so many sweeps per second; NaN: an equal share of what is left [Hz]
    priority: int = 0  # the higher one gets its rate first


@dataclasses.dataclass(frozen=True)
class Share:
    """What one station is granted, or asked for, between it and one peer; the fields of the message SweepSchedule."""

    station: str
    peer: str
    rate: float = 0.0
    """Sweep pairs per second; 0: not stated, or none is asked for [Hz]."""
    priority: int = 0
    stamp: int = 0
    frame_id: str = ''

    @property
    def turns(self) -> Turns:
        """Rate [Hz] and priority; `NO_TURNS` without a rate."""
        return (self.rate, self.priority) if self.rate > 0.0 else NO_TURNS


@dataclasses.dataclass(frozen=True)
class Schedule:
    """The frame of slots, and what it gives to each pair.

    Slots are numbered from the beginning of the first schedule on, and sweeps of a pair too: a schedule that follows
    another one counts on. It knows nothing of the slots before its own first.
    """

    frame: tuple[int, ...]  # index of the pair that measures in each slot
    slot: float  # duration of a slot [s]
    demands: tuple[Demand, ...]
    start: int = 0  # number of its first slot
    done: tuple[int, ...] = ()  # sweeps of each pair before it; empty: none

    @functools.cached_property
    def counts(self) -> tuple[int, ...]:
        """Slots of each pair in a frame."""
        return tuple(self.frame.count(pair) for pair in range(len(self.demands)))

    @functools.cached_property
    def _before(self) -> np.ndarray:
        """Sweeps of each pair before each slot of the first frame, and of the next; shape (pairs, slots + 1)."""
        own = np.array(self.frame)[None, :] == np.arange(len(self.demands))[:, None]
        inside = np.concatenate([np.zeros((len(own), 1), np.int64), np.cumsum(own, axis=1)], axis=1)
        return inside + np.array(self.done or [0] * len(own), np.int64)[:, None]

    def _place(self, number: np.ndarray | int) -> tuple[np.ndarray, np.ndarray]:
        """Return how many whole frames lie before slot `number`, and its place in its own."""
        return np.divmod(np.asarray(number, dtype=np.int64) - self.start, len(self.frame))

    def pair(self, number: np.ndarray) -> np.ndarray:
        """Return the pair that measures in slot `number`."""
        return np.array(self.frame)[self._place(number)[1]]

    def before(self, pair: int, number: np.ndarray | int) -> np.ndarray:
        """Return how many slots a pair had before slot `number`: in its own slots, the number of its sweep."""
        frames, position = self._place(number)
        return frames * self.counts[pair] + self._before[pair][position]

    def in_whole_frames(self, pair: int, number: np.ndarray | int) -> np.ndarray:
        """Return how many slots a pair had before the frame to which slot `number` belongs."""
        return self._place(number)[0] * self.counts[pair] + self._before[pair][0]

    def index(self, number: np.ndarray) -> np.ndarray:
        """Return the number of the sweep that a slot is for its own pair."""
        frames, position = self._place(number)
        own = np.array(self.frame)[position]
        return frames * np.array(self.counts)[own] + self._before[own, position]

    def slots_until(self, pair: int, sweeps: int) -> int:
        """Return the number of the slot with which the first frame begins before which a pair has done `sweeps`."""
        missing = sweeps - int(self._before[pair][0])
        return self.start + max(0, math.ceil(missing / self.counts[pair])) * len(self.frame)

    def change(self, number: int) -> int:
        """Return the first slot from `number` on in which another schedule may follow.

        Each pair has had a slot by then, or no slot is over: nobody starves, however often the demands change.
        """
        if number <= self.start:
            return self.start
        return max(number, self.start + 1 + max(self.frame.index(pair) for pair in range(len(self.demands))))

    def followed_by(self, demands: Sequence[Demand], number: int) -> 'Schedule':
        """Return the schedule of other demands of the same pairs, which takes over in slot `number`."""
        done = tuple(int(self.before(pair, number)) for pair in range(len(self.demands)))
        return dataclasses.replace(schedule(demands, self.slot), start=number, done=done)

    def interval(self, pair: int) -> float:
        """Return the mean time between two sweeps of a pair [s]."""
        return self.slot * len(self.frame) / self.counts[pair]

    def rate(self, pair: int) -> float:
        """Return the sweeps per second of a pair [Hz]."""
        return 1.0 / self.interval(pair)

    def grant(self, pair: int) -> Turns:
        """Return the sweeps per second of a pair [Hz], and the priority with which it gets them."""
        return self.rate(pair), self.demands[pair].priority

    def longest_wait(self, pair: int) -> float:
        """Return the longest time between two sweeps of a pair [s]."""
        own = np.flatnonzero(np.array(self.frame) == pair)
        return float(np.diff([*own, own[0] + len(self.frame)]).max()) * self.slot

    def falls_short(self, pair: int) -> bool:
        """Return whether a pair gets fewer sweeps per second than it asks for."""
        return falls_short(self.rate(pair), self.demands[pair].rate)


def falls_short(granted: float, asked: float) -> bool:
    """Return whether a rate is less than the one asked for, by more than a frame's resolution; never less than NaN."""
    return granted < asked * (1.0 - 1.0 / _LONGEST_FRAME)


def schedule(demands: Sequence[Demand], slot: float) -> Schedule:
    """Return the schedule that grants each pair its rate, in order of priority.

    Pairs without a rate share what is left alike; what is left after that goes to all in proportion. Without any rate
    the pairs take turns. Slots of a pair are spread over the frame as evenly as they fit.

    Args:
        demands: of each pair.
        slot: time that one measurement takes [s].

    Raises:
        ConfigurationError: there are more pairs than slots of a frame.
    """
    if len(demands) > _LONGEST_FRAME:
        raise ConfigurationError(f'{len(demands)} pairs, at most {_LONGEST_FRAME} can take turns')
    if all(math.isnan(demand.rate) for demand in demands):
        return Schedule(tuple(range(len(demands))), slot, tuple(demands))
    counts = _counts(demands, slot)
    divisor = math.gcd(*counts)
    return Schedule(_spread([count // divisor for count in counts]), slot, tuple(demands))


def _counts(demands: Sequence[Demand], slot: float) -> list[int]:
    """Return the slots of each pair in the longest frame."""
    counts = [1] * len(demands)
    free = _LONGEST_FRAME - len(demands)
    rated = [k for k, demand in enumerate(demands) if not math.isnan(demand.rate)]
    for k in sorted(rated, key=lambda k: (-demands[k].priority, k)):
        wanted = math.ceil(demands[k].rate * slot * _LONGEST_FRAME - 1e-9) - 1
        granted = max(0, min(wanted, free))
        counts[k] += granted
        free -= granted
    others = [k for k, demand in enumerate(demands) if math.isnan(demand.rate)]
    if others:
        for position, k in enumerate(others):
            counts[k] += free // len(others) + (position < free % len(others))
        return counts
    total = sum(counts)
    shares = [free * count // total for count in counts]
    return [count + share for count, share in zip(counts, shares, strict=True)]


def _spread(counts: Sequence[int]) -> tuple[int, ...]:
    """Return a frame in which pair k has counts[k] slots, as evenly as they fit.

    The frame is cut into counts[k] windows of equal length; pair k has one slot in each. Earliest deadline first finds
    such a frame, because one exists (Baruah, Cohen, Plaxton, Varvel 1996: proportionate progress).
    """
    total, done, frame = sum(counts), [0] * len(counts), []
    for slot in range(total):
        released = [k for k, count in enumerate(counts) if done[k] < count and done[k] * total // count <= slot]
        chosen = min(released, key=lambda k: (-(-(done[k] + 1) * total // counts[k]), k))
        done[chosen] += 1
        frame.append(chosen)
    return tuple(frame)
