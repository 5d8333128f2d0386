"""Source `tcp`: a digitiser connects and streams frames (docs/feed_protocol.md)."""

import collections
import contextlib
import math
import selectors
import socket
import time
from typing import Any

from .clients import Client, ClientError
from .feed import Request, TurnsRequest, encode_request
from .sealing import read_key
from .sockets import SocketSettings, caution, is_heard, listening_socket, networks, tls_context
from .source import POLL, Source

MOST_CLIENTS = 8
"""Connections at a time; beyond it the address with most loses its oldest one that is not the digitiser's."""
SILENCE = 0.2
"""Without a whole frame, after which another client that has sent one takes over [s]."""
_BACKLOG = 128  # a connection that finds no room there waits a second
_MOST_REQUESTS = 64  # that wait to be sent
_ACCEPTED = MOST_CLIENTS // 2  # between two looks at what the others send: whole frames already sent are read first


class TcpSource(Source, name='tcp'):
    """Listens for one digitiser; a new connection replaces the old one, so a power loss needs no care.

    The digitiser is the client whose whole frames come. Others may be connected: silent, slow or sending rubbish, they
    keep their place until it is needed or their time is up, and never the thread.
    """

    settings = SocketSettings

    def __init__(self, station: str, settings: SocketSettings, **kwargs: Any) -> None:
        """Listen; arguments as for `Source`."""
        super().__init__(station, settings, **kwargs)
        self._settings, self._heard_from = settings, networks(settings.feed_from)
        self._key, self._context = read_key(settings.feed_key), tls_context(settings)
        self._clients: list[Client] = []  # oldest first
        self._active: Client | None = None
        self._requests: collections.deque[Request | TurnsRequest] = collections.deque(maxlen=_MOST_REQUESTS)
        self._turns: dict[str, TurnsRequest] = {}  # by peer: each digitiser that connects gets them
        self._counts = dict.fromkeys(
            ('connections', 'refused connections', 'disconnected clients', 'malformed frames', 'skipped bytes'), 0
        )
        self._reason = ''
        self._listener = listening_socket(socket.SOCK_STREAM, settings)
        self._listener.listen(_BACKLOG)
        self._listener.setblocking(False)
        self._waker, self._woken = socket.socketpair()
        for end in (self._waker, self._woken):
            end.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self.port: int = self._listener.getsockname()[1]

    def address(self) -> str:
        """Return the address as a URL."""
        return f'{"tls" if self._context else "tcp"}://{self._settings.ip_address}:{self.port}'

    def caution(self) -> str:
        """Return what is unsafe about the socket, '' for nothing."""
        return caution(self._settings)

    def counts(self) -> dict[str, int]:
        """Return connections, clients that were turned away, damaged frames and skipped bytes."""
        counts = dict(self._counts)
        for client in list(self._clients):
            counts['malformed frames'] += client.parser.malformed
            counts['skipped bytes'] += client.parser.skipped
        return counts

    def trouble(self) -> str:
        """Return why the last client was turned away, '' where none was."""
        return self._reason

    def request(self, request: Request | TurnsRequest) -> bool:
        """Send a request to the connected digitiser; one that connects later gets the rates that are asked for.

        Whoever sees the ranges asks for a mode again, but for a rate only once.
        """
        if isinstance(request, TurnsRequest):
            if request.rate > 0.0:
                self._turns[request.peer] = request
            else:
                self._turns.pop(request.peer, None)
        elif self._active is None:
            return False
        if self._active is not None:
            self._requests.append(request)
            with contextlib.suppress(OSError):
                self._waker.send(b'.')
        return True

    def _run(self) -> None:
        with self._listener, self._waker, self._woken, self._selector:
            self._selector.register(self._listener, selectors.EVENT_READ)
            self._selector.register(self._woken, selectors.EVENT_READ)
            while not self._ended.is_set():
                for key, _ in self._selector.select(POLL):
                    if key.fileobj is self._listener:
                        self._accept()
                    elif key.data is None:
                        self._woken.recv(64)
                    elif key.data in self._clients:  # not disconnected meanwhile
                        self._serve(key.data)
                self._pass_requests()
                self._tidy(time.monotonic())
            for client in list(self._clients):
                self._disconnect(client, '')

    def _accept(self) -> None:
        for _ in range(_ACCEPTED):
            try:
                connection, address = self._listener.accept()
            except OSError:  # none is left, or it has gone again, or descriptors are short
                return
            if not is_heard(address[0], self._heard_from):
                self._counts['refused connections'] += 1
                self._reason = f'{address[0]} is not in feed_from'
                connection.close()
                continue
            try:
                client = Client(
                    connection,
                    address[0],
                    time.monotonic(),
                    self._key,
                    self._context,
                    self._settings.feed_samples,
                )
                client.flush()
            except (OSError, ValueError):
                connection.close()
                continue
            self._counts['connections'] += 1
            self._clients.append(client)
            self._selector.register(client.connection, selectors.EVENT_READ, client)
            if len(self._clients) > MOST_CLIENTS:
                self._make_room()

    def _make_room(self) -> None:
        others = [client for client in self._clients if client is not self._active]
        crowd = collections.Counter(client.host for client in others)
        host = max(crowd, key=crowd.__getitem__)
        self._disconnect(next(c for c in others if c.host == host), f'{host}: too many connections')

    def _serve(self, client: Client) -> None:
        now = time.monotonic()
        try:
            frames = client.receive(now)
        except ClientError as error:
            self._disconnect(client, str(error))
            return
        if not frames:
            return
        if client is not self._active and not self._is_free(now):
            client.held += frames
            self._selector.unregister(client.connection)  # what it sends further waits in its socket
            return
        self._activate(client)
        self._deliver(frames)

    def _is_free(self, now: float) -> bool:
        return self._active is None or now - self._active.heard > SILENCE

    def _activate(self, client: Client) -> None:
        if self._active is not client:
            if self._active is not None:
                self._disconnect(self._active, '')
            self._active = client
            self._requests.extend(self._turns.values())
        self.connected = True

    def _pass_requests(self) -> None:
        while self._requests:
            request = self._requests.popleft()
            if self._active is None or (isinstance(request, TurnsRequest) and self._active.version < 2):
                continue
            try:
                self._active.send(encode_request(request))
            except ClientError as error:
                self._disconnect(self._active, str(error))

    def _tidy(self, now: float) -> None:
        """Let one that waits take over, and disconnect those whose time is up."""
        for client in list(self._clients):
            if client.held:
                if self._is_free(now):
                    self._activate(client)
                    frames, client.held, client.heard = client.held, [], now
                    self._selector.register(client.connection, selectors.EVENT_READ, client)
                    self._deliver(frames)
                elif now - client.heard > self._settings.feed_timeout:
                    self._disconnect(client, f'{client.host}: another digitiser is connected')
            elif now - client.begun > self._settings.feed_timeout:
                self._disconnect(client, f'{client.host}: began a frame and did not finish it')

    def _disconnect(self, client: Client, reason: str) -> None:
        self._clients.remove(client)
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(client.connection)
        self._counts['malformed frames'] += client.parser.malformed + client.parser.unfinished
        self._counts['skipped bytes'] += client.parser.skipped
        if reason:
            self._counts['disconnected clients'] += 1
            self._reason = reason
        if client is self._active:
            self._active, self.connected = None, False
            client.heard = -math.inf
        client.close()
