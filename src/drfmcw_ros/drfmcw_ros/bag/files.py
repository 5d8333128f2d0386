"""Reading and writing rosbag2 recordings (mcap, sqlite3) without a ROS graph."""

import functools
import os
import shutil
import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from drfmcw_physics.settings import ConfigurationError, nearest

from ..topics import is_latched

STORAGES = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
"""Storage formats by the names rosbag2 uses."""

_FOREVER = QosTime(9223372036, 854775807)
_UNWRITABLE = (OSError, sqlite3.Error)


class BagError(ConfigurationError):
    """A recording that cannot be read or lacks what is needed; the message is one line."""


@functools.cache
def typestore() -> Typestore:
    """Return the message types of Jazzy and of drfmcw_msgs as installed."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted(Path(get_package_share_directory('drfmcw_msgs'), 'msg').glob('*.msg')):
        store.register(get_types_from_msg(path.read_text(encoding='utf-8'), f'drfmcw_msgs/msg/{path.stem}'))
    return store


class BagReader:
    """Reads one rosbag2 recording: a directory with metadata.yaml, or a single .mcap or .db3 file."""

    def __init__(self, path: Path | str) -> None:
        """Open the recording.

        Raises:
            BagError: missing, truncated or no recording.
        """
        self.path = Path(path)
        if not self.path.exists():
            raise BagError(f'{path}: no such recording')
        source = self.path
        if source.is_dir() and not (source / 'metadata.yaml').exists():
            files = [f for f in sorted(source.iterdir()) if f.suffix in ('.mcap', '.db3')]
            if len(files) != 1:
                raise BagError(f'{path}: no rosbag2 recording (no metadata.yaml, {len(files)} storage files)')
            source = files[0]
        try:
            self._reader = Reader(source)
            self._reader.open()
        except Exception as error:  # damage shows wherever the storage's parser, decompressor or database meets it
            raise BagError(f'{path}: truncated, damaged or no rosbag2 recording ({_reason(error)})') from None
        self._checked: set[str] = set()

    def __enter__(self) -> 'BagReader':
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the recording."""
        self._reader.close()

    @property
    def connections(self) -> list[Connection]:
        """Topics with their types, message counts and QoS profiles."""
        return self._reader.connections

    @property
    def topics(self) -> dict[str, str]:
        """{topic: type}."""
        return {c.topic: c.msgtype for c in self._reader.connections}

    @property
    def start_time(self) -> int:
        """Time of the first message [ns]."""
        return self._reader.start_time

    @property
    def end_time(self) -> int:
        """Time of the last message [ns]."""
        return self._reader.end_time

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return self._reader.message_count

    def require(self, topic: str) -> None:
        """Raise BagError where the recording lacks `topic`, naming the nearest it has."""
        if topic not in self.topics:
            raise BagError(f"{self.path}: topic '{topic}' is missing{nearest(topic, sorted(self.topics))}")

    def _check_definition(self, connection: Connection) -> None:
        """Refuse a message type whose definition in the recording differs from ours."""
        if connection.msgtype in self._checked:
            return
        store = typestore()
        where = f"{self.path}: topic '{connection.topic}'"
        if connection.msgtype not in store.fielddefs:
            raise BagError(f'{where}: message type {connection.msgtype} is unknown')
        ours = store.hash_rihs01(connection.msgtype)
        theirs = connection.digest
        if not theirs and connection.msgdef.data:
            try:
                recorded = get_typestore(Stores.EMPTY)
                recorded.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
                theirs = recorded.hash_rihs01(connection.msgtype)
            except Exception as error:  # rosbags raises what its parser meets
                raise BagError(f'{where}: its message definition cannot be read ({_reason(error)})') from None
        if theirs and theirs != ours:
            raise BagError(f'{where}: its definition of {connection.msgtype} differs from the one drfmcw uses')
        self._checked.add(connection.msgtype)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time [ns], message) in order of time; messages have the fields of the ROS messages.

        Args:
            topics: only these; None yields all whose type is known.

        Raises:
            BagError: truncated, corrupt, or a message definition that differs from ours.
        """
        store = typestore()
        for topic, time, msgtype, raw in self.raw_messages(topics):
            try:
                message = store.deserialize_cdr(raw, msgtype)
            except Exception as error:  # rosbags raises what its parser meets
                raise BagError(f"{self.path}: topic '{topic}': message cannot be decoded ({_reason(error)})") from None
            yield topic, time, message

    def raw_messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, int, str, bytes]]:
        """Yield (topic, time [ns], type, serialised message) in order of time; arguments as `messages`."""
        known = typestore().fielddefs
        chosen = [c for c in self.connections if (c.topic in topics if topics is not None else c.msgtype in known)]
        for connection in chosen:
            self._check_definition(connection)
        if not chosen:
            return
        try:
            for connection, time, raw in self._reader.messages(chosen):
                yield connection.topic, time, connection.msgtype, bytes(raw)
        except Exception as error:  # as when opening
            raise BagError(f'{self.path}: truncated or corrupt ({_reason(error)})') from None


def _reason(error: BaseException) -> str:
    text = ' '.join(str(getattr(error, 'strerror', None) or error).split())
    return text if text else type(error).__name__


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


class BagWriter:
    """Writes one rosbag2 recording under a temporary name and renames it when it is complete."""

    def __init__(self, path: Path | str, storage: str = 'mcap', overwrite: bool = False) -> None:
        """Create the recording.

        Args:
            path: directory of the recording.
            storage: 'mcap' or 'sqlite3'.
            overwrite: replace a recording that exists.

        Raises:
            BagError: it exists already, an unknown storage, or the path cannot be written.
        """
        self.path = Path(path)
        if storage not in STORAGES:
            raise BagError(f"storage '{storage}' is not valid{nearest(storage, list(STORAGES))}")
        if self.path.exists():
            if not overwrite:
                raise BagError(f'{path}: exists already, not overwriting')
            if not (self.path / 'metadata.yaml').exists():
                raise BagError(f'{path}: exists and is no recording, not overwriting')
        self._partial = self.path.parent / f'.{self.path.name}.partial-{os.getpid()}'
        try:
            self._partial.mkdir(parents=True)
            self._writer = Writer(self._partial / self.path.name, version=9, storage_plugin=STORAGES[storage])
            self._writer.open()
        except _UNWRITABLE as error:
            raise BagError(f'{path}: {_reason(error)}') from None
        self._connections: dict[str, Connection] = {}
        self.message_count = 0

    def add_topic(self, topic: str, msgtype: str) -> None:
        """Register a topic, so that the recording lists it even without a message."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, msgtype, typestore=typestore(), offered_qos_profiles=[_qos(topic)]
            )

    def write(self, topic: str, msgtype: str, time: int, message: Any) -> None:
        """Write one message.

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
        try:
            self._writer.write(self._connections[topic], time, message)
        except _UNWRITABLE as error:
            raise BagError(f'{self.path}: {_reason(error)}') from None
        self.message_count += 1

    def close(self) -> None:
        """Complete the recording and give it its name."""
        try:
            self._writer.close()
            if self.path.exists():
                shutil.rmtree(self.path)
            (self._partial / self.path.name).rename(self.path)
        except _UNWRITABLE as error:
            raise BagError(f'{self.path}: {_reason(error)}') from None
        finally:
            shutil.rmtree(self._partial, ignore_errors=True)

    def abort(self) -> None:
        """Throw away what was written."""
        self._writer.abort()
        shutil.rmtree(self._partial, ignore_errors=True)

    def __enter__(self) -> 'BagWriter':
        """Return itself."""
        return self

    def __exit__(self, kind: type | None, *_: object) -> None:
        """Close after success, abort after an exception."""
        if kind is None:
            self.close()
        else:
            self.abort()
