"""Binary feed of raw sweeps from a digitiser over TCP or UDP (docs/feed_protocol.md). All numbers are little-endian."""

import contextlib
import dataclasses
import math
import re
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError

from ..processing.records import Sweep

VERSION = 2
"""Of frames; those of version 1, which know no time division, are understood too."""
MAGIC = b'DRFS'
"""First bytes of a sweep frame."""
FRAGMENT_MAGIC = b'DRFU'
"""First bytes of a UDP datagram."""
REQUEST_MAGIC = b'DRFR'
"""First bytes of a settings request from the station to the digitiser."""
TURNS_REQUEST_MAGIC = b'DRFT'
"""First bytes of a request for a share of the time division; for digitisers of version 2."""

# magic, version, flags, reserved, stamp, sweep_id, full_scale, start_delay, temperature, int16 values, peer
_HEADER = '<4sBBHqQdddI32s'
_TURNS = 'di'  # rate, priority; from version 2 on
_HEADERS = {1: struct.Struct(_HEADER), 2: struct.Struct(_HEADER + _TURNS)}
_REQUEST = struct.Struct('<4sBBHd32s')  # magic, version, mode, reserved, start_delay, peer
_REQUEST_VERSION = 1
_TURNS_REQUEST = struct.Struct('<4sBBHdi32s')  # magic, version, reserved, reserved, rate, priority, peer
_TURNS_REQUEST_VERSION = 2
_LAYOUTS = {
    (REQUEST_MAGIC, _REQUEST_VERSION): _REQUEST,
    (TURNS_REQUEST_MAGIC, _TURNS_REQUEST_VERSION): _TURNS_REQUEST,
}
_ANY_REQUEST = re.compile(b'|'.join(magic for magic, _ in _LAYOUTS))
_FRAGMENT = struct.Struct('<4sBBHHHI')  # magic, version, reserved, index, count, reserved, frame number
_FRAGMENT_VERSION = 1
_VERSION_AT = 4  # in frames and requests
_CRC = struct.Struct('<I')
HEADER_SIZE = _HEADERS[VERSION].size + _CRC.size
FRAGMENT_PAYLOAD = 1400
"""Bytes of a frame in one datagram; fits an Ethernet frame."""
SEALED_PAYLOAD = 1360
"""The same for a sealed datagram."""

_IQ, _LONG_DISTANCE, _UNLOCKED = 1, 2, 4
LARGEST_COUNT = 1 << 25
"""Largest number of int16 values in a frame that a header can state."""
_PATIENCE = 16  # damaged frames in a row after which a stream is none of frames; each costs a checksum of the buffer


@dataclasses.dataclass(frozen=True, slots=True)
class Frame:
    """One sweep as a digitiser sends it."""

    sweep_id: int
    stamp: int  # start of the sweep [ns], 0 where the digitiser has no clock
    full_scale: float  # [LSB]
    iq: bool
    samples: np.ndarray  # int16
    peer: str = ''  # '' for the only peer
    mode: int = 0  # SweepConfig.MODE_*
    start_delay: float = math.nan  # T_off in use, NaN for the configured one [s]
    temperature: float = math.nan  # of the board, NaN where unknown [degC]
    pll_locked: bool = True
    rate: float = 0.0  # sweeps per second that the time division grants to this pair, 0 where not stated [Hz]
    priority: int = 0
    version: int = VERSION  # of the feed that the digitiser speaks

    def sweep(self, station: str, peer: str, stamp: int, frame_id: str) -> Sweep:
        """Return it as a sweep of `station`."""
        return Sweep(station, peer, self.sweep_id, self.full_scale, self.iq, self.samples, stamp, frame_id)


@dataclasses.dataclass(frozen=True, slots=True)
class Request:
    """What the station asks the digitiser to sweep."""

    mode: int  # SweepConfig.MODE_*
    start_delay: float  # [s]
    peer: str = ''


@dataclasses.dataclass(frozen=True, slots=True)
class TurnsRequest:
    """Which share of the time division a pair asks for; a digitiser of version 1 knows none."""

    rate: float  # sweeps per second, 0 for the digitiser's own [Hz]
    priority: int
    peer: str = ''


class MalformedFrame(ValueError):
    """Bytes that are no frame."""


def encode(frame: Frame) -> bytes:
    """Return the frame as sent over TCP.

    Raises:
        ConfigurationError: a peer's name longer than 32 bytes.
    """
    flags = (_IQ if frame.iq else 0) | (_LONG_DISTANCE if frame.mode else 0) | (0 if frame.pll_locked else _UNLOCKED)
    samples = np.ascontiguousarray(frame.samples, dtype='<i2').tobytes()
    turns = (frame.rate, frame.priority) if frame.version > 1 else ()
    header = _HEADERS[frame.version].pack(
        MAGIC,
        frame.version,
        flags,
        0,
        frame.stamp,
        frame.sweep_id,
        frame.full_scale,
        frame.start_delay,
        frame.temperature,
        len(samples) // 2,
        _name(frame.peer),
        *turns,
    )
    return b''.join((header, _CRC.pack(zlib.crc32(header)), samples, _CRC.pack(zlib.crc32(samples))))


def encode_fragments(frame: Frame, number: int, payload: int = FRAGMENT_PAYLOAD) -> Iterator[bytes]:
    """Yield the datagrams of one frame, `payload` bytes in each; `number` counts the frames and wraps at 2^32."""
    data = encode(frame)
    count = -(-len(data) // payload)
    if count > 0xFFFF:
        raise ConfigurationError(f'a sweep of {len(frame.samples)} samples does not fit the UDP feed; use TCP')
    for index in range(count):
        header = _FRAGMENT.pack(FRAGMENT_MAGIC, _FRAGMENT_VERSION, 0, index, count, 0, number % (1 << 32))
        yield header + data[index * payload : (index + 1) * payload]


def encode_request(request: Request | TurnsRequest) -> bytes:
    """Return a request as the station sends it."""
    if isinstance(request, Request):
        values = (REQUEST_MAGIC, _REQUEST_VERSION, request.mode, 0, request.start_delay, _name(request.peer))
        body = _REQUEST.pack(*values)
    else:
        turns = (request.rate, request.priority, _name(request.peer))
        body = _TURNS_REQUEST.pack(TURNS_REQUEST_MAGIC, _TURNS_REQUEST_VERSION, 0, 0, *turns)
    return body + _CRC.pack(zlib.crc32(body))


def decode_requests(data: bytes) -> tuple[list[Request | TurnsRequest], bytes]:
    """Return the complete requests in `data`, and the bytes that belong to the next; unknown versions are skipped."""
    requests: list[Request | TurnsRequest] = []
    while True:
        found = _ANY_REQUEST.search(data)
        if found is None:
            return requests, data[-3:]
        data = data[found.start() :]
        if len(data) <= _VERSION_AT:
            return requests, data
        layout = _LAYOUTS.get((found[0], data[_VERSION_AT]))
        if layout is not None and len(data) < layout.size + _CRC.size:
            return requests, data
        if layout is None or _CRC.unpack_from(data, layout.size)[0] != zlib.crc32(data[: layout.size]):
            data = data[1:]
            continue
        with contextlib.suppress(MalformedFrame):
            requests.append(_decoded_request(found[0], layout.unpack_from(data)))
        data = data[layout.size + _CRC.size :]


def _decoded_request(magic: bytes, values: tuple[Any, ...]) -> Request | TurnsRequest:
    if magic == REQUEST_MAGIC:
        _, _, mode, _, start_delay, peer = values
        return Request(mode, start_delay, _text(peer))
    _, _, _, _, rate, priority, peer = values
    return TurnsRequest(rate, priority, _text(peer))


class FrameParser:
    """Cuts a byte stream into frames; after damage it goes on at the next frame that is whole."""

    def __init__(self, largest_count: int = LARGEST_COUNT) -> None:
        """Start with an empty buffer; frames of more than `largest_count` int16 values are refused."""
        self._buffer = bytearray()
        self._largest = largest_count
        self._in_a_row = 0  # damaged frames
        self.malformed = 0
        """Frames that were damaged, since start."""
        self.skipped = 0
        """Bytes that belonged to no frame, since start."""

    @property
    def unfinished(self) -> bool:
        """Whether a frame may have begun and has not ended."""
        return bool(self._buffer)

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that are complete with these bytes.

        Raises:
            MalformedFrame: many damaged frames in a row; whoever sends this is no digitiser.
        """
        self._buffer += data
        buffer, frames, at = self._buffer, [], 0
        while True:
            start = buffer.find(MAGIC, at)
            if start < 0:
                start = max(at, len(buffer) - len(MAGIC) + 1)  # the magic may have begun
                self.skipped += start - at
                at = start
                break
            self.skipped += start - at
            at = start
            try:
                frame, end = _decode(buffer, start, self._largest)
            except MalformedFrame:
                self.malformed += 1
                self.skipped += 1
                self._in_a_row += 1
                if self._in_a_row > _PATIENCE:
                    raise
                at = start + 1
                continue
            if frame is None:
                break
            self._in_a_row = 0
            frames.append(frame)
            at = end
        del buffer[:at]
        return frames


@dataclasses.dataclass(frozen=True, slots=True)
class Fragment:
    """One datagram."""

    index: int
    count: int  # of the frame's pieces
    number: int  # of the frame
    content: bytes


def decode_fragment(datagram: bytes) -> Fragment | None:
    """Return the piece in a datagram, None where it is none."""
    if not _FRAGMENT.size < len(datagram) <= _FRAGMENT.size + FRAGMENT_PAYLOAD:
        return None
    magic, version, _, index, count, _, number = _FRAGMENT.unpack_from(datagram)
    if magic != FRAGMENT_MAGIC or version != _FRAGMENT_VERSION or index >= count:
        return None
    return Fragment(index, count, number, datagram[_FRAGMENT.size :])


def decode_whole(data: bytes) -> Frame | None:
    """Return the frame that `data` is from the first byte to the last, None where it is none."""
    try:
        frame, end = _decode(data, 0) if data.startswith(MAGIC) else (None, 0)
    except MalformedFrame:
        return None
    return frame if end == len(data) else None


def header_size(version: int) -> int | None:
    """Return the bytes of a frame before its samples, None for a version that does not exist."""
    layout = _HEADERS.get(version)
    return None if layout is None else layout.size + _CRC.size


def frame_size(count: int) -> int:
    """Return the bytes of a frame with `count` int16 values."""
    return HEADER_SIZE + 2 * count + _CRC.size


def _decode(data: bytes | bytearray, start: int, largest_count: int = LARGEST_COUNT) -> tuple[Frame | None, int]:
    """Return (frame, index after it) of the frame that begins at `start`; (None, start) where bytes are missing."""
    if len(data) - start <= _VERSION_AT:
        return None, start
    layout = _HEADERS.get(data[start + _VERSION_AT])
    if layout is None:
        raise MalformedFrame(f'version {data[start + _VERSION_AT]}')
    begin = start + layout.size + _CRC.size
    if len(data) < begin:
        return None, start
    header = bytes(data[start : start + layout.size])
    if _CRC.unpack_from(data, start + layout.size)[0] != zlib.crc32(header):
        raise MalformedFrame('header checksum')
    values = layout.unpack(header)
    _, version, flags, _, stamp, sweep_id, full_scale, start_delay, temperature, count, peer, *turns = values
    if count > largest_count or (flags & _IQ and count % 2):
        raise MalformedFrame('header')
    end = begin + 2 * count
    if len(data) < end + _CRC.size:
        return None, start
    samples = bytes(data[begin:end])
    if _CRC.unpack_from(data, end)[0] != zlib.crc32(samples):
        raise MalformedFrame('samples checksum')
    rate, priority = turns or (0.0, 0)
    frame = Frame(
        sweep_id=sweep_id,
        stamp=stamp,
        full_scale=full_scale,
        iq=bool(flags & _IQ),
        samples=np.frombuffer(samples, '<i2').astype(np.int16, copy=False),
        peer=_text(peer),
        mode=1 if flags & _LONG_DISTANCE else 0,
        start_delay=start_delay,
        temperature=temperature,
        pll_locked=not flags & _UNLOCKED,
        rate=rate,
        priority=priority,
        version=version,
    )
    return frame, end + _CRC.size


def _name(text: str) -> bytes:
    data = text.encode()
    if len(data) > 32:
        raise ConfigurationError(f"station name '{text}' is longer than 32 bytes")
    return data


def _text(data: bytes) -> str:
    try:
        return data.rstrip(b'\0').decode()
    except UnicodeDecodeError:
        raise MalformedFrame('peer') from None
