"""Source `udp`: a digitiser sends frames as datagrams (docs/feed_protocol.md)."""

import collections
import contextlib
import math
import socket
import time
from typing import Any

from .feed import Frame, Request, TurnsRequest, encode_request
from .reassembly import FragmentAssembler
from .sealing import TO_DIGITISER, DatagramSealer, SealedDatagrams, SealError, read_key
from .sockets import SocketSettings, caution, is_heard, listening_socket, networks
from .source import BATCH, POLL, Source

_DATAGRAM = 1 << 16  # largest size [bytes]
_SILENCE = 1.0  # after which the source counts as not connected [s]
_TAKEOVER = 0.2  # without a whole frame, after which another sender's are taken [s]
_REPEAT = 1.0  # between two requests for the same rates: datagrams are lost, digitisers restart [s]
_MOST_REQUESTS = 64  # that wait to be sent


class UdpSource(Source, name='udp'):
    """Receives datagrams; there is no connection to lose. Frames of one sender at a time are taken.

    Requests go to where the newest frame came from.
    """

    settings = SocketSettings

    def __init__(self, station: str, settings: SocketSettings, **kwargs: Any) -> None:
        """Bind the socket; arguments as for `Source`.

        Raises:
            ConfigurationError: the settings cannot be used, or ask for TLS.
        """
        super().__init__(station, settings, **kwargs)
        settings.refuse_tls()
        self._settings, self._heard_from = settings, networks(settings.feed_from)
        key = read_key(settings.feed_key)
        self._sealed = SealedDatagrams(key) if key else None
        self._sealer = DatagramSealer(key, TO_DIGITISER) if key else None
        self.assembler = FragmentAssembler(settings.feed_samples)
        """Unfinished frames."""
        self._sender: Any = None
        self._last = self._asked = -math.inf
        self._version = 0  # of the feed, as the newest frame has it
        self._requests: collections.deque[Request | TurnsRequest] = collections.deque(maxlen=_MOST_REQUESTS)
        self._turns: dict[str, TurnsRequest] = {}  # by peer
        self._refused = self._others = 0
        self._reason = ''
        self._socket = listening_socket(socket.SOCK_DGRAM, settings)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.port: int = self._socket.getsockname()[1]

    def address(self) -> str:
        """Return the address as a URL."""
        return f'udp://{self._settings.ip_address}:{self.port}'

    def caution(self) -> str:
        """Return what is unsafe about the socket, '' for nothing."""
        return caution(self._settings)

    def counts(self) -> dict[str, int]:
        """Return damaged and incomplete frames, and what was refused."""
        return {
            'malformed frames': self.assembler.malformed,
            'incomplete frames': self.assembler.incomplete,
            'repeated datagrams': self.assembler.repeated,
            'refused datagrams': self._refused,
            'frames of another sender': self._others,
        }

    def trouble(self) -> str:
        """Return why the last datagram was refused, '' where none was."""
        return self._reason

    def request(self, request: Request | TurnsRequest) -> bool:
        """Send a request to the digitiser; one for a rate again and again, as long as frames come.

        Whoever sees the ranges asks for a mode again, but for a rate only once.
        """
        if isinstance(request, TurnsRequest):
            self._turns[request.peer] = request
        elif not self.connected:
            return False
        self._requests.append(request)
        return True

    def _run(self) -> None:
        with self._socket as receiver:
            while not self._ended.is_set():
                self.connected = time.monotonic() - self._last < _SILENCE
                frames = self._received(receiver)
                if frames:
                    self.connected = True
                    self._deliver(frames)
                if self.connected:
                    self._pass_requests(receiver)

    def _pass_requests(self, sender: socket.socket) -> None:
        """Send what waits, and once in a while all rates that are asked for, to the digitiser."""
        now = time.monotonic()
        if now - self._asked >= _REPEAT:
            self._asked = now
            self._requests.extend(turns for turns in list(self._turns.values()) if turns not in self._requests)
        while self._requests:
            request = self._requests.popleft()
            if isinstance(request, TurnsRequest) and self._version < 2:
                continue
            message = encode_request(request)
            with contextlib.suppress(OSError):  # as good as lost on the way
                sender.sendto(message if self._sealer is None else self._sealer.seal(message), self._sender)

    def _received(self, receiver: socket.socket) -> list[Frame]:
        """Return the frames that are complete: wait for the first datagram, then take what has queued up."""
        receiver.settimeout(POLL)
        frames: list[Frame] = []
        try:
            for _ in range(BATCH * BATCH):  # not for ever where they come faster than they are read
                datagram, sender = receiver.recvfrom(_DATAGRAM)
                receiver.settimeout(0.0)
                frame = self._taken(datagram, sender)
                if frame is not None:
                    frames.append(frame)
                if len(frames) >= BATCH:
                    break
        except (TimeoutError, BlockingIOError):
            pass
        return frames

    def _taken(self, datagram: bytes, sender: Any) -> Frame | None:
        """Return the frame that is complete with a datagram, None where there is none, or none to believe."""
        try:
            if not is_heard(sender[0], self._heard_from):
                raise SealError('is not in feed_from')
            if self._sealed is not None:
                datagram = self._sealed.open(datagram, time.time_ns())
        except SealError as error:
            self._refused += 1
            self._reason = f'{sender[0]}: {error}'
            return None
        now = time.monotonic()
        frame = self.assembler.feed(datagram, sender, now)
        if frame is None:
            return None
        if sender != self._sender and now - self._last < _TAKEOVER:
            self._others += 1
            self._reason = f'{sender[0]}: another digitiser is sending'
            return None
        self._sender, self._last, self._version = sender, now, frame.version
        return frame
