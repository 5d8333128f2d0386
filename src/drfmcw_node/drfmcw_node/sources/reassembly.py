"""Pieces of frames put together, in whatever order they come, in a bounded memory (docs/feed_protocol.md)."""

import collections
import dataclasses
import math
from collections.abc import Hashable

from .feed import LARGEST_COUNT, Frame, decode_fragment, decode_whole, frame_size

FRAMES_IN_PROGRESS = 16
"""Unfinished frames of one sender; beyond it the oldest is dropped."""
SENDERS = 64
"""Senders of unfinished frames; beyond it the one that began first is forgotten."""
SMALLEST_PIECE = 512
"""Bytes that the pieces of the largest frame must have on average: their number is limited."""
LONGEST_WAIT = 1.0
"""For the last piece of a frame [s]."""
_REMEMBERED = 256  # complete frames whose pieces may come once more
OVERHEAD = 256
"""Bytes that a piece takes besides its content, in the count that the bound holds for."""


@dataclasses.dataclass
class _Unfinished:
    """Pieces of one frame."""

    count: int
    since: float  # first piece [s]
    pieces: dict[int, bytes] = dataclasses.field(default_factory=dict)
    size: int = 0  # [bytes], with the overhead


class FragmentAssembler:
    """Puts datagrams together to frames.

    All unfinished frames together take `bound` bytes at most, of which `OVERHEAD` per piece is a generous estimate of
    what Python adds. Where they would take more, the oldest frame of the sender that takes most is dropped, so that one
    who sends nothing but beginnings displaces his own.
    """

    def __init__(self, largest_count: int = LARGEST_COUNT) -> None:
        """Start with nothing in progress; `largest_count` is of int16 values in a frame."""
        size = frame_size(largest_count)
        self._largest = -(-size // SMALLEST_PIECE)  # pieces
        self.bound = 2 * (size + self._largest * OVERHEAD)
        """Largest number of bytes in unfinished frames."""
        self._progress: dict[Hashable, collections.OrderedDict[int, _Unfinished]] = {}  # by sender
        self._used: collections.Counter[Hashable] = collections.Counter()  # bytes by sender
        self._complete: collections.OrderedDict[tuple[Hashable, int], float] = collections.OrderedDict()
        self.repeated = 0
        """Pieces of frames that were complete already, since start."""
        self.malformed = 0
        """Datagrams or frames that were damaged, since start."""
        self.incomplete = 0
        """Frames of which a fragment never came, since start."""

    @property
    def held(self) -> int:
        """Bytes in unfinished frames."""
        return self._used.total()

    def feed(self, datagram: bytes, sender: Hashable = None, now: float = 0.0) -> Frame | None:
        """Return the frame that is complete with this datagram, None where there is none.

        Args:
            datagram: as received.
            sender: address; the numbers of different senders' frames have nothing to do with each other.
            now: on any clock that runs on [s].
        """
        self._drop_overdue(now)
        piece = decode_fragment(datagram)
        if piece is None or piece.count > self._largest:
            self.malformed += 1
            return None
        if now - self._complete.get((sender, piece.number), -math.inf) <= LONGEST_WAIT:
            self.repeated += 1
            return None
        frames = self._progress.setdefault(sender, collections.OrderedDict())
        frame = frames.setdefault(piece.number, _Unfinished(piece.count, now))
        if frame.count != piece.count:  # the number stands for another frame by now
            self._drop(sender, piece.number)
            self.incomplete += 1
            frames = self._progress.setdefault(sender, collections.OrderedDict())
            frame = frames.setdefault(piece.number, _Unfinished(piece.count, now))
        if piece.index not in frame.pieces:
            if len(frame.pieces) + 1 < frame.count:
                size = len(piece.content) + OVERHEAD
                if not self._has_room(sender, piece.number, size):
                    return None
                frame.size += size
                self._used[sender] += size
            frame.pieces[piece.index] = piece.content
        if len(frame.pieces) < frame.count:
            return None
        self._drop(sender, piece.number)
        complete = decode_whole(b''.join(frame.pieces[i] for i in range(frame.count)))
        if complete is None:
            self.malformed += 1
            return None
        self._complete[sender, piece.number] = now
        if len(self._complete) > _REMEMBERED:
            self._complete.popitem(last=False)
        return complete

    def _has_room(self, sender: Hashable, number: int, size: int) -> bool:
        """Drop frames until a piece of so many bytes is within the bounds; False if its own frame was one of them.

        Another thread that looks at what is `held` never finds more than the bound.
        """
        if len(self._progress[sender]) > FRAMES_IN_PROGRESS:
            self._drop_oldest(sender)
        while len(self._progress) > SENDERS:
            self._drop_oldest(next(iter(self._progress)))
        while number in self._progress.get(sender, ()) and self.held + size > self.bound:
            self._drop_oldest(max(self._progress, key=lambda each: self._used[each] + size * (each == sender)))
        return number in self._progress.get(sender, ())

    def _drop_overdue(self, now: float) -> None:
        for sender in list(self._progress):
            while sender in self._progress and now - next(iter(self._progress[sender].values())).since > LONGEST_WAIT:
                self._drop_oldest(sender)

    def _drop_oldest(self, sender: Hashable) -> None:
        self._drop(sender, next(iter(self._progress[sender])))
        self.incomplete += 1

    def _drop(self, sender: Hashable, number: int) -> None:
        self._used[sender] -= self._progress[sender].pop(number).size
        if not self._progress[sender]:
            del self._progress[sender], self._used[sender]
