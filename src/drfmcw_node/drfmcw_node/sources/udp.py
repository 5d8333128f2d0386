"""Source `udp`: a digitiser sends frames as datagrams (docs/feed_protocol.md)."""

import math
import socket
import time
from typing import Any

from .feed import FragmentAssembler, Frame
from .sockets import SocketSettings, listening_socket
from .source import BATCH, POLL, Source

_DATAGRAM = 1 << 16  # largest size [bytes]
_SILENCE = 1.0  # after which the source counts as not connected [s]


class UdpSource(Source, name='udp'):
    """Receives datagrams; there is no connection to lose."""

    settings = SocketSettings

    def __init__(self, station: str, settings: SocketSettings, **kwargs: Any) -> None:
        """Bind the socket; arguments as for `Source`."""
        super().__init__(station, settings, **kwargs)
        self._assembler = FragmentAssembler()
        self._socket = listening_socket(socket.SOCK_DGRAM, settings)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self._host = settings.ip_address
        self.port: int = self._socket.getsockname()[1]

    def address(self) -> str:
        """Return the address as a URL."""
        return f'udp://{self._host}:{self.port}'

    def counts(self) -> dict[str, int]:
        """Return damaged and incomplete frames."""
        return {'malformed frames': self._assembler.malformed, 'incomplete frames': self._assembler.incomplete}

    def _run(self) -> None:
        last = -math.inf
        with self._socket as receiver:
            while not self._ended.is_set():
                self.connected = time.monotonic() - last < _SILENCE
                frames = self._received(receiver)
                if frames:
                    last = time.monotonic()
                    self.connected = True
                    self._deliver(frames)

    def _received(self, receiver: socket.socket) -> list[Frame]:
        """Return the frames that are complete: wait for the first datagram, then take what has queued up."""
        receiver.settimeout(POLL)
        frames: list[Frame] = []
        try:
            while len(frames) < BATCH:
                frame = self._assembler.feed(receiver.recv(_DATAGRAM))
                receiver.settimeout(0.0)
                if frame is not None:
                    frames.append(frame)
        except (TimeoutError, BlockingIOError):
            pass
        return frames
