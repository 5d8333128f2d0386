"""Reading rosbag2 recordings (mcap, sqlite3) without a ROS graph; writing them stands in `writing`."""

import contextlib
import contextvars
import dataclasses
import functools
import heapq
import logging
import operator
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat

from drfmcw_physics.settings import nearest

from . import metadata
from .definitions import BagError, Converter, UnwritableError, converter, reason, typestore
from .storage.mcap_reader import Damage
from .storage.reading import SUFFIXES, StorageFile, Topic, open_storage
from .writing import STORAGES, BagWriter

__all__ = ['SKIP_DAMAGED', 'STORAGES', 'BagError', 'BagReader', 'BagWriter', 'UnwritableError', 'typestore']

SKIP_DAMAGED: contextvars.ContextVar[bool] = contextvars.ContextVar('skip_damaged', default=False)
"""Whether a damaged recording is read without its damaged parts; else it is refused."""

_DAMAGES_SHOWN = 3
_LOG = logging.getLogger('drfmcw')


@functools.lru_cache(256)
def _note(text: str) -> None:
    """Say something about a recording on stderr, once in a process."""
    _LOG.warning('note: %s', text)


@dataclasses.dataclass
class _Undecodable:
    """Messages of a topic that are cut off, or not what their definition says."""

    first: int  # time [ns]
    reason: str
    count: int = 0


class BagReader:
    """Reads one rosbag2 recording: a directory with or without metadata.yaml, or a single storage file.

    A file whose end is missing is read as far as it is whole. A damaged one is refused, or read without the damaged
    parts. Either is said on stderr.
    """

    def __init__(self, path: Path | str, skip_damaged: bool | None = None) -> None:
        """Open the recording and verify its checksums.

        Args:
            path: of the recording.
            skip_damaged: read what is not damaged; None takes `SKIP_DAMAGED`.

        Raises:
            BagError: missing, damaged or no recording.
        """
        self.path = Path(path)
        if not self.path.exists():
            raise BagError(f'{path}: no such recording')
        self._skip = skip = SKIP_DAMAGED.get() if skip_damaged is None else skip_damaged
        self._left_out: set[str] = set()  # topics of which it is said which messages cannot be decoded
        self._cleanup = contextlib.ExitStack()
        self._files: list[StorageFile] = []
        self.damages: list[str] = []
        """One line for each damaged part."""
        self.remarks: list[str] = []
        """One line for each thing that is odd, but changes nothing that is read."""
        try:
            summary = self._open(skip)
        except BagError:
            self._cleanup.close()
            raise
        self._name_topics(summary)
        for text in (*self.unfinished, *self.remarks):
            _note(text)
        self._report(skip)
        self._converters: dict[str, Converter | None] = {}

    def _open(self, skip: bool) -> metadata.Summary | None:
        """Open the storage files; return what metadata.yaml says, None where there is none."""
        summary, paths = None, [self.path]
        if self.path.is_dir():
            listed = self.path / metadata.NAME
            if listed.exists():
                summary = self._metadata(listed, skip)
            paths = _storage_files(self.path) if summary is None else [self.path / name for name in summary.files]
        for file in paths:
            try:
                self._files.append(open_storage(file, self._cleanup))
            except FileNotFoundError:
                if not skip:
                    raise BagError(f'{self.path}: {file.name}, which metadata.yaml names, is missing') from None
                self.damages.append(f'{self.path}: {file.name}, which metadata.yaml names, is missing')
            except Exception as error:  # damage shows wherever the storage's parser, decompressor or database meets it
                raise BagError(f'{file}: truncated, damaged or no rosbag2 recording ({reason(error)})') from None
        if summary is not None and not summary.open and not any(f.unfinished or f.damages for f in self._files):
            differs = metadata.contradiction(summary, self._files)
            written = {file.metadata_checksum for file in self._files}
            if differs:
                self.damages.append(f'{self.path / metadata.NAME}: differs from the messages: {differs}')
            elif written - {'', metadata.checksum_of(self.path / metadata.NAME)}:
                self.remarks.append(f'{self.path / metadata.NAME}: changed since it was written with the recording')
        return summary

    def _metadata(self, path: Path, skip: bool) -> metadata.Summary | None:
        try:
            return metadata.load(path)
        except (ValueError, OSError) as error:
            if not skip:
                raise BagError(f'{path}: damaged or no rosbag2 recording ({reason(error)})') from None
            self.damages.append(f'{path}: damaged ({reason(error)})')
            return None

    def _name_topics(self, summary: metadata.Summary | None) -> None:
        """Make one connection of each topic, from storage files and metadata.yaml."""
        found: dict[str, Topic] = {}
        counts: dict[str, int] = {}
        for topic in (topic for file in self._files for topic in file.topics):
            found.setdefault(topic.name, topic)
            counts[topic.name] = counts.get(topic.name, 0) + topic.count
        for name, topic in summary.topics.items() if summary else ():
            found.setdefault(name, topic)
        self.connections: list[Connection] = []
        """Topics with their types, message counts and QoS profiles."""
        for name, topic in found.items():
            stated = summary.topics.get(name) if summary else None
            kind = MessageDefinitionFormat.MSG if topic.definition else MessageDefinitionFormat.NONE
            self.connections.append(
                Connection(
                    id=len(self.connections) + 1,
                    topic=name,
                    msgtype=topic.type,
                    msgdef=MessageDefinition(kind, topic.definition),
                    digest=topic.digest or (stated.digest if stated else ''),
                    msgcount=counts.get(name, 0),
                    ext=ConnectionExtRosbag2('cdr', summary.qos[name] if stated and summary else []),
                    owner=self,
                )
            )
        spans = [file.span for file in self._files if file.span]
        self.start_time = min((span[0] for span in spans), default=0)
        """Time of the first message [ns]."""
        self.end_time = max((span[1] + 1 for span in spans), default=0)
        """Time after the last message [ns]."""
        self.message_count = sum(counts.values())
        """Number of messages."""

    def _report(self, skip: bool) -> None:
        """Refuse a damaged recording, or say what is left out."""
        for file in self._files:
            self.damages += [self._described(file.path, damage) for damage in file.damages]
        if not self.damages:
            return
        more = f' (and {len(self.damages) - 1} more)' if len(self.damages) > 1 else ''
        if not skip:
            self.close()
            raise BagError(f'{self.damages[0]}{more}; --skip-damaged reads the rest')
        for text in self.damages[:_DAMAGES_SHOWN]:
            _note(text)
        if len(self.damages) > _DAMAGES_SHOWN:
            _note(f'{self.path}: {len(self.damages) - _DAMAGES_SHOWN} more damaged parts')

    def _described(self, file: Path, damage: Damage) -> str:
        where = f'{file}: damaged at byte {damage.position}'
        where += f' to {damage.position + damage.length}' if damage.length else ''
        text = f'{where}: {damage.what}'
        if damage.topics:
            text += f'; messages on {", ".join(damage.topics)}'
        if damage.span:
            begin, end = ((time - self.start_time) * 1e-9 for time in damage.span)
            text += f' from {begin:.3f} s to {end:.3f} s after the start'
        return text

    @property
    def unfinished(self) -> list[str]:
        """One line for each storage file whose end is missing."""
        return [
            f'{f.path}: {f.unfinished}; {sum(t.count for t in f.topics)} messages'
            + (f' over {(f.span[1] - f.span[0]) * 1e-9:.3f} s' if f.span else '')
            for f in self._files
            if f.unfinished
        ]

    @property
    def checksums(self) -> bool:
        """Return whether every message stands under a checksum."""
        return bool(self._files) and all(file.checksums for file in self._files)

    def close(self) -> None:
        """Close the recording."""
        self._cleanup.close()

    def __enter__(self) -> 'BagReader':
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the recording."""
        self.close()

    @property
    def topics(self) -> dict[str, str]:
        """{topic: type}."""
        return {c.topic: c.msgtype for c in self.connections}

    @property
    def readable(self) -> set[str]:
        """Topics whose messages drfmcw can decode."""
        return {c.topic for c in self.connections if self._is_known(c)} - self.unreadable.keys()

    @property
    def unreadable(self) -> dict[str, str]:
        """{topic: why} of those whose type drfmcw knows by another definition, which is no older one of its own."""
        found = {}
        for connection in filter(self._is_known, self.connections):
            try:
                self._converter(connection)
            except BagError as error:
                found[connection.topic] = str(error)
        return found

    @property
    def older(self) -> dict[str, list[str]]:
        """{type: fields that it lacks} of types that were recorded by an older definition of ours."""
        readable = self.readable
        converters = {c.msgtype: self._converter(c) for c in self.connections if c.topic in readable}
        return {kind: list(change.added) for kind, change in converters.items() if change is not None}

    def require(self, topic: str) -> None:
        """Raise BagError where the recording lacks `topic`, naming the nearest it has."""
        if topic not in self.topics:
            raise BagError(f"{self.path}: topic '{topic}' is missing{nearest(topic, sorted(self.topics))}")

    def _converter(self, connection: Connection) -> Converter | None:
        """Return what makes a topic's messages ours, None for nothing; raises BagError where they cannot be."""
        key = connection.topic
        if key not in self._converters:
            try:
                self._converters[key] = converter(typestore(), connection)
            except ValueError as error:
                raise BagError(f"{self.path}: topic '{connection.topic}': {reason(error)}") from None
        return self._converters[key]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time [ns], message) in order of time; messages have the fields of the ROS messages.

        Args:
            topics: only these; None yields all whose type is known.

        Raises:
            BagError: truncated, corrupt, or a message definition that is not ours or an older one of it; unless damaged
                parts are skipped, also a message that cannot be decoded. Those left out are said at the end.
        """
        for topic, time, _, _, message in self._decoded(topics, deserialise=True):
            yield topic, time, message

    def raw_messages(
        self, topics: Collection[str] | None = None, whole: bool = False
    ) -> Iterator[tuple[str, int, str, bytes]]:
        """Yield (topic, time [ns], type, message serialised in our definition) in order of time.

        Arguments and errors as `messages`; with `whole`, messages that cannot be decoded are treated as there.
        """
        for topic, time, msgtype, raw, _ in self._decoded(topics, deserialise=whole):
            yield topic, time, msgtype, raw

    def _decoded(self, topics: Collection[str] | None, deserialise: bool) -> Iterator[tuple[str, int, str, bytes, Any]]:
        """Yield (topic, time [ns], type, serialised in our definition, message); None for one that is not asked for."""
        store = typestore()
        chosen = [c for c in self.connections if (c.topic in topics if topics is not None else self._is_known(c))]
        convert = {c.topic: self._converter(c) for c in chosen}
        types = {c.topic: c.msgtype for c in chosen}
        failed: dict[str, _Undecodable] = {}
        for topic, time, raw in self.stored_messages(types.keys()):
            change = convert[topic]
            message = None
            try:
                if change is not None:
                    raw = change(raw)
                if deserialise:
                    message = store.deserialize_cdr(raw, types[topic])
            except Exception as error:  # rosbags raises what its parser meets
                found = failed.setdefault(topic, _Undecodable(time, reason(error)))
                found.count += 1
                if not self._skip:
                    raise BagError(f'{self._left_out_line(topic, found)}; --skip-damaged reads the rest') from None
                continue
            yield topic, time, types[topic], raw, message
        for topic, found in failed.items():
            if topic not in self._left_out:
                self._left_out.add(topic)
                self.damages.append(self._left_out_line(topic, found))
                _note(self.damages[-1])

    def _left_out_line(self, topic: str, found: _Undecodable) -> str:
        [total] = [c.msgcount for c in self.connections if c.topic == topic]
        which = f'{found.count} of {total} messages' if self._skip else 'message'
        begin = (found.first - self.start_time) * 1e-9
        where = f'the first one {begin:.3f} s after the start' if self._skip else f'{begin:.3f} s after the start'
        return f"{self.path}: topic '{topic}': {which} cannot be decoded, {where} ({found.reason})"

    @staticmethod
    def _is_known(connection: Connection) -> bool:
        return connection.msgtype in typestore().fielddefs

    def stored_messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time [ns], message serialised as it was recorded) in order of time.

        Raises:
            BagError: truncated or corrupt.
        """
        streams = [file.messages(topics) for file in self._files] if topics else []
        try:
            yield from heapq.merge(*streams, key=operator.itemgetter(1))
        except Exception as error:  # as when opening
            raise BagError(f'{self.path}: truncated or corrupt ({reason(error)})') from None


def _storage_files(directory: Path) -> list[Path]:
    """Return the storage files of a recording that has no metadata.yaml, in their order.

    Raises:
        BagError: there is none, or they are several recordings.
    """
    files = sorted(f for f in directory.iterdir() if f.name.endswith(SUFFIXES) and not f.name.startswith('.'))
    numbered = [re.fullmatch(r'(.+)_(\d+)(\.\D+)', f.name) for f in files]
    parts = [(int(match[2]), file) for match, file in zip(numbered, files, strict=True) if match]
    one_name = len(parts) == len(files) and len({(match[1], match[3]) for match in numbered if match}) == 1
    if len(files) != 1 and not one_name:
        raise BagError(f'{directory}: no rosbag2 recording (no metadata.yaml, {len(files)} storage files)')
    return [file for _, file in sorted(parts)] if one_name else files
