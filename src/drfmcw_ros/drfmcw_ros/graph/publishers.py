"""Noticing that two nodes publish on one topic, by the numbers that the middleware gives to each one's messages.

rclpy does not say who sent a message. But each publisher counts its messages, so those of two publishers are two
sequences. A publisher that died and came back leaves one sequence and begins another; two that live alternate.
"""

import dataclasses
import time

_LARGEST_GAP = 10_000  # of lost messages within a sequence
_TRIAL = 20  # messages of a new sequence without one of the earlier ones, after which it has replaced them
_HOLD = 10.0  # after the last alternation, how long two publishers are assumed [s]


@dataclasses.dataclass
class _Sequence:
    last: int
    count: int = 1


class Publishers:
    """Keeps the sequences of one topic apart, and says whether a message can be trusted."""

    def __init__(self, topic: str) -> None:
        """Start without a message."""
        self.topic = topic
        self._sequences: list[_Sequence] = []  # the one of the last message at the end
        self._alternated = -_HOLD

    @property
    def several(self) -> bool:
        """Return whether two publishers live."""
        return time.monotonic() - self._alternated < _HOLD

    def add(self, number: int) -> None:
        """Take the number of the next message."""
        sequence = self._sequence(number)
        if sequence is None:
            self._sequences = [*self._sequences[-2:], _Sequence(number)]
            return
        sequence.last = number
        sequence.count += 1
        if sequence is not self._sequences[-1]:
            self._alternated = time.monotonic()
            self._sequences.remove(sequence)
            self._sequences.append(sequence)
        if len(self._sequences) > 1 and not self.several and sequence.count >= _TRIAL:
            self._sequences = [sequence]

    def _sequence(self, number: int) -> _Sequence | None:
        """Return the sequence that a number continues: exactly, or with a gap the newest one; None for a new one."""
        exact = [s for s in self._sequences if number == s.last + 1]
        if exact:
            return exact[-1]
        newest = self._sequences[-1] if self._sequences else None
        return newest if newest is not None and 0 < number - newest.last < _LARGEST_GAP else None

    @property
    def doubt(self) -> str:
        """Why the last message cannot be trusted, '' where it can."""
        if self.several:
            return f'two nodes publish on {self.topic}'
        if len(self._sequences) > 1:
            return f'another node publishes on {self.topic}: waiting whether it replaces the earlier one'
        return ''
