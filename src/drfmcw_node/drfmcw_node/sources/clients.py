"""One connection of source `tcp`: bytes in, whole frames out, nothing that blocks."""

import contextlib
import math
import socket
import ssl

from .feed import VERSION, FrameParser, MalformedFrame, frame_size
from .sealing import TO_DIGITISER, TO_STATION, SealedStream, SealError, encode_hello, new_session, seal

_RECEIVE = 1 << 18  # bytes at once
_MOST_OUTGOING = 1 << 14  # bytes that a client may leave unread
_RECORD = 1 << 14  # largest one of TLS [bytes]


class ClientError(Exception):
    """Why a client is disconnected, in one line."""


class Client:
    """A connection that may be the digitiser's."""

    def __init__(
        self,
        connection: socket.socket,
        host: str,
        now: float,
        key: bytes,
        context: ssl.SSLContext | None,
        largest_count: int,
    ) -> None:
        """Take over an accepted connection.

        Args:
            connection: just accepted.
            host: its address.
            now: on any clock that runs on [s].
            key: that the digitiser shares; b'' for none.
            context: of TLS, None without.
            largest_count: of int16 values in a frame.
        """
        self.connection, self.host = connection, host
        connection.setblocking(False)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        if context is not None:
            self.connection = context.wrap_socket(connection, server_side=True, do_handshake_on_connect=False)
        self._shaking = context is not None
        self._key, self._session, self._sent = key, new_session(), 0
        largest = frame_size(largest_count)
        self._sealed = SealedStream(key, self._session, TO_STATION, largest) if key else None
        self.parser = FrameParser(largest_count)
        self.begun = now if self._shaking else math.inf
        """Since when a handshake or a frame has been unfinished [s]; infinite for neither."""
        self.heard = -math.inf
        """When the last whole frame came [s]."""
        self.version = VERSION
        """Of the feed, as the newest frame has it."""
        self.held: list = []
        """Frames that came while another client was the digitiser."""
        self._outgoing = encode_hello(self._session) if key else b''

    def receive(self, now: float) -> list:
        """Return the frames that are complete with what has come.

        Raises:
            ClientError: the connection has ended or must end.
        """
        try:
            if self._shaking:
                assert isinstance(self.connection, ssl.SSLSocket)
                self.connection.do_handshake()
                self._shaking, self.begun = False, math.inf
            self.flush()
            data = self._received()
        except (ssl.SSLWantReadError, ssl.SSLWantWriteError, BlockingIOError):
            return []
        except (OSError, ValueError) as error:
            raise ClientError(f'{self.host}: {error}') from None
        if not data:
            raise ClientError('')
        try:
            frames = self.parser.feed(self._sealed.feed(data) if self._sealed else data)
        except (SealError, MalformedFrame) as error:
            raise ClientError(f'{self.host}: {error}') from None
        unfinished = self.parser.unfinished or (self._sealed is not None and self._sealed.unfinished)
        if frames or not unfinished:
            self.begun = now if unfinished else math.inf
        elif self.begun == math.inf:
            self.begun = now
        if frames:
            self.heard, self.version = now, frames[-1].version
        return frames

    def _received(self) -> bytes:
        data = self.connection.recv(_RECEIVE)
        if isinstance(self.connection, ssl.SSLSocket):
            with contextlib.suppress(ssl.SSLWantReadError):
                while len(data) < _RECEIVE and self.connection.pending():  # select does not see what TLS has read
                    data += self.connection.recv(_RECORD)
        return data

    def send(self, message: bytes) -> None:
        """Send as much as goes without waiting, the rest later; raises ClientError where the client does not read."""
        if self._key:
            message = seal(message, self._key, TO_DIGITISER, self._sent, self._session)
            self._sent += 1
        self._outgoing += message
        if len(self._outgoing) > _MOST_OUTGOING:
            raise ClientError(f'{self.host}: does not read what it is sent')
        try:
            self.flush()
        except OSError as error:
            raise ClientError(f'{self.host}: {error}') from None

    def flush(self) -> None:
        """Send what is left over; raises OSError where the connection has ended."""
        while self._outgoing and not self._shaking:
            try:
                self._outgoing = self._outgoing[self.connection.send(self._outgoing) :]
            except (ssl.SSLWantReadError, ssl.SSLWantWriteError, BlockingIOError):
                return

    def close(self) -> None:
        """End the connection at once."""
        with contextlib.suppress(OSError):
            self.connection.close()
