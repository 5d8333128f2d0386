"""Ranges from messages, one in each or many."""

import dataclasses
import struct
from typing import Any

from .readings import RangeReading

_STRINGS = 3  # frame_id, first_station, second_station
_ENCAPSULATION = 4  # bytes before the content, from which alignment counts
_HEAD = 8  # bytes of the stamp
_COLUMNS = tuple('sweep_start' if f.name == 'stamp' else f.name for f in dataclasses.fields(RangeReading))
"""Of a RangeBatch, in the order of the fields of a RangeReading."""
_OLDEST = 3600.0  # of a batch [s]


def range_reading(data: bytes) -> RangeReading:
    """Return the shown fields of a serialised RangeEstimate (CDR version 1, either byte order).

    They come straight from the bytes: ROS's own conversion takes ten times as long.

    Raises:
        ValueError: it is cut off.
    """
    order = '<' if data[1:2] == b'\x01' else '>'
    try:
        seconds, nanoseconds = struct.unpack_from(f'{order}iI', data, _ENCAPSULATION)
        at = _HEAD
        for _ in range(_STRINGS):
            at += -at % 4
            (length,) = struct.unpack_from(f'{order}I', data, at + _ENCAPSULATION)
            at += 4 + length
        at += -at % 8 + _ENCAPSULATION
        sweep_id, mode, flags, distance, std, velocity, protection, failed = struct.unpack_from(
            f'{order}QBB6xddd48xd8xI', data, at
        )
    except struct.error as error:
        raise ValueError(f'RangeEstimate of {len(data)} bytes: {error}') from None
    stamp = seconds * 1_000_000_000 + nanoseconds
    return RangeReading(sweep_id, stamp, mode, flags, failed, distance, std, velocity, protection)


def batch_readings(batch: Any) -> list[RangeReading]:
    """Return the ranges in a RangeBatch, oldest first.

    Raises:
        ValueError: its columns differ in length, or an age cannot be.
    """
    columns = [getattr(batch, name) for name in _COLUMNS]
    lengths = {len(column) for column in (batch.age, *columns)}
    if len(lengths) > 1:
        raise ValueError(f'RangeBatch with columns of {min(lengths)} to {max(lengths)} elements')
    if not all(0.0 <= age <= _OLDEST for age in batch.age):
        raise ValueError(f'RangeBatch with an age outside of 0 ... {_OLDEST:g} s')
    return [RangeReading(*row) for row in zip(*columns, strict=True)]
