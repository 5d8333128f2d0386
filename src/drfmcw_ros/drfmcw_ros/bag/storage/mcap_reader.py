"""Reading MCAP files, whole, without their end, or damaged: every record is looked at and every checksum verified."""

import collections
import dataclasses
import heapq
import mmap
from collections.abc import Collection, Iterator
from pathlib import Path

from .compression import decompressed_chunk
from .mcap_records import (
    ATTACHMENT,
    ATTACHMENT_INDEX,
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    CHUNK_INDEX,
    CRC_AT,
    DATA_END,
    FOOTER,
    FOOTER_BODY,
    FOOTER_LENGTH,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    METADATA,
    RECORD,
    SCHEMA,
    Channel,
    Cursor,
    Schema,
    checksum,
    read_channel,
    read_schema,
    records,
)

_PART_SIZE = 1 << 20  # of messages outside of chunks [bytes]
_Index = dict[int, list[tuple[int, int]]]  # (time [ns], position in the chunk) of messages, by channel


class McapError(ValueError):
    """A file that is no MCAP file at all."""


@dataclasses.dataclass(frozen=True)
class Damage:
    """A part of a file that is not as it was written."""

    position: int  # in the file [bytes]
    length: int  # [bytes]
    what: str
    topics: tuple[str, ...] = ()  # whose messages it holds, as far as known
    span: tuple[int, int] | None = None  # times of the messages [ns]


@dataclasses.dataclass(frozen=True)
class Part:
    """A chunk, or messages outside of chunks that follow each other."""

    position: int  # of the record, or of the first one [bytes]
    end: int
    body: int  # where its records begin
    size: int  # of the records without compression [bytes]
    compression: str | None  # None: outside of chunks
    span: tuple[int, int]  # times of its messages [ns]
    counts: dict[int, int]  # messages by channel


@dataclasses.dataclass
class Contents:
    """What a scan of a file found."""

    size: int  # of the file [bytes]
    schemas: dict[int, Schema] = dataclasses.field(default_factory=dict)
    channels: dict[int, Channel] = dataclasses.field(default_factory=dict)
    parts: list[Part] = dataclasses.field(default_factory=list)
    metadata: dict[str, dict[str, str]] = dataclasses.field(default_factory=dict)
    damages: list[Damage] = dataclasses.field(default_factory=list)
    whole: int = 0  # position up to which the records of an unfinished file are whole [bytes]
    finished: bool = False  # ends with index and magic
    verified: bool = True  # every message stands under a checksum

    @property
    def counts(self) -> collections.Counter[int]:
        """Number of messages by channel."""
        total: collections.Counter[int] = collections.Counter()
        for part in self.parts:
            total.update(part.counts)
        return total


def scan(path: Path) -> Contents:
    """Look at every record of a file.

    Raises:
        McapError: it does not begin as an MCAP file.
        OSError: it cannot be read.
    """
    with open(path, 'rb') as file:
        size = file.seek(0, 2)
        if size < len(MAGIC):
            raise McapError('no MCAP file' if size else 'the file is empty')
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return _Scan(data).contents()


def messages(path: Path, contents: Contents, channels: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
    """Yield (channel, time [ns], data) of the messages of `channels` in order of time."""
    if not contents.parts:
        return
    waiting: list[tuple[int, int, int, int, bytes]] = []  # time, number of the part, position in it, channel, data
    with open(path, 'rb') as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for number, part in sorted(enumerate(contents.parts), key=lambda item: (item[1].span[0], item[0])):
            if not any(part.counts.get(channel) for channel in channels):
                continue
            while waiting and waiting[0][0] < part.span[0]:
                time, _, _, channel, message = heapq.heappop(waiting)
                yield channel, time, message
            held = _records_of(data, part)
            for opcode, begin, end in records(held, 0, len(held)):
                if opcode != MESSAGE:
                    continue
                channel, _, time, _ = MESSAGE_HEAD.unpack_from(held, begin)
                if channel in channels:
                    message = bytes(held[begin + MESSAGE_HEAD.size : end])
                    heapq.heappush(waiting, (time, number, begin, channel, message))
        while waiting:
            time, _, _, channel, message = heapq.heappop(waiting)
            yield channel, time, message


def _records_of(data: mmap.mmap, part: Part) -> bytes:
    stored = data[part.body : part.end]
    return stored if part.compression is None else decompressed_chunk(stored, part.compression, part.size)


class _Scan:
    """One pass over a file."""

    def __init__(self, data: mmap.mmap) -> None:
        self._data = data
        self._found = Contents(len(data))
        self._chunk: Part | None = None  # the last one, whose message indexes may follow
        self._expected: _Index = {}  # its messages
        self._indexed: _Index = {}  # what its message indexes say
        self._data_end: tuple[int, int] | None = None  # position of the data section's end, its checksum

    def contents(self) -> Contents:
        """Return what the file holds."""
        data, found = self._data, self._found
        limit, trouble = self._summary()
        found.finished = limit is not None
        if data[: len(MAGIC)] != MAGIC:
            if limit is None:
                raise McapError('no MCAP file')
            self._damaged(0, len(MAGIC), 'the file does not begin as an MCAP file')
        found.whole = len(MAGIC)
        end = len(data) if limit is None else limit
        while found.whole < end:
            try:
                self._walk(found.whole, end)
                break
            except ValueError as error:
                resume = self._next_chunk(found.whole)
                if resume is None and not found.finished:
                    break  # what was being written when the file ended
                self._lost(found.whole, resume or end, str(error))
                found.whole = resume or end
        self._compare_index(last=True)
        if found.finished:
            if trouble:
                self._damaged(end, len(data) - end, trouble)
            self._verify_data(end)
        return found

    # --- the end ---

    def _summary(self) -> tuple[int | None, str]:
        """Return (where the summary begins, None where the file has no end; what is wrong with it)."""
        data = self._data
        start = len(data) - len(MAGIC) - FOOTER_LENGTH
        if start < len(MAGIC):
            return None, ''
        has_magic = data[-len(MAGIC) :] == MAGIC
        has_footer = RECORD.unpack_from(data, start) == (FOOTER, FOOTER_BODY.size)
        if not has_magic and not has_footer:
            return None, ''
        summary, _, crc = FOOTER_BODY.unpack_from(data, start + RECORD.size)
        if not has_magic or not has_footer:
            return start, 'the end of the file is not as MCAP demands'
        if summary == 0:
            return start, ''
        if not len(MAGIC) <= summary <= start:
            return start, 'the footer names no index within the file'
        if crc and checksum(data[summary : start + CRC_AT]) != crc:
            before = summary - RECORD.size - 4
            is_summary = before > 0 and RECORD.unpack_from(data, before) == (DATA_END, 4)
            return summary if is_summary else start, 'checksum of the index at the end differs'
        return summary, ''

    def _chunk_indexes(self) -> Iterator[tuple[int, int, int, list[int]]]:
        """Yield (position, first time, last time, channels) of the chunks that the index names."""
        end = len(self._data) - len(MAGIC) - FOOTER_LENGTH
        if not self._found.finished:
            return
        summary = FOOTER_BODY.unpack_from(self._data, end + RECORD.size)[0]
        if not len(MAGIC) <= summary <= end:
            return
        try:
            for opcode, begin, stop in records(self._data, summary, end):
                if opcode == CHUNK_INDEX:
                    cursor = Cursor(self._data[begin:stop])
                    first, last, position, _ = (cursor.number(8) for _ in range(4))
                    offsets = Cursor(cursor.take(cursor.number(4)))
                    channels = [(offsets.number(2), offsets.number(8))[0] for _ in range(len(offsets) // 10)]
                    yield position, first, last, channels
                elif opcode in (SCHEMA, CHANNEL):
                    self._name(opcode, self._data[begin:stop])
        except ValueError:
            return

    def _next_chunk(self, position: int) -> int | None:
        """Return where the first chunk behind a position begins: by the index, else where one can be recognised."""
        if self._found.finished:
            return min((chunk for chunk, *_ in self._chunk_indexes() if chunk > position), default=None)
        while (position := self._data.find(bytes([CHUNK]), position + 1)) >= 0:
            if self._is_chunk(position):
                return position
        return None

    def _is_chunk(self, position: int) -> bool:
        """Return whether the lengths within what stands at a position agree as those of a chunk do."""
        body = position + RECORD.size
        if body + CHUNK_HEAD.size > len(self._data):
            return False
        length = RECORD.unpack_from(self._data, position)[1]
        if not CHUNK_HEAD.size < length <= len(self._data) - body:
            return False
        cursor = Cursor(self._data[body + CHUNK_HEAD.size : body + min(length, CHUNK_HEAD.size + 32)])
        try:
            compression, size = cursor.text(), cursor.number(8)
        except ValueError:
            return False
        return compression in ('', 'zstd', 'lz4') and CHUNK_HEAD.size + cursor.position + size == length

    def _lost(self, position: int, end: int, what: str) -> None:
        """Note records that cannot be separated, with the messages which the index says are among them."""
        among = [entry for entry in self._chunk_indexes() if position <= entry[0] < end]
        channels = {channel for entry in among for channel in entry[3]}
        span = (min(e[1] for e in among), max(e[2] for e in among)) if among else None
        self._damaged(position, end - position, what, channels, span)

    def _verify_data(self, end: int) -> None:
        """Compare chunks with the index, and the checksum of the whole data section where it has one."""
        found = self._found
        known = {part.position for part in found.parts}
        for position, first, last, channels in list(self._chunk_indexes()):
            if position not in known and not any(d.position <= position < d.position + d.length for d in found.damages):
                self._damaged(position, 0, 'the index names a chunk that is not there', channels, (first, last))
        if self._data_end is None:
            if not found.damages:
                self._damaged(end, 0, 'the data section has no end')
        elif self._data_end[1] and not found.damages and checksum(self._data[: self._data_end[0]]) != self._data_end[1]:
            self._damaged(0, end, 'checksum of the file differs, in records outside of the messages')

    # --- the records ---

    def _walk(self, position: int, limit: int) -> None:
        """Take all records of the data section from a position on; raises ValueError where one is not as it must be."""
        for opcode, begin, end in records(self._data, position, limit):
            if opcode != MESSAGE_INDEX:
                self._compare_index()
            if opcode == DATA_END:
                self._data_end = (begin - RECORD.size, _body_of(self._data, begin, end, 4).number(4))
                self._found.whole = end
                return
            self._take(opcode, begin, end)
            self._found.whole = end

    def _take(self, opcode: int, begin: int, end: int) -> None:
        if opcode == CHUNK:
            self._take_chunk(begin, end)
        elif opcode == MESSAGE:
            self._take_message(begin, end)
        elif opcode == MESSAGE_INDEX:
            self._take_index(begin, end)
        elif opcode in (SCHEMA, CHANNEL):
            self._name(opcode, self._data[begin:end])
        elif opcode == METADATA:
            cursor = Cursor(self._data[begin:end])
            name = cursor.text()
            self._found.metadata[name] = cursor.mapping()
        elif opcode == HEADER:
            if Cursor(self._data[begin:end]).text() not in ('ros2', ''):
                self._damaged(begin, end - begin, "the header's profile is not 'ros2'")
        elif opcode not in (ATTACHMENT, ATTACHMENT_INDEX):
            raise ValueError('a record of the index stands among the data')

    def _name(self, opcode: int, body: bytes) -> None:
        """Keep a schema or a channel."""
        if opcode == SCHEMA:
            schema = read_schema(body)
            self._found.schemas.setdefault(schema.id, schema)
        else:
            channel = read_channel(body)
            self._found.channels.setdefault(channel.id, channel)

    def _take_message(self, begin: int, end: int) -> None:
        """Add a message outside of chunks to the part of its neighbours."""
        parts, position = self._found.parts, begin - RECORD.size
        if end - begin < MESSAGE_HEAD.size or (parts and parts[-1].compression is not None):
            raise ValueError('a message stands outside of the chunks')
        channel, _, time, _ = MESSAGE_HEAD.unpack_from(self._data, begin)
        self._found.verified = False
        last = parts[-1] if parts else None
        if last is not None and last.end == position and last.size < _PART_SIZE:
            span = (min(time, last.span[0]), max(time, last.span[1]))
            last.counts[channel] = last.counts.get(channel, 0) + 1
            parts[-1] = dataclasses.replace(last, end=end, size=end - last.body, span=span)
        else:
            parts.append(Part(position, end, position, end - position, None, (time, time), {channel: 1}))

    def _take_chunk(self, begin: int, end: int) -> None:
        """Verify a chunk and count its messages."""
        position = begin - RECORD.size
        self._chunk, self._indexed = None, {}
        if not self._is_chunk(position):
            raise ValueError('the lengths that a chunk states do not agree')
        first, last, size, crc = CHUNK_HEAD.unpack_from(self._data, begin)
        cursor = Cursor(self._data[begin + CHUNK_HEAD.size : end])
        compression, _ = cursor.text(), cursor.number(8)
        body = begin + CHUNK_HEAD.size + cursor.position
        try:
            held = decompressed_chunk(self._data[body:end], compression, size)
            if crc and checksum(held) != crc:
                raise ValueError('checksum of a chunk differs')
            expected = self._messages_of(held)
        except ValueError as error:
            self._lost(position, end, str(error))
            return
        self._found.verified &= bool(crc)
        times = [time for entries in expected.values() for time, _ in entries]
        span = (min(times), max(times)) if times else (0, 0)
        counts = {channel: len(entries) for channel, entries in expected.items()}
        self._chunk, self._expected = Part(position, end, body, size, compression, span, counts), expected
        self._found.parts.append(self._chunk)
        if times and (first, last) != span:
            self._damaged(begin, 16, 'a chunk states other times than its messages have', expected, span)

    def _messages_of(self, held: bytes) -> '_Index':
        """Return the messages of a chunk, and keep its schemas and channels; raises ValueError."""
        found: _Index = {}
        for opcode, begin, end in records(held, 0, len(held)):
            if opcode == MESSAGE:
                if end - begin < MESSAGE_HEAD.size:
                    raise ValueError('a message is too short')
                channel, _, time, _ = MESSAGE_HEAD.unpack_from(held, begin)
                found.setdefault(channel, []).append((time, begin - RECORD.size))
            elif opcode in (SCHEMA, CHANNEL):
                self._name(opcode, held[begin:end])
        return found

    def _take_index(self, begin: int, end: int) -> None:
        """Keep the message index of a channel, which is compared when all of its chunk's are there."""
        cursor = Cursor(self._data[begin:end])
        channel = cursor.number(2)
        entries = Cursor(cursor.take(cursor.number(4)))
        if cursor.position != len(cursor):
            raise ValueError('the length that the index of a chunk states does not agree')
        self._indexed[channel] = [(entries.number(8), entries.number(8)) for _ in range(len(entries) // 16)]

    def _compare_index(self, last: bool = False) -> None:
        """Compare the message indexes behind a chunk with its messages.

        None at all is allowed, and some are missing behind the last chunk of an unfinished file.
        """
        chunk, expected = self._chunk, self._expected
        indexed = {channel: sorted(entries) for channel, entries in self._indexed.items() if entries}
        self._chunk, self._indexed = None, {}
        if chunk is None or not indexed:
            return
        wrong = any(entries != sorted(expected.get(channel, [])) for channel, entries in indexed.items())
        if wrong or (len(indexed) < len(expected) and (self._found.finished or not last)):
            length = self._found.whole - chunk.end
            self._damaged(chunk.end, length, 'the index of a chunk differs from its messages', expected, chunk.span)

    def _damaged(
        self,
        position: int,
        length: int,
        what: str,
        channels: Collection[int] = (),
        span: tuple[int, int] | None = None,
    ) -> None:
        named = sorted(self._found.channels[c].topic for c in channels if c in self._found.channels)
        self._found.damages.append(Damage(position, length, what, tuple(named), span))


def _body_of(data: mmap.mmap, begin: int, end: int, length: int) -> Cursor:
    """Return a record's body, which must have `length` bytes; raises ValueError."""
    if end - begin != length:
        raise ValueError('a record has another length than its kind')
    return Cursor(data[begin:end])
