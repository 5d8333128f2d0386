"""What the live diagnosis of one pair said over time: spans of one level each, in bounded memory."""

import collections
import dataclasses

_SPANS = 2000  # a day of verdicts that change every 43 s
_GAP = 5.0  # without a word, after which a new span begins: five times the usual interval [s]


@dataclasses.dataclass
class Span:
    """A time in which the level stayed the same."""

    begin: float  # wall clock [s]
    end: float
    level: int  # 0 OK, 1 warning, 2 error, 3 stale


class Verdicts:
    """The newest spans of one pair."""

    def __init__(self) -> None:
        """Start with none."""
        self._spans: collections.deque[Span] = collections.deque(maxlen=_SPANS)

    def add(self, level: int, now: float) -> None:
        """Take what is said at `now` (wall clock [s])."""
        newest = self._spans[-1] if self._spans else None
        if newest is None or not newest.end <= now <= newest.end + _GAP:
            self._spans.append(Span(now, now, level))
            return
        newest.end = now
        if newest.level != level:
            self._spans.append(Span(now, now, level))

    def since(self, begin: float) -> list[Span]:
        """Return the spans that end after `begin` (wall clock [s]), in order."""
        return [dataclasses.replace(span) for span in self._spans if span.end > begin]
