"""Source `tcp`: a digitiser connects and streams frames (docs/feed_protocol.md)."""

import socket
from typing import Any

from .feed import FrameParser, Request, encode_request
from .sockets import SocketSettings, listening_socket
from .source import POLL, Source

_RECEIVE = 1 << 20  # bytes at once


class TcpSource(Source, name='tcp'):
    """Listens for one digitiser; a new connection replaces the old one, so a power loss needs no care."""

    settings = SocketSettings

    def __init__(self, station: str, settings: SocketSettings, **kwargs: Any) -> None:
        """Listen; arguments as for `Source`."""
        super().__init__(station, settings, **kwargs)
        self._parser = FrameParser()
        self._connection: socket.socket | None = None
        self.connections = 0
        self._listener = listening_socket(socket.SOCK_STREAM, settings)
        self._listener.listen(2)
        self._listener.settimeout(POLL)
        self._host = settings.ip_address
        self.port: int = self._listener.getsockname()[1]

    def address(self) -> str:
        """Return the address as a URL."""
        return f'tcp://{self._host}:{self.port}'

    def counts(self) -> dict[str, int]:
        """Return connections, damaged frames and skipped bytes."""
        return {
            'connections': self.connections,
            'malformed frames': self._parser.malformed,
            'skipped bytes': self._parser.skipped,
        }

    def request(self, request: Request) -> bool:
        """Send a settings request to the connected digitiser."""
        connection = self._connection
        try:
            if connection is not None:
                connection.sendall(encode_request(request))
                return True
        except OSError:
            pass
        return False

    def _run(self) -> None:
        with self._listener:
            while not self._ended.is_set():
                try:
                    connection, _ = self._listener.accept()
                except TimeoutError:
                    continue
                self._serve(connection)

    def _serve(self, first: socket.socket) -> None:
        """Read one connection after the other, until none replaces the last."""
        self._listener.settimeout(0.0)
        following: socket.socket | None = first
        try:
            while following is not None and not self._ended.is_set():
                self.connections += 1
                with following as connection:
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
                    connection.settimeout(POLL)
                    self._connection, self.connected = connection, True
                    following = self._read(connection)
                self._connection, self.connected = None, False
                self._parser.reset()
        finally:
            self._listener.settimeout(POLL)

    def _read(self, connection: socket.socket) -> socket.socket | None:
        """Deliver what comes; return the connection that replaces this one, None at its end."""
        while not self._ended.is_set():
            try:
                data = connection.recv(_RECEIVE)
            except TimeoutError:  # a digitiser that lost its power never says so: it comes back with a new connection
                replacement = self._waiting()
                if replacement is not None:
                    return replacement
                continue
            except OSError:
                return None
            if not data:
                return None
            frames = self._parser.feed(data)
            if frames:
                self._deliver(frames)
        return None

    def _waiting(self) -> socket.socket | None:
        """Return a connection that waits to be accepted, None for none."""
        try:
            return self._listener.accept()[0]
        except (BlockingIOError, TimeoutError):
            return None
