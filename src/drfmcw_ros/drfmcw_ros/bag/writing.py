"""Writing rosbag2 recordings without a ROS graph."""

import contextlib
import dataclasses
import logging
import os
import shutil
import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

from drfmcw_physics.settings import nearest

from ..graph.topics import is_latched
from . import metadata
from .definitions import BagError, UnwritableError, reason, typestore
from .metadata import ListedFile
from .storage.mcap_writer import McapWriter
from .storage.reading import Topic, open_storage
from .storage.sqlite_writer import SqliteWriter

STORAGES: dict[str, Callable[[Path], McapWriter | SqliteWriter]] = {'mcap': McapWriter, 'sqlite3': SqliteWriter}
"""Writers of the storage formats, by the names rosbag2 uses."""

_SUFFIX = {'mcap': '.mcap', 'sqlite3': '.db3'}
_CHUNK_SIZE = 1 << 20  # after which a writer flushes by itself [bytes]
_FOREVER = QosTime(9223372036, 854775807)
_UNWRITABLE = (OSError, sqlite3.Error)


def _qos(topic: str) -> Qos:
    """Return the QoS profile under which the contract publishes `topic`."""
    latched = is_latched(topic)
    return Qos(
        QosHistory.KEEP_LAST,
        1 if latched else 10,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        _FOREVER,
        _FOREVER,
        QosLiveliness.AUTOMATIC,
        _FOREVER,
        avoid_ros_namespace_conventions=False,
    )


def earlier_files(path: Path) -> list[ListedFile]:
    """Return the storage files of a recording whose recorder died.

    Raises:
        BagError: the recording is complete, or is none.
    """
    try:
        summary = metadata.load(path / metadata.NAME)
    except (ValueError, OSError) as error:
        raise BagError(f'{path}: exists and is no recording, not going on ({reason(error)})') from None
    if not summary.open:
        raise BagError(f'{path}: is complete, not going on')
    found = []
    for name in summary.files:
        with contextlib.ExitStack() as cleanup:
            try:
                file = open_storage(path / name, cleanup)
            except Exception as error:  # cut off in its first bytes, or damaged: it stays, and is skipped
                found.append(ListedFile(name, [], None))
                logging.getLogger('drfmcw').warning('note: %s: %s', path / name, reason(error))
                continue
            found.append(ListedFile(name, file.topics, file.span))
    return found


class BagWriter:
    """Writes one rosbag2 recording.

    As a rule under a temporary name, which is changed when the recording is complete. A recorder's stands under its
    name from the start instead, and can be read up to the last `flush`, whatever ends the process.
    """

    def __init__(
        self,
        path: Path | str,
        storage: str = 'mcap',
        overwrite: bool = False,
        from_the_start: bool = False,
        name: str | None = None,
        resume: bool = False,
    ) -> None:
        """Create the recording.

        Args:
            path: directory of the recording.
            storage: 'mcap' or 'sqlite3'.
            overwrite: replace a recording that exists.
            from_the_start: it stands under its name at once, and is never removed.
            name: of the storage file before its number; None takes the directory's.
            resume: go on, in a further file, with a recording that stood from the start and whose end is missing.

        Raises:
            BagError: it exists already, an unknown storage, or the path cannot be written.
        """
        self.path = Path(path)
        if storage not in STORAGES:
            raise BagError(f"storage '{storage}' is not valid{nearest(storage, list(STORAGES))}")
        self._earlier: list[ListedFile] = []
        if resume and self.path.exists():
            self._earlier = earlier_files(self.path)
        elif self.path.exists():
            if not overwrite:
                raise BagError(f'{path}: exists already, not overwriting')
            if not (self.path / metadata.NAME).exists():
                raise BagError(f'{path}: exists and is no recording, not overwriting')
        self._storage, self._visible = storage, from_the_start
        self._file = f'{name or self.path.name}_{len(self._earlier)}{_SUFFIX[storage]}'  # as rosbag2 names it
        self._directory = self.path if from_the_start else self.path.parent / f'.{self.path.name}.partial-{os.getpid()}'
        try:
            if from_the_start and self.path.exists() and not self._earlier:
                shutil.rmtree(self.path)
            self._directory.mkdir(parents=True, exist_ok=bool(self._earlier))
            self._writer = STORAGES[storage](self._directory / self._file)
        except _UNWRITABLE as error:
            raise BagError(f'{path}: {reason(error)}') from None
        self._channels: dict[str, int] = {}
        self._topics: dict[str, Topic] = {}
        self._counts: dict[str, int] = {}
        self._span: tuple[int, int] | None = None
        self._described = -1  # number of topics in metadata.yaml
        if from_the_start:
            self.flush()

    @property
    def message_count(self) -> int:
        """Number of messages, with those that wait for `flush`."""
        return sum(self._counts.values())

    @property
    def pending(self) -> int:
        """Bytes that wait for `flush`."""
        return self._writer.pending

    def add_topic(self, topic: str, msgtype: str) -> None:
        """Register a topic, so that the recording lists it even without a message."""
        if topic in self._channels:
            return
        definition, _ = typestore().generate_msgdef(msgtype, ros_version=2)
        self._add(topic, msgtype, definition, typestore().hash_rihs01(msgtype), [_qos(topic)])

    def add_recorded(self, connection: Connection) -> None:
        """Register a topic as another recording holds it, with the definition that its messages have there."""
        definition, kind = connection.msgdef.data, connection.msgtype
        if not definition and kind in typestore().fielddefs and connection.digest == typestore().hash_rihs01(kind):
            definition, _ = typestore().generate_msgdef(kind, ros_version=2)
        assert isinstance(connection.ext, ConnectionExtRosbag2)
        self._add(connection.topic, kind, definition, connection.digest, connection.ext.offered_qos_profiles)

    def _add(self, topic: str, msgtype: str, definition: str, digest: str, profiles: Sequence[Qos]) -> None:
        qos = metadata.qos_text(profiles)
        about = {'offered_qos_profiles': qos, 'topic_type_hash': digest}
        self._channels[topic] = self._writer.add_channel(topic, msgtype, definition, about)
        self._topics[topic] = Topic(topic, msgtype, definition, digest, 0, qos)
        self._counts[topic] = 0

    def write(self, topic: str, msgtype: str, time: int, message: Any) -> None:
        """Write one message; flush when enough of them wait, unless the recording stands from the start.

        Args:
            topic: absolute name.
            msgtype: for instance 'drfmcw_msgs/msg/IfSamples'.
            time: of reception or acquisition [ns].
            message: serialised (CDR bytes), or a message object of rosbags.

        Raises:
            BagError: the disk is full or gone.
        """
        self.add_topic(topic, msgtype)
        if not isinstance(message, bytes | bytearray | memoryview):
            message = typestore().serialize_cdr(message, msgtype)
        self._writer.write(self._channels[topic], time, message)
        self._counts[topic] += 1
        self._span = (min(time, self._span[0]), max(time, self._span[1])) if self._span else (time, time)
        if not self._visible and self._writer.pending > _CHUNK_SIZE:
            self.flush()

    def flush(self) -> None:
        """Write what waits to the file, and wait until it is on the disk if the recording stands from the start.

        Raises:
            UnwritableError: the disk is full or gone; what waits goes on waiting.
        """
        try:
            self._writer.flush()
            if self._visible:
                self._writer.sync()
                if self._described != len(self._topics):
                    self._describe(metadata.dump(self._content(recording=True)))
                    self._described = len(self._topics)
        except _UNWRITABLE as error:
            raise UnwritableError(f'{self.path}: {reason(error)}') from None

    def _content(self, recording: bool = False) -> dict[str, Any]:
        """Return the content of metadata.yaml."""
        topics = [dataclasses.replace(t, count=0 if recording else self._counts[t.name]) for t in self._topics.values()]
        own = ListedFile(self._file, topics, None if recording else self._span)
        return metadata.compose(self._storage, [*self._earlier, own], recording)

    def _describe(self, text: str) -> None:
        """Write metadata.yaml."""
        partial = self._directory / f'.{metadata.NAME}'
        partial.write_text(text, encoding='utf-8')
        partial.replace(self._directory / metadata.NAME)

    def close(self) -> None:
        """Complete the recording and give it its name.

        Raises:
            UnwritableError: the disk is full or gone. A recording that stands from the start keeps what was flushed.
        """
        content = self._content()
        text = metadata.dump(content)
        try:
            self._writer.close(metadata.embedded(content, text))
            self._describe(text)
            if not self._visible:
                if self.path.exists():
                    shutil.rmtree(self.path)
                self._directory.rename(self.path)
        except _UNWRITABLE as error:
            raise UnwritableError(f'{self.path}: {reason(error)}') from None
        finally:
            if not self._visible:
                shutil.rmtree(self._directory, ignore_errors=True)

    def abort(self) -> None:
        """Throw away what was written, unless the recording stands from the start."""
        self._writer.abort()
        if not self._visible:
            shutil.rmtree(self._directory, ignore_errors=True)

    def __enter__(self) -> 'BagWriter':
        """Return itself."""
        return self

    def __exit__(self, kind: type | None, *_: object) -> None:
        """Close after success, abort after an exception."""
        if kind is None:
            self.close()
        else:
            self.abort()
