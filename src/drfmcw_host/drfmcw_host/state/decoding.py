"""Ranges straight from the bytes that the middleware delivers: ROS's own conversion takes ten times as long."""

import struct

from .readings import RangeReading

_STRINGS = 3  # frame_id, first_station, second_station
_ENCAPSULATION = 4  # bytes before the content, from which alignment counts
_HEAD = 8  # bytes of the stamp


def range_reading(data: bytes) -> RangeReading:
    """Return the shown fields of a serialised RangeEstimate (CDR version 1, either byte order).

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
