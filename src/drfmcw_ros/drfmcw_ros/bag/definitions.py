"""Message definitions of a recording against ours: the same, an older one that lacks fields, or another one."""

import dataclasses
import functools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from rosbags.interfaces import Connection, Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from drfmcw_physics.settings import ConfigurationError


class BagError(ConfigurationError):
    """A recording that cannot be read or lacks what is needed; the message is one line."""


class UnwritableError(BagError):
    """A recording that cannot be written for now: the disk is full or gone."""


@dataclasses.dataclass(frozen=True)
class Converter:
    """Makes serialised messages of our definition from those of an older one."""

    kind: str
    ours: Typestore
    older: Typestore
    added: Mapping[str, Any]
    """Fields that the older definition lacks, with the values that they get."""

    def __call__(self, raw: bytes) -> bytes:
        """Return a message in our definition; raises what rosbags' parser meets."""
        message = self.older.deserialize_cdr(raw, self.kind)
        known = {name: getattr(message, name) for name, _ in self.older.fielddefs[self.kind][1]}
        return bytes(self.ours.serialize_cdr(self.ours.types[self.kind](**known, **self.added), self.kind))


@functools.cache
def typestore() -> Typestore:
    """Return the message types of Jazzy and of drfmcw_msgs as installed."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted(Path(get_package_share_directory('drfmcw_msgs'), 'msg').glob('*.msg')):
        store.register(get_types_from_msg(path.read_text(encoding='utf-8'), f'drfmcw_msgs/msg/{path.stem}'))
    return store


def reason(error: BaseException) -> str:
    """Return an error's text in one line."""
    text = ' '.join(str(getattr(error, 'strerror', None) or error).split())
    return text if text else type(error).__name__


def converter(ours: Typestore, connection: Connection) -> Converter | None:
    """Return what makes serialised messages of our definition from those of a recording; None where they are the same.

    Fields of messages are only ever added. Where a recording is older, fields that it lacks are NaN, zero or empty.

    Args:
        ours: our message types.
        connection: topic of the recording.

    Raises:
        ValueError: the type is unknown, or its definition another one.
    """
    kind = connection.msgtype
    if kind not in ours.fielddefs:
        raise ValueError(f'message type {kind} is unknown')
    recorded, theirs = None, connection.digest
    if connection.msgdef.data:
        try:
            recorded = get_typestore(Stores.EMPTY)
            recorded.register(get_types_from_msg(connection.msgdef.data, kind))
            theirs = theirs or recorded.hash_rihs01(kind)
        except Exception as error:  # rosbags raises what its parser meets
            raise ValueError(f'its message definition cannot be read ({error})') from None
    if not theirs or theirs == ours.hash_rihs01(kind):
        return None
    added = _added(ours, recorded, kind) if recorded is not None else None
    if recorded is None or added is None:
        raise ValueError(f'its definition of {kind} differs from the one drfmcw uses')
    return Converter(kind, ours, recorded, added)


def _added(ours: Typestore, theirs: Typestore, kind: str) -> dict[str, Any] | None:
    """Return the values of the fields that only our definition has; None where it is more than that."""
    own, recorded = dict(ours.fielddefs[kind][1]), dict(theirs.fielddefs[kind][1])
    if any(own.get(name) != field for name, field in recorded.items()):
        return None
    for nested, (_, fields) in theirs.fielddefs.items():
        if nested != kind and (nested not in ours.fielddefs or ours.fielddefs[nested][1] != fields):
            return None
    found: dict[str, Any] = {}
    for name, (node, about) in own.items():
        if name in recorded:
            continue
        if node != Nodetype.BASE:
            return None
        base = about[0] if isinstance(about, tuple) else about
        found[name] = math.nan if str(base).startswith('float') else '' if base == 'string' else 0
    return found
