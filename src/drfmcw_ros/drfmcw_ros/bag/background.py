"""Writing a recording in a thread of its own, so that neither a slow nor a full disk stops whoever records."""

import collections
import dataclasses
import threading
import time

from .files import BagWriter, UnwritableError

FLUSH_PERIOD = 0.4  # after which everything is on the disk, if that is fast enough [s]
_CHUNK_SIZE = 1 << 20  # of messages, after which they are written before that [bytes]
_WAITING_LIMIT = 256 << 20  # of messages in memory, beyond which new ones are lost [bytes]
_SLOW = 2.0  # seconds without a finished flush after which the disk is called slow


@dataclasses.dataclass(frozen=True)
class State:
    """How the writing goes."""

    written: int  # messages on the disk
    waiting: int  # bytes in memory
    lost: int  # messages that found no room in memory
    trouble: str  # why nothing can be written just now, '' where it can
    delay: float  # age of the last finished flush [s]

    @property
    def slow(self) -> bool:
        """Return whether the disk does not keep up."""
        return self.delay > _SLOW


class BackgroundWriter:
    """Takes messages at once and writes them soon; goes on trying while the disk is full."""

    def __init__(self, writer: BagWriter, limit: int = _WAITING_LIMIT) -> None:
        """Start the thread.

        Args:
            writer: of a recording that stands from the start; only the thread uses it from here on.
            limit: of the messages that wait in memory [bytes].
        """
        self._writer, self._limit = writer, limit
        self._queue: collections.deque[tuple[str, str, int, bytes | None]] = collections.deque()
        self._queued = 0  # bytes
        self._changed = threading.Condition()
        self._closing = False
        self._written = self._lost = 0
        self._trouble = ''
        self._flushed = time.monotonic()
        self._thread = threading.Thread(target=self._work, name='recorder', daemon=True)
        self._thread.start()

    def add_topic(self, topic: str, kind: str) -> None:
        """Register a topic."""
        with self._changed:
            self._queue.append((topic, kind, 0, None))

    def put(self, topic: str, kind: str, stamp: int, raw: bytes) -> None:
        """Take one serialised message of a time [ns]; it is lost, and counted, where memory is full."""
        with self._changed:
            if self._queued + self._writer.pending + len(raw) > self._limit:
                self._lost += 1
                return
            self._queue.append((topic, kind, stamp, raw))
            self._queued += len(raw)
            if self._queued > _CHUNK_SIZE:
                self._changed.notify()

    def state(self) -> State:
        """Return how the writing goes."""
        with self._changed:
            waiting, delay = self._queued + self._writer.pending, time.monotonic() - self._flushed
            return State(self._written, waiting, self._lost, self._trouble, delay)

    def close(self) -> int:
        """Write what waits and complete the recording; return how many messages it does not hold.

        Raises:
            UnwritableError: the disk is full or gone; what was flushed stays readable.
        """
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()
        self._drain()
        self._writer.close()
        self._written = self._writer.message_count
        return self._lost

    def _work(self) -> None:
        while not self._closing:
            with self._changed:
                self._changed.wait_for(lambda: self._closing or self._ready(), FLUSH_PERIOD)
            try:
                self._drain()
                self._writer.flush()
            except UnwritableError as error:
                self._trouble = str(error)
                time.sleep(FLUSH_PERIOD)
                continue
            self._trouble, self._flushed = '', time.monotonic()
            self._written = self._writer.message_count

    def _ready(self) -> bool:
        return self._queued > _CHUNK_SIZE and not self._trouble

    def _drain(self) -> None:
        """Hand what waits to the writer, flushing chunk by chunk; raises UnwritableError."""
        while True:
            if self._writer.pending > _CHUNK_SIZE:
                self._writer.flush()
            with self._changed:
                if not self._queue:
                    return
                topic, kind, stamp, raw = self._queue.popleft()
                self._queued -= len(raw or b'')
            if raw is None:
                self._writer.add_topic(topic, kind)
            else:
                self._writer.write(topic, kind, stamp, raw)
