"""Binary feed of raw sweeps from a digitiser over TCP or UDP (docs/feed_protocol.md). All numbers are little-endian."""

import contextlib
import dataclasses
import math
import struct
import zlib
from collections.abc import Iterator

import numpy as np

from drfmcw_physics.settings import ConfigurationError

from ..processing.records import Sweep

VERSION = 1
MAGIC = b'DRFS'
"""First bytes of a sweep frame."""
FRAGMENT_MAGIC = b'DRFU'
"""First bytes of a UDP datagram."""
REQUEST_MAGIC = b'DRFR'
"""First bytes of a settings request from the station to the digitiser."""

# magic, version, flags, reserved, stamp, sweep_id, full_scale, start_delay, temperature, int16 values, peer
_HEADER = struct.Struct('<4sBBHqQdddI32s')
_FRAGMENT = struct.Struct('<4sBBHHHI')  # magic, version, reserved, index, count, reserved, frame number
_REQUEST = struct.Struct('<4sBBHd32s')  # magic, version, mode, reserved, start_delay, peer
_CRC = struct.Struct('<I')
HEADER_SIZE = _HEADER.size + _CRC.size
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

    def sweep(self, station: str, peer: str, stamp: int, frame_id: str) -> Sweep:
        """Return it as a sweep of `station`."""
        return Sweep(station, peer, self.sweep_id, self.full_scale, self.iq, self.samples, stamp, frame_id)


@dataclasses.dataclass(frozen=True, slots=True)
class Request:
    """What the station asks the digitiser to sweep."""

    mode: int  # SweepConfig.MODE_*
    start_delay: float  # [s]
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
    header = _HEADER.pack(
        MAGIC,
        VERSION,
        flags,
        0,
        frame.stamp,
        frame.sweep_id,
        frame.full_scale,
        frame.start_delay,
        frame.temperature,
        len(samples) // 2,
        _name(frame.peer),
    )
    return b''.join((header, _CRC.pack(zlib.crc32(header)), samples, _CRC.pack(zlib.crc32(samples))))


def encode_fragments(frame: Frame, number: int, payload: int = FRAGMENT_PAYLOAD) -> Iterator[bytes]:
    """Yield the datagrams of one frame, `payload` bytes in each; `number` counts the frames and wraps at 2^32."""
    data = encode(frame)
    count = -(-len(data) // payload)
    if count > 0xFFFF:
        raise ConfigurationError(f'a sweep of {len(frame.samples)} samples does not fit the UDP feed; use TCP')
    for index in range(count):
        header = _FRAGMENT.pack(FRAGMENT_MAGIC, VERSION, 0, index, count, 0, number % (1 << 32))
        yield header + data[index * payload : (index + 1) * payload]


def encode_request(request: Request) -> bytes:
    """Return a settings request as the station sends it."""
    body = _REQUEST.pack(REQUEST_MAGIC, VERSION, request.mode, 0, request.start_delay, _name(request.peer))
    return body + _CRC.pack(zlib.crc32(body))


def decode_requests(data: bytes) -> tuple[list[Request], bytes]:
    """Return the complete requests in `data`, and the bytes that belong to the next."""
    requests: list[Request] = []
    size = _REQUEST.size + _CRC.size
    while True:
        start = data.find(REQUEST_MAGIC)
        if start < 0:
            return requests, data[-3:]
        if len(data) - start < size:
            return requests, data[start:]
        body = data[start : start + _REQUEST.size]
        if _CRC.unpack_from(data, start + _REQUEST.size)[0] != zlib.crc32(body):
            data = data[start + 1 :]
            continue
        _, _, mode, _, start_delay, peer = _REQUEST.unpack(body)
        with contextlib.suppress(MalformedFrame):
            requests.append(Request(mode, start_delay, _text(peer)))
        data = data[start + size :]


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
    if magic != FRAGMENT_MAGIC or version != VERSION or index >= count:
        return None
    return Fragment(index, count, number, datagram[_FRAGMENT.size :])


def decode_whole(data: bytes) -> Frame | None:
    """Return the frame that `data` is from the first byte to the last, None where it is none."""
    try:
        frame, end = _decode(data, 0) if data.startswith(MAGIC) else (None, 0)
    except MalformedFrame:
        return None
    return frame if end == len(data) else None


def frame_size(count: int) -> int:
    """Return the bytes of a frame with `count` int16 values."""
    return HEADER_SIZE + 2 * count + _CRC.size


def _decode(data: bytes | bytearray, start: int, largest_count: int = LARGEST_COUNT) -> tuple[Frame | None, int]:
    """Return (frame, index after it) of the frame that begins at `start`; (None, start) where bytes are missing."""
    if len(data) - start < HEADER_SIZE:
        return None, start
    header = bytes(data[start : start + _HEADER.size])
    if _CRC.unpack_from(data, start + _HEADER.size)[0] != zlib.crc32(header):
        raise MalformedFrame('header checksum')
    _, version, flags, _, stamp, sweep_id, full_scale, start_delay, temperature, count, peer = _HEADER.unpack(header)
    if version != VERSION or count > largest_count or (flags & _IQ and count % 2):
        raise MalformedFrame('header')
    begin = start + HEADER_SIZE
    end = begin + 2 * count
    if len(data) < end + _CRC.size:
        return None, start
    samples = bytes(data[begin:end])
    if _CRC.unpack_from(data, end)[0] != zlib.crc32(samples):
        raise MalformedFrame('samples checksum')
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
