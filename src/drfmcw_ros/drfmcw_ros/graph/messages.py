"""The message boundary: dataclasses to and from messages by equal field names.

A wrong Python type in a field aborts a process inside rclpy, so every value is converted here and nowhere else.
"""

import array
import dataclasses
import functools
import importlib
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy

from drfmcw_physics.rules import plausible
from drfmcw_physics.settings import ConfigurationError

T = TypeVar('T')

NANOSECONDS = 1_000_000_000
_SEQUENCE_CODES = {'int16': 'h', 'uint8': 'B', 'uint32': 'I', 'int64': 'q', 'uint64': 'Q', 'float': 'f', 'double': 'd'}


def stamp_ns(time: Any) -> int:
    """Return a builtin_interfaces Time as integer nanoseconds."""
    return time.sec * NANOSECONDS + time.nanosec


def to_time(stamp: int) -> Time:
    """Return integer nanoseconds as builtin_interfaces Time."""
    seconds, nanoseconds = divmod(int(stamp), NANOSECONDS)
    return Time(sec=seconds, nanosec=nanoseconds)


@functools.cache
def message_class(name: str) -> type:
    """Return the class of a message type given as 'package/msg/Name'."""
    package, _, kind = name.split('/')
    return getattr(importlib.import_module(f'{package}.msg'), kind)


@functools.cache
def _converters(message_type: Any) -> dict[str, Callable[[Any], Any]]:
    """Return {field: function converting a Python value to what the field takes}."""
    converters: dict[str, Callable[[Any], Any]] = {}
    for name, kind in message_type.get_fields_and_field_types().items():
        if kind.startswith('sequence<'):
            code = _SEQUENCE_CODES[kind[len('sequence<') : -1]]
            converters[name] = functools.partial(_to_array, code)
        elif kind in ('double', 'float'):
            converters[name] = float
        elif kind == 'string':
            converters[name] = str
        elif kind == 'boolean':
            converters[name] = bool
        elif 'int' in kind:
            converters[name] = int
    return converters


def _to_array(code: str, values: Any) -> array.array:
    """Return `values` as array.array, the fastest sequence rclpy takes (docs: ../shared/reference/ros.md)."""
    if isinstance(values, bytes | bytearray):
        return array.array(code, bytes(values))
    return array.array(code, np.ascontiguousarray(values, dtype=np.dtype(code)).tobytes())


def to_message(source: Any, message_type: type) -> Any:
    """Return a message with every field that `source` has under the same name; header from stamp and frame_id.

    Args:
        source: dataclass with the message's field names, and `stamp` [ns] and `frame_id` where it has a header.
        message_type: ROS message class.
    """
    message = message_type()
    for name, convert in _converters(message_type).items():
        value = getattr(source, name, None)
        if value is not None:
            setattr(message, name, convert(value))
    if hasattr(message, 'header'):
        message.header.stamp = to_time(source.stamp)
        message.header.frame_id = str(source.frame_id)
    return message


def publish(publisher: Publisher, source: Any) -> None:
    """Publish what `to_message` makes of a source, unless nobody listens and nobody who comes later would get it."""
    message_type: Any = publisher.msg_type
    if publisher.qos_profile.durability != DurabilityPolicy.VOLATILE or publisher.get_subscription_count():
        publisher.publish(to_message(source, message_type))


@functools.cache
def _field_names(cls: Any) -> tuple[str, ...]:
    return tuple(f.name for f in dataclasses.fields(cls) if f.init and f.name not in ('stamp', 'frame_id'))


class ImplausibleError(ConfigurationError):
    """A message holds a value that cannot be; the text names field, value, unit and range."""


def check(message: Any) -> None:
    """Refuse a ROS or rosbags message with a value outside of `plausible.LIMITS`.

    Raises:
        ImplausibleError: with the reason.
    """
    reason = plausible.refusal(type(message).__name__.rpartition('__')[2], message)
    if reason:
        raise ImplausibleError(reason)


def from_message(message: Any, cls: Callable[..., T]) -> T:
    """Return the dataclass `cls` filled from a ROS or rosbags message of the same field names.

    Raises:
        ImplausibleError: the message holds a value that cannot be.
        ConfigurationError: where `cls` validates itself and the message holds what it refuses.
    """
    check(message)
    values = {name: getattr(message, name) for name in _field_names(cls) if hasattr(message, name)}
    return cls(**values, stamp=stamp_ns(message.header.stamp), frame_id=message.header.frame_id)
