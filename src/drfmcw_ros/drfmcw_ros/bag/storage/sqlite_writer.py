"""Writing SQLite databases as rosbag2 does, of which everything that was flushed can be read."""

import sqlite3
from collections.abc import Mapping
from pathlib import Path

from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer


class SqliteWriter:
    """Writes one database; what `flush` has committed stays readable without `close`."""

    def __init__(self, path: Path) -> None:
        """Create the database.

        Raises:
            sqlite3.Error: it cannot be written.
        """
        self.path = path
        # the recorder opens it in one thread and writes in another, never in both at a time
        self._database = sqlite3.connect(path, check_same_thread=False)
        self._database.executescript(Sqlite3Writer.SQLITE_SCHEMA)
        self._types: set[str] = set()
        self._channels = 0
        self._waiting: list[tuple[str, tuple[object, ...]]] = []  # statements of the next transaction
        self.pending = 0  # bytes that wait for `flush`

    def add_channel(self, topic: str, schema_name: str, definition: str, metadata: Mapping[str, str]) -> int:
        """Add a topic; return its number."""
        digest = metadata['topic_type_hash']
        if schema_name not in self._types:
            self._types.add(schema_name)
            columns = '(topic_type, encoding, encoded_message_definition, type_description_hash)'
            values = (schema_name, 'ros2msg', definition, digest)
            self._waiting.append((f'INSERT INTO message_definitions {columns} VALUES(?, ?, ?, ?)', values))
        self._channels += 1
        row = (self._channels, topic, schema_name, 'cdr', metadata['offered_qos_profiles'], digest)
        self._waiting.append(('INSERT INTO topics VALUES(?, ?, ?, ?, ?, ?)', row))
        return self._channels

    def write(self, channel: int, time: int, data: bytes | bytearray | memoryview) -> None:
        """Add a message of a time [ns] to the next transaction."""
        self._waiting.append(
            ('INSERT INTO messages (topic_id, timestamp, data) VALUES(?, ?, ?)', (channel, time, bytes(data)))
        )
        self.pending += len(data) + 1

    def flush(self) -> None:
        """Commit what waits; after an error the database is as before, and all waits for the next attempt.

        Raises:
            sqlite3.Error: the disk is full or gone.
        """
        try:
            for statement, values in self._waiting:
                self._database.execute(statement, values)
            self._database.commit()
        except sqlite3.Error:
            self._database.rollback()
            raise
        self._waiting.clear()
        self.pending = 0

    def sync(self) -> None:
        """Do nothing: SQLite waits for the disk at the end of each transaction."""

    def close(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Write what waits and rosbag2's metadata; close the database in any case.

        Raises:
            sqlite3.Error: the disk is full or gone; all that was flushed stays readable.
        """
        try:
            self.flush()
            stated = metadata['rosbag2']['serialized_metadata']
            self._database.execute('INSERT INTO metadata(metadata_version, metadata) VALUES(9, ?)', (stated,))
            self._database.commit()
        finally:
            self._database.close()

    def abort(self) -> None:
        """Close the database as it is."""
        self._database.close()
