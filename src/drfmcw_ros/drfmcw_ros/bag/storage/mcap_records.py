"""Records of the MCAP format (mcap.dev/spec) as rosbag2 uses them: numbers, strings, opcodes, checksums."""

import dataclasses
import mmap
import struct
import zlib
from collections.abc import Iterator, Mapping

Buffer = bytes | bytearray | memoryview | mmap.mmap

MAGIC = b'\x89MCAP0\r\n'
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)

RECORD = struct.Struct('<BQ')  # opcode, length of what follows
MESSAGE_HEAD = struct.Struct('<HIQQ')  # channel, sequence, time of logging and of publishing [ns]
CHUNK_HEAD = struct.Struct('<QQQI')  # first and last time [ns], uncompressed length, CRC-32 of the uncompressed records
FOOTER_BODY = struct.Struct('<QQI')  # positions of summary and of summary offsets, CRC-32 from the summary on
FOOTER_LENGTH = RECORD.size + FOOTER_BODY.size
CRC_AT = FOOTER_LENGTH - 4  # of the summary's CRC in the footer record, which it covers up to itself


@dataclasses.dataclass(frozen=True)
class Schema:
    """Definition of a message type."""

    id: int
    name: str
    encoding: str
    data: bytes


@dataclasses.dataclass(frozen=True)
class Channel:
    """A topic of one type."""

    id: int
    schema: int
    topic: str
    encoding: str
    metadata: dict[str, str]


class Cursor:
    """Reads numbers and strings from a record's body, one after the other; raises ValueError beyond its end."""

    def __init__(self, body: Buffer) -> None:
        """Start at the body's begin."""
        self._body = memoryview(body)
        self.position = 0

    def take(self, count: int) -> bytes:
        """Return the next `count` bytes."""
        end = self.position + count
        if end > len(self._body):
            raise ValueError('a record ends too early')
        taken, self.position = bytes(self._body[self.position : end]), end
        return taken

    def __len__(self) -> int:
        """Return the length of the whole body [bytes]."""
        return len(self._body)

    def number(self, size: int) -> int:
        """Return the next unsigned number of `size` bytes."""
        return int.from_bytes(self.take(size), 'little')

    def text(self) -> str:
        """Return the next string."""
        return self.take(self.number(4)).decode()

    def mapping(self) -> dict[str, str]:
        """Return the next map of strings."""
        end = self.number(4) + self.position
        found = {}
        while self.position < end:
            key = self.text()
            found[key] = self.text()
        return found


def text(value: str | bytes) -> bytes:
    """Return a string, or bytes with a length of 32 bits, as MCAP writes it."""
    data = value.encode() if isinstance(value, str) else value
    return len(data).to_bytes(4, 'little') + data


def mapping(values: Mapping[str, str]) -> bytes:
    """Return a map of strings."""
    return text(b''.join(text(key) + text(value) for key, value in values.items()))


def record(opcode: int, body: bytes) -> bytes:
    """Return a whole record."""
    return RECORD.pack(opcode, len(body)) + body


def schema_record(schema: Schema) -> bytes:
    """Return the record of a schema."""
    return record(
        SCHEMA, schema.id.to_bytes(2, 'little') + text(schema.name) + text(schema.encoding) + text(schema.data)
    )


def channel_record(channel: Channel) -> bytes:
    """Return the record of a channel."""
    ids = channel.id.to_bytes(2, 'little') + channel.schema.to_bytes(2, 'little')
    return record(CHANNEL, ids + text(channel.topic) + text(channel.encoding) + mapping(channel.metadata))


def read_schema(body: Buffer) -> Schema:
    """Return the schema of a record's body; raises ValueError where it is none."""
    cursor = Cursor(body)
    number, name, encoding = cursor.number(2), cursor.text(), cursor.text()
    return Schema(number, name, encoding, cursor.take(cursor.number(4)))


def read_channel(body: Buffer) -> Channel:
    """Return the channel of a record's body; raises ValueError where it is none."""
    cursor = Cursor(body)
    return Channel(cursor.number(2), cursor.number(2), cursor.text(), cursor.text(), cursor.mapping())


def records(data: Buffer, start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, begin, end of the body) of the records in data[start:end].

    Raises:
        ValueError: a record has an unknown opcode or reaches beyond `end`.
    """
    position = start
    while position < end:
        if position + RECORD.size > end:
            raise ValueError('a record is cut off')
        opcode, length = RECORD.unpack_from(data, position)
        body = position + RECORD.size
        if not 0 < opcode <= DATA_END:  # private records are allowed, but rosbag2 writes none
            raise ValueError(f'unknown kind of record {opcode}')
        if body + length > end:
            raise ValueError('a record is cut off')
        yield opcode, body, body + length
        position = body + length


def checksum(data: Buffer, before: int = 0) -> int:
    """Return the CRC-32 of data, going on from that of what stands before it."""
    return zlib.crc32(data, before)
