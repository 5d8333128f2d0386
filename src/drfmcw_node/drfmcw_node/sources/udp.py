"""Source `udp`: a digitiser that sends frames as datagrams (docs/feed_protocol.md)."""

import math
import socket
import time
from typing import Any

from .feed import FragmentAssembler
from .sockets import bound
from .source import BATCH, POLL, Source

_DATAGRAM = 1 << 16  # the largest there is [bytes]


class UdpSource(Source):
    """Receives datagrams; there is no connection to lose."""

    def __init__(self, address: str, port: int, **kwargs: Any) -> None:
        """Receive at `address`:`port`.

        Raises:
            ConfigurationError: the address cannot be used.
        """
        super().__init__(**kwargs)
        self._assembler = FragmentAssembler()
        self._socket = bound(socket.SOCK_DGRAM, address, port)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.port = self._socket.getsockname()[1]

    def counts(self) -> dict[str, int]:
        """Return damaged and incomplete frames."""
        return {'malformed frames': self._assembler.malformed, 'incomplete frames': self._assembler.incomplete}

    def _run(self) -> None:
        last = -math.inf
        with self._socket as receiver:
            while not self._ended.is_set():
                self.connected = time.monotonic() - last < 1.0
                receiver.settimeout(POLL)
                frames = []
                try:
                    # block for the first datagram, then take what has queued up
                    while len(frames) < BATCH:
                        frame = self._assembler.feed(receiver.recv(_DATAGRAM))
                        receiver.settimeout(0.0)
                        if frame is not None:
                            frames.append(frame)
                except (TimeoutError, BlockingIOError):
                    pass
                if frames:
                    last = time.monotonic()
                    self.connected = True
                    self._deliver(frames)
