"""Source `tcp`: a digitiser that connects and streams frames (docs/feed_protocol.md)."""

import socket
from typing import Any

from .feed import FrameParser, Request, encode_request
from .sockets import bound
from .source import POLL, Source

_RECEIVE = 1 << 20  # bytes at once


class TcpSource(Source):
    """Listens for one digitiser; a new connection replaces the old, so a power loss needs no care."""

    def __init__(self, address: str, port: int, **kwargs: Any) -> None:
        """Listen at `address`:`port`.

        Raises:
            ConfigurationError: the address cannot be used.
        """
        super().__init__(**kwargs)
        self._parser = FrameParser()
        self._connection: socket.socket | None = None
        self.connections = 0
        self._listener = bound(socket.SOCK_STREAM, address, port)
        self._listener.listen(2)
        self._listener.settimeout(POLL)
        self.port = self._listener.getsockname()[1]

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

    def _serve(self, connection: socket.socket) -> None:
        """Read one connection until it ends or another one comes."""
        self._listener.settimeout(0.0)
        try:
            while connection is not None and not self._ended.is_set():
                self.connections += 1
                with connection:
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
                    connection.settimeout(POLL)
                    self._connection, self.connected = connection, True
                    connection = self._read(connection)
                self._connection, self.connected = None, False
                self._parser.reset()
        finally:
            self._listener.settimeout(POLL)

    def _read(self, connection: socket.socket) -> socket.socket | None:
        """Deliver what comes; return the connection that replaces this one, None at its end."""
        silent = False
        while not self._ended.is_set():
            try:
                data = connection.recv(_RECEIVE)
                silent = False
            except TimeoutError:
                silent = True
                data = b''
            except OSError:
                return None
            if data:
                frames = self._parser.feed(data)
                if frames:
                    self._deliver(frames)
            elif not silent:
                return None
            if silent:  # a digitiser that lost its power never says so: it comes back with a new connection
                try:
                    return self._listener.accept()[0]
                except (BlockingIOError, TimeoutError):
                    pass
        return None
