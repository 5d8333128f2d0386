"""Storage files of a recording: MCAP and SQLite, alone or compressed, read in the same way."""

import contextlib
import dataclasses
import shutil
import sqlite3
import tempfile
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Protocol

from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from . import mcap_reader
from .compression import decompress_file, decompressed_message
from .mcap_reader import Damage

SUFFIXES = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd')
"""Endings of storage files."""

RECORD, CHECKSUM = 'drfmcw', 'metadata_yaml_crc32'
"""Name and key of the MCAP metadata that hold the checksum of metadata.yaml."""


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic as a storage file holds it."""

    name: str
    type: str
    definition: str
    digest: str  # RIHS01, '' where it is not stated
    count: int  # of messages
    qos: str  # offered profiles as YAML


class StorageFile(Protocol):
    """One storage file, open for reading."""

    path: Path
    topics: list[Topic]
    span: tuple[int, int] | None  # times of first and last message [ns], None without a message
    damages: list[Damage]
    unfinished: str  # what is missing at the file's end, '' where nothing is
    checksums: bool  # every message stands under one
    metadata_checksum: str  # of the metadata.yaml that was written with it, '' where it is not stated

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time [ns], serialised message) in order of time; raises ValueError or the parser's error."""


def open_storage(path: Path, cleanup: contextlib.ExitStack) -> StorageFile:
    """Open a storage file; a compressed one is decompressed into a temporary directory first.

    Args:
        path: of the file, with one of `SUFFIXES`.
        cleanup: removes what was made, and closes the file.

    Raises:
        ValueError: it is no such file.
        OSError: it cannot be read.
    """
    cut = ''
    opened = path
    if path.suffix == '.zstd':
        directory = Path(cleanup.enter_context(tempfile.TemporaryDirectory(prefix='drfmcw-')))
        opened = directory / path.stem
        if not decompress_file(path, opened):
            cut = 'the compressed file is cut off or damaged'
    if opened.suffix == '.mcap':
        found: StorageFile = McapFile(path, opened)
    elif opened.suffix == '.db3':
        found = SqliteFile(path, opened, cleanup)
    else:
        raise ValueError(f'neither {" nor ".join(SUFFIXES)}')
    found.unfinished = '; '.join(text for text in (cut, found.unfinished) if text)
    return found


class McapFile:
    """An MCAP file."""

    def __init__(self, path: Path, opened: Path) -> None:
        """Scan the file.

        Args:
            path: that the recording has.
            opened: where it is read, another one for a compressed file.
        """
        self.path, self._opened = path, opened
        self._contents = contents = mcap_reader.scan(opened)
        counts = contents.counts
        self.damages = list(contents.damages)
        self.topics = []
        self._channels: dict[int, str] = {}
        for channel in contents.channels.values():
            schema = contents.schemas.get(channel.schema)
            if schema is None or channel.encoding != 'cdr':
                continue
            self._channels[channel.id] = channel.topic
            definition = schema.data.decode(errors='replace') if schema.encoding == 'ros2msg' else ''
            digest = channel.metadata.get('topic_type_hash', '')
            qos = channel.metadata.get('offered_qos_profiles', '')
            self.topics.append(Topic(channel.topic, schema.name, definition, digest, counts[channel.id], qos))
        for unknown in sorted(counts.keys() - contents.channels.keys()):
            self.damages.append(Damage(0, 0, f'{counts[unknown]} messages are of a channel that is not described'))
        spans = [part.span for part in contents.parts if part.counts]
        self.span = (min(s[0] for s in spans), max(s[1] for s in spans)) if spans else None
        self.checksums = contents.verified
        self.metadata_checksum = contents.metadata.get(RECORD, {}).get(CHECKSUM, '')
        self.unfinished = ''
        if not contents.finished:
            rest = contents.size - contents.whole
            self.unfinished = f'its end is missing: {contents.whole} of {contents.size} bytes are whole'
            self.unfinished += f', {rest} are not' if rest else ''

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time [ns], serialised message) in order of time."""
        chosen = {number for number, topic in self._channels.items() if topic in topics}
        for channel, time, data in mcap_reader.messages(self._opened, self._contents, chosen):
            yield self._channels[channel], time, decompressed_message(data)


class SqliteFile:
    """A SQLite database; it has no checksums, only the structure of its pages is checked."""

    checksums = False
    metadata_checksum = ''

    def __init__(self, path: Path, opened: Path, cleanup: contextlib.ExitStack) -> None:
        """Open the database; one whose last transaction was cut off is read as it was before that."""
        self.path = path
        self.unfinished = ''
        self.damages: list[Damage] = []
        if any(opened.with_name(opened.name + suffix).exists() for suffix in ('-journal', '-wal')):
            opened = _rolled_back(opened, cleanup)
            self.unfinished = 'its last transaction is missing'
        _check(opened)
        self._reader = Sqlite3Reader(opened)
        self._reader.open()
        cleanup.callback(self._reader.close)
        self.topics = [
            Topic(c.topic, c.msgtype, c.msgdef.data, c.digest, c.msgcount, '') for c in self._reader.connections
        ]
        about = self._reader.metadata
        self.span = (about.start_time, about.end_time - 1) if about.message_count else None

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time [ns], serialised message) in order of time."""
        chosen = [c for c in self._reader.connections if c.topic in topics]
        for connection, time, data in self._reader.messages(chosen):
            yield connection.topic, time, decompressed_message(bytes(data))


def _rolled_back(path: Path, cleanup: contextlib.ExitStack) -> Path:
    """Return a copy of a database in which SQLite has undone an unfinished transaction."""
    directory = Path(cleanup.enter_context(tempfile.TemporaryDirectory(prefix='drfmcw-')))
    for suffix in ('', '-journal', '-wal'):
        file = path.with_name(path.name + suffix)
        if file.exists():
            shutil.copyfile(file, directory / file.name)
    copy = directory / path.name
    with contextlib.closing(sqlite3.connect(copy)) as database:
        database.execute('PRAGMA journal_mode=DELETE')
        database.execute('SELECT count(*) FROM sqlite_master')
    return copy


def _check(path: Path) -> None:
    """Raise ValueError where the pages of a database do not fit together."""
    try:
        uri = f'{path.resolve().as_uri()}?mode=ro&immutable=1'
        with contextlib.closing(sqlite3.connect(uri, uri=True)) as database:
            [said] = database.execute('PRAGMA quick_check(1)').fetchone()
    except sqlite3.Error as error:
        raise ValueError(str(error)) from None
    if said != 'ok':
        raise ValueError(' '.join(str(said).split()))
