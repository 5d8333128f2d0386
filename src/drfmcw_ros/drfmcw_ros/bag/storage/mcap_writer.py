"""Writing MCAP files of which every chunk that was flushed can be read, whatever happens afterwards."""

import fcntl
import os
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

from .mcap_records import (
    CHUNK,
    CHUNK_HEAD,
    CHUNK_INDEX,
    CRC_AT,
    DATA_END,
    FOOTER,
    FOOTER_BODY,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    METADATA,
    METADATA_INDEX,
    STATISTICS,
    SUMMARY_OFFSET,
    Channel,
    Schema,
    channel_record,
    checksum,
    mapping,
    record,
    schema_record,
    text,
)

LIBRARY = 'drfmcw'


def _numbers(size: int, *values: int) -> bytes:
    return b''.join(value.to_bytes(size, 'little') for value in values)


class McapWriter:
    """Writes one MCAP file; what `flush` has written stays readable without `close`."""

    def __init__(self, path: Path) -> None:
        """Create the file and lock it, so that a repair sees that it is being written.

        Raises:
            OSError: it exists already, or cannot be written.
        """
        self.path = path
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        fcntl.flock(self._file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        self._position = 0
        self._crc = 0  # of the data section
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._counts: dict[int, int] = {}
        self._first, self._last = 2**64 - 1, 0
        self._chunk_indexes: list[bytes] = []
        self._begin_chunk()
        self._append(MAGIC + record(HEADER, text('ros2') + text(LIBRARY)))

    def _begin_chunk(self) -> None:
        self._chunk = bytearray()
        self._indexes: dict[int, bytearray] = defaultdict(bytearray)  # of the chunk's messages by channel
        self._span = (2**64 - 1, 0)

    @property
    def pending(self) -> int:
        """Bytes that wait for `flush`."""
        return len(self._chunk)

    def add_channel(self, topic: str, schema_name: str, definition: str, metadata: Mapping[str, str]) -> int:
        """Add a topic; return the number of its channel."""
        if schema_name not in self._schemas:
            schema = Schema(len(self._schemas) + 1, schema_name, 'ros2msg', definition.encode())
            self._schemas[schema_name] = schema
            self._chunk += schema_record(schema)
        number = len(self._channels) + 1
        self._channels.append(Channel(number, self._schemas[schema_name].id, topic, 'cdr', dict(metadata)))
        self._chunk += channel_record(self._channels[-1])
        self._counts[number] = 0
        return number

    def write(self, channel: int, time: int, data: bytes | bytearray | memoryview) -> None:
        """Add a message of a time [ns] to the chunk in memory."""
        self._indexes[channel] += _numbers(8, time, len(self._chunk))
        self._chunk += record(MESSAGE, MESSAGE_HEAD.pack(channel, 0, time, time) + bytes(data))
        self._span = (min(time, self._span[0]), max(time, self._span[1]))
        self._counts[channel] += 1

    def flush(self) -> None:
        """Write the chunk; after an error the file is as before, and the chunk waits for the next attempt.

        Raises:
            OSError: the disk is full or gone.
        """
        if not self._chunk:
            return
        first, last = self._span if self._indexes else (0, 0)
        size = len(self._chunk)
        head = CHUNK_HEAD.pack(first, last, size, checksum(self._chunk)) + text('') + _numbers(8, size)
        chunk = record(CHUNK, head + bytes(self._chunk))
        offsets, indexes = b'', b''
        for channel, entries in self._indexes.items():
            offsets += _numbers(2, channel) + _numbers(8, self._position + len(chunk) + len(indexes))
            indexes += record(MESSAGE_INDEX, _numbers(2, channel) + text(bytes(entries)))
        about = _numbers(8, first, last, self._position, len(chunk)) + text(offsets)
        about += _numbers(8, len(indexes)) + text('') + _numbers(8, size, size)
        self._append(chunk + indexes)
        self._chunk_indexes.append(about)
        if self._indexes:
            self._first, self._last = min(first, self._first), max(last, self._last)
        self._begin_chunk()

    def sync(self) -> None:
        """Wait until what was written is on the disk; raises OSError."""
        os.fdatasync(self._file)

    def _append(self, data: bytes) -> None:
        """Write all of `data` or nothing."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._file, rest) :]
        except OSError:
            os.ftruncate(self._file, self._position)
            os.lseek(self._file, self._position, os.SEEK_SET)
            raise
        self._position += len(data)
        self._crc = checksum(data, self._crc)

    def close(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Write what waits, metadata records by name, and the index; then close the file, in any case.

        Raises:
            OSError: the disk is full or gone; all that was flushed stays readable.
        """
        try:
            self.flush()
            index, data = b'', b''
            for name, values in metadata.items():
                body = record(METADATA, text(name) + mapping(values))
                index += record(METADATA_INDEX, _numbers(8, self._position + len(data), len(body)) + text(name))
                data += body
            crc = checksum(data, self._crc)
            data += record(DATA_END, _numbers(4, crc))
            self._append(data + self._summary(self._position + len(data), index, len(metadata)) + MAGIC)
            self.sync()
        finally:
            os.close(self._file)

    def _summary(self, start: int, metadata_index: bytes, metadata_count: int) -> bytes:
        """Return summary and footer that stand at `start` of the file."""
        counts = b''.join(_numbers(2, channel) + _numbers(8, count) for channel, count in self._counts.items())
        statistics = _numbers(8, sum(self._counts.values())) + _numbers(2, len(self._schemas))
        statistics += _numbers(4, len(self._channels), 0, metadata_count, len(self._chunk_indexes))
        span = (self._first, self._last) if sum(self._counts.values()) else (0, 0)
        statistics += _numbers(8, *span) + text(counts)
        groups = (
            (schema_record(self._schemas[name]) for name in self._schemas),
            (channel_record(channel) for channel in self._channels),
            (record(CHUNK_INDEX, about) for about in self._chunk_indexes),
            (metadata_index,),
            (record(STATISTICS, statistics),),
        )
        summary, offsets = b'', b''
        for group in groups:
            joined = b''.join(group)
            if joined:
                offsets += record(SUMMARY_OFFSET, joined[:1] + _numbers(8, start + len(summary), len(joined)))
                summary += joined
        footer = record(FOOTER, FOOTER_BODY.pack(start, start + len(summary), 0))
        summary += offsets + footer[:CRC_AT]
        return summary + _numbers(4, checksum(summary))

    def abort(self) -> None:
        """Close the file as it is."""
        os.close(self._file)
