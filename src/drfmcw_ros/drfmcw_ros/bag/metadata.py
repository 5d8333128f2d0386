"""metadata.yaml of a rosbag2 recording: writing it, and comparing it with what the storage files hold."""

import dataclasses
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from .storage.reading import CHECKSUM, RECORD, StorageFile, Topic

NAME = 'metadata.yaml'
_KEY = 'rosbag2_bagfile_information'
_STATE, _RECORDING = 'drfmcw_state', 'recording'  # in custom_data, while a recorder writes
_VERSION = 9
_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


@dataclasses.dataclass(frozen=True)
class Summary:
    """What metadata.yaml says of a recording."""

    files: list[str]
    topics: dict[str, Topic]
    count: int
    span: tuple[int, int] | None  # times of first and last message [ns]
    open: bool  # written when the recording began, and not since
    qos: dict[str, list[Qos]]


def qos_text(profiles: Sequence[Qos]) -> str:
    """Return QoS profiles as the YAML text that storage files hold."""
    return str(yaml.safe_dump(dump_qos_v9(list(profiles)), sort_keys=False)).strip()


@dataclasses.dataclass(frozen=True)
class ListedFile:
    """A storage file as metadata.yaml lists it."""

    name: str
    topics: list[Topic]
    span: tuple[int, int] | None  # times of first and last message [ns], None without a message


def compose(storage: str, files: Sequence[ListedFile], recording: bool = False) -> dict[str, Any]:
    """Return the content of metadata.yaml.

    Args:
        storage: 'mcap' or 'sqlite3'.
        files: of the recording, in their order.
        recording: the last one is still being written; the numbers of its messages are not known.
    """
    counts: dict[str, int] = {}
    topics: dict[str, Topic] = {}
    for topic in (topic for file in files for topic in file.topics):
        counts[topic.name] = counts.get(topic.name, 0) + topic.count
        topics[topic.name] = topic
    listed = [
        {
            'topic_metadata': {
                'name': topic.name,
                'type': topic.type,
                'serialization_format': 'cdr',
                'offered_qos_profiles': yaml.safe_load(topic.qos) or [],
                'type_description_hash': topic.digest,
            },
            'message_count': counts[topic.name],
        }
        for topic in topics.values()
    ]
    spans = [file.span for file in files if file.span]
    span = (min(s[0] for s in spans), max(s[1] for s in spans)) if spans else None
    return {
        'version': _VERSION,
        'storage_identifier': storage,
        **_when(span),
        'message_count': sum(counts.values()),
        'topics_with_message_count': listed,
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file.name for file in files],
        'files': [
            {'path': file.name, **_when(file.span), 'message_count': sum(topic.count for topic in file.topics)}
            for file in files
        ],
        'custom_data': {_STATE: _RECORDING} if recording else None,
        'ros_distro': 'jazzy',
    }


def _when(span: tuple[int, int] | None) -> dict[str, Any]:
    first, last = span or (0, 0)
    return {'starting_time': {'nanoseconds_since_epoch': first}, 'duration': {'nanoseconds': last - first}}


def dump(content: Mapping[str, Any]) -> str:
    """Return the text of metadata.yaml."""
    return str(yaml.safe_dump({_KEY: dict(content)}, sort_keys=False))


def embedded(content: Mapping[str, Any], written: str) -> dict[str, dict[str, str]]:
    """Return what storage files hold of metadata.yaml, whose text is `written`: a copy, and its checksum."""
    copy = str(yaml.safe_dump(dict(content), sort_keys=False)).strip()
    crc = {CHECKSUM: f'{zlib.crc32(written.encode()):08x}'}
    return {'rosbag2': {'serialized_metadata': copy}, RECORD: crc}


def checksum_of(path: Path) -> str:
    """Return the checksum of a metadata.yaml as `embedded` states it."""
    return f'{zlib.crc32(path.read_bytes()):08x}'


def load(path: Path) -> Summary:
    """Read metadata.yaml.

    Raises:
        ValueError: it is not as rosbag2 writes it.
        OSError: it cannot be read.
    """
    try:
        about = yaml.load(path.read_text(encoding='utf-8'), _LOADER)[_KEY]  # noqa: S506 a safe loader, in C
        if about['version'] > _VERSION:
            raise ValueError(f'version {about["version"]} of metadata.yaml is unknown')
        topics, profiles = {}, {}
        for entry in about['topics_with_message_count']:
            named = entry['topic_metadata']
            if named['serialization_format'] != 'cdr':
                raise ValueError(f'serialization format {named["serialization_format"]!r} is unknown')
            digest = named.get('type_description_hash', '')
            topics[named['name']] = Topic(named['name'], named['type'], '', digest, entry['message_count'], '')
            profiles[named['name']] = parse_qos(named.get('offered_qos_profiles') or [])
        first = about['starting_time']['nanoseconds_since_epoch']
        span = (first, first + about['duration']['nanoseconds']) if about['message_count'] else None
        state = (about.get('custom_data') or {}).get(_STATE)
        if not all(isinstance(name, str) for name in about['relative_file_paths']):
            raise ValueError('relative_file_paths are no names')
        return Summary(
            [Path(name).name for name in about['relative_file_paths']],
            topics, about['message_count'], span, state == _RECORDING, profiles,
        )  # fmt: skip
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f'metadata.yaml is no YAML ({" ".join(str(error).split())})') from None
    except KeyError as error:
        raise ValueError(f'metadata.yaml lacks the key {error}') from None
    except (TypeError, AttributeError) as error:
        raise ValueError(f'metadata.yaml is not as rosbag2 writes it ({error})') from None


def contradiction(summary: Summary, files: Sequence[StorageFile]) -> str:
    """Return in what metadata.yaml differs from finished storage files, '' where in nothing."""
    counts: dict[str, int] = {}
    for topic in (topic for file in files for topic in file.topics):
        counts[topic.name] = counts.get(topic.name, 0) + topic.count
        stated = summary.topics.get(topic.name)
        if stated is None:
            return f'it does not name {topic.name}'
        if stated.type != topic.type:
            return f'it states another type of {topic.name}'
        if stated.digest and topic.digest and stated.digest != topic.digest:
            return f'it states another hash of the type of {topic.name}'
    for name, topic in summary.topics.items():
        if topic.count != counts.get(name, 0):
            return f'it states {topic.count} messages on {name}, there are {counts.get(name, 0)}'
    if summary.count != sum(counts.values()):
        return f'it states {summary.count} messages, there are {sum(counts.values())}'
    spans = [file.span for file in files if file.span]
    span = (min(s[0] for s in spans), max(s[1] for s in spans)) if spans else None
    return '' if summary.span == span else 'it states another time or duration'
