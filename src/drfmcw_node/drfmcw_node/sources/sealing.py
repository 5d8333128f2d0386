"""Sealed messages of the feed: pre-shared key, HMAC-SHA256 and a number that is used once (docs/feed_protocol.md)."""

import collections
import hashlib
import hmac
import os
import secrets
import stat
import struct
import time

from drfmcw_physics.settings import ConfigurationError

SEAL_MAGIC = b'DRFA'
"""First bytes of a sealed message."""
HELLO_MAGIC = b'DRFN'
"""First bytes of what the station sends to a TCP client first: the session that its messages have to name."""
SESSION_SIZE = 16
NO_SESSION = bytes(SESSION_SIZE)
"""Session of datagrams: a digitiser that only sends has no way to be given one."""
TO_STATION, TO_DIGITISER = 0, 1

_SEAL = struct.Struct('<4sBBHIQ16s')  # magic, version, direction, reserved, length, number, session
_HELLO = struct.Struct('<4sBBH16s')  # magic, version, reserved, reserved, session
_VERSION = 1
_TAG_SIZE = hashlib.sha256().digest_size
OVERHEAD = _SEAL.size + _TAG_SIZE
"""Bytes that a seal adds to a message."""
HELLO_SIZE = _HELLO.size
_SHORTEST_KEY = 16  # [bytes]
_REMEMBERED = 4096  # numbers of datagrams; an older one counts as seen
CLOCK_TOLERANCE = 10.0
"""By how much a sender of sealed datagrams may be ahead of or behind the station's clock [s]."""


class SealError(ValueError):
    """A message that does not bear the seal it should."""


def read_key(path: str) -> bytes:
    """Return the key in a file, white space around it left out; b'' for an empty path.

    Raises:
        ConfigurationError: not readable, readable by others than its owner, or shorter than 16 bytes.
    """
    if not path:
        return b''
    try:
        with open(path, 'rb') as file:
            mode = os.fstat(file.fileno()).st_mode
            key = file.read(4096).strip()
    except OSError as error:
        raise ConfigurationError(f'feed_key {path}: {error.strerror}') from None
    if not stat.S_ISREG(mode):
        raise ConfigurationError(f'feed_key {path}: not a file')
    if mode & 0o077:
        raise ConfigurationError(f'feed_key {path}: others than its owner may read or write it (chmod 600 {path})')
    if len(key) < _SHORTEST_KEY:
        raise ConfigurationError(f'feed_key {path}: {len(key)} bytes, at least {_SHORTEST_KEY} are needed')
    return key


def new_session() -> bytes:
    """Return a session that no client has seen before."""
    return secrets.token_bytes(SESSION_SIZE)


def encode_hello(session: bytes) -> bytes:
    """Return what the station sends to a client first."""
    return _HELLO.pack(HELLO_MAGIC, _VERSION, 0, 0, session)


def decode_hello(data: bytes) -> bytes:
    """Return the session in the station's first message; raises SealError for anything else."""
    if len(data) != HELLO_SIZE:
        raise SealError('no greeting of a station with a key')
    magic, version, _, _, session = _HELLO.unpack(data)
    if magic != HELLO_MAGIC or version != _VERSION:
        raise SealError('no greeting of a station with a key')
    return session


def seal(payload: bytes, key: bytes, direction: int, number: int, session: bytes = NO_SESSION) -> bytes:
    """Return a message with its seal; `number` grows from message to message of a session."""
    header = _SEAL.pack(SEAL_MAGIC, _VERSION, direction, 0, len(payload), number, session)
    return header + payload + hmac.digest(key, header + payload, 'sha256')


def unseal(data: bytes, key: bytes, direction: int, session: bytes = NO_SESSION) -> tuple[int, bytes]:
    """Return (number, payload) of exactly one sealed message.

    Raises:
        SealError: not sealed, damaged, of another key, direction or session.
    """
    if len(data) < OVERHEAD or _length(data) != len(data) - OVERHEAD:
        raise SealError('no sealed message')
    if not hmac.compare_digest(hmac.digest(key, data[:-_TAG_SIZE], 'sha256'), data[-_TAG_SIZE:]):
        raise SealError('wrong seal')
    _, _, found, _, _, number, of = _SEAL.unpack_from(data)
    if found != direction or of != session:
        raise SealError('sealed for another direction or session')
    return number, bytes(data[_SEAL.size : -_TAG_SIZE])


def _length(data: bytes | bytearray) -> int:
    """Return the length of the payload that a message's header states; raises SealError where it is no header."""
    magic, version, _, _, length, _, _ = _SEAL.unpack_from(data)
    if magic != SEAL_MAGIC or version != _VERSION:
        raise SealError('no sealed message')
    return int(length)


class SealedStream:
    """Opens the sealed messages of one TCP connection: complete, in order, each once, or not at all."""

    def __init__(self, key: bytes, session: bytes, direction: int, largest: int) -> None:
        """Start with an empty buffer.

        Args:
            key: shared with the sender.
            session: that the messages have to name.
            direction: TO_STATION or TO_DIGITISER.
            largest: payload accepted [bytes]; the buffer never holds more than one such message and what came with it.
        """
        self._key, self._session, self._direction, self._largest = key, session, direction, largest
        self._buffer = bytearray()
        self._next = 0

    @property
    def unfinished(self) -> bool:
        """Whether a message has begun and not ended."""
        return bool(self._buffer)

    def feed(self, data: bytes) -> bytes:
        """Return the payloads that are complete with these bytes.

        Raises:
            SealError: the stream is not, or no longer, that of a sender with the key.
        """
        self._buffer += data
        payloads, at = [], 0
        while len(self._buffer) - at >= _SEAL.size:
            length = _length(self._buffer[at : at + _SEAL.size])
            if length > self._largest:
                raise SealError(f'a message of {length} bytes, at most {self._largest} are accepted')
            end = at + OVERHEAD + length
            if len(self._buffer) < end:
                break
            number, payload = unseal(bytes(self._buffer[at:end]), self._key, self._direction, self._session)
            if number != self._next:
                raise SealError('a message was repeated or left out')
            self._next += 1
            payloads.append(payload)
            at = end
        del self._buffer[:at]
        return b''.join(payloads)


class DatagramSealer:
    """Seals datagrams, each with the time as its number."""

    def __init__(self, key: bytes, direction: int) -> None:
        """Take the key that the receiver shares, and TO_STATION or TO_DIGITISER."""
        self._key, self._direction, self._newest = key, direction, 0

    def seal(self, payload: bytes) -> bytes:
        """Return a datagram with its seal, with a later number than any before."""
        self._newest = max(time.time_ns(), self._newest + 1)
        return seal(payload, self._key, self._direction, self._newest)


class SealedDatagrams:
    """Opens sealed datagrams: each once, in any order, and none from before the receiver's start.

    Their number is the sender's time [ns since 1970]. A sender whose clock is behind by up to `CLOCK_TOLERANCE` is
    heard that much later after the receiver's start.
    """

    def __init__(self, key: bytes, started: int | None = None, direction: int = TO_STATION) -> None:
        """Start at `started` [ns since 1970], None for now; `key` is shared with the sender."""
        self._key, self._direction = key, direction
        self._oldest = time.time_ns() if started is None else started
        self._order: collections.deque[int] = collections.deque()
        self._seen: set[int] = set()

    def open(self, datagram: bytes, now: int) -> bytes:
        """Return the payload of a datagram that arrives at `now` [ns since 1970].

        Raises:
            SealError: not sealed with the key, too old, of the future, or seen before.
        """
        number, payload = unseal(datagram, self._key, self._direction)
        if number <= self._oldest or number in self._seen or abs(number - now) > CLOCK_TOLERANCE * 1e9:
            raise SealError('repeated, too old, or of another time')
        self._seen.add(number)
        self._order.append(number)
        if len(self._order) > _REMEMBERED:
            oldest = self._order.popleft()
            self._seen.remove(oldest)
            self._oldest = max(self._oldest, oldest)
        return payload
