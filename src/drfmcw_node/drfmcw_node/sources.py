"""Where a station's sweeps come from besides its topic: a TCP or UDP feed of a digitiser, or a recording.

Each source is a thread that hands over lists of what it got, in order: frames, or sweeps with their settings.
"""

import math
import socket
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.bag.files import BagError, BagReader
from drfmcw_ros.messages import from_message

from .feed import FragmentAssembler, FrameParser, Request, encode_request
from .processing import Sweep

_POLL = 0.2  # how often a thread looks whether it shall end [s]
_RECEIVE = 1 << 20  # bytes at once, of TCP
_DATAGRAM = 1 << 16
_BATCH = 64  # sweeps handed over at once


class Source:
    """A thread that delivers; subclasses fill in `_run`."""

    def __init__(self, deliver: Callable[[Sequence[Any]], None], failed: Callable[[Exception], None]) -> None:
        """Set up without starting.

        Args:
            deliver: called in the source's thread with each list of what came.
            failed: called once with an exception that ended the thread.
        """
        self._deliver, self._failed = deliver, failed
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._guarded, name=type(self).__name__, daemon=True)
        self.connected = False
        """True while data can come."""

    def start(self) -> None:
        """Begin to deliver."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._ended.set()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(timeout=5.0)

    def counts(self) -> dict[str, int]:
        """Return what went wrong so far, for diagnostics."""
        return {}

    def request(self, request: Request) -> bool:
        """Pass a settings request to the hardware; return False where there is no way to."""
        return False

    def _guarded(self) -> None:
        try:
            self._run()
        except Exception as error:  # the node decides what an end of its source means
            self._failed(error)
        finally:
            self.connected = False

    def _run(self) -> None:
        raise NotImplementedError


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
        self._listener = _bound(socket.SOCK_STREAM, address, port)
        self._listener.listen(2)
        self._listener.settimeout(_POLL)
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
                    connection.settimeout(_POLL)
                    self._connection, self.connected = connection, True
                    connection = self._read(connection)
                self._connection, self.connected = None, False
                self._parser.reset()
        finally:
            self._listener.settimeout(_POLL)

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


class UdpSource(Source):
    """Receives datagrams; there is no connection to lose."""

    def __init__(self, address: str, port: int, **kwargs: Any) -> None:
        """Receive at `address`:`port`.

        Raises:
            ConfigurationError: the address cannot be used.
        """
        super().__init__(**kwargs)
        self._assembler = FragmentAssembler()
        self._socket = _bound(socket.SOCK_DGRAM, address, port)
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
                receiver.settimeout(_POLL)
                frames = []
                try:
                    # block for the first datagram, then take what has queued up
                    while len(frames) < _BATCH:
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


class RecordingSource(Source):
    """Plays one station's sweeps from a recording, with the settings and calibrations that stand in it."""

    def __init__(self, path: str, station: str, rate: float, **kwargs: Any) -> None:
        """Open the recording.

        Args:
            path: of the rosbag2 recording.
            station: whose sweeps are played.
            rate: times as fast as recorded; 0 as fast as the station can.
            kwargs: as `Source`.

        Raises:
            BagError: not readable, or without what is needed.
        """
        super().__init__(**kwargs)
        self._path, self._station, self._rate = path, station, rate
        with BagReader(path) as bag:
            for name in ('if_samples', 'sweep_config', 'calibration'):
                bag.require(f'/{station}/{name}')

    def _run(self) -> None:
        self.connected = True
        start = time.monotonic()
        with BagReader(self._path) as bag:
            topics = [t for t in bag.topics if t.endswith('/calibration')]
            topics += [f'/{self._station}/{name}' for name in ('sweep_config', 'if_samples')]
            pending: list[Any] = []
            first = None
            for topic, _, message in bag.messages(topics):
                item = from_message(message, _KINDS[topic.rsplit('/', 1)[-1]])
                if isinstance(item, Sweep) and self._rate > 0.0:
                    first = item.stamp if first is None else first
                    due = start + (item.stamp - first) * 1e-9 / self._rate - time.monotonic()
                    if due > 0.0:
                        self._hand_over(pending)
                        if self._ended.wait(due):
                            return
                pending.append(item)
                if len(pending) >= _BATCH:
                    self._hand_over(pending)
                if self._ended.is_set():
                    return
            self._hand_over(pending)

    def _hand_over(self, pending: list[Any]) -> None:
        if pending:
            self._deliver(list(pending))
            pending.clear()


_KINDS = {'if_samples': Sweep, 'sweep_config': SweepSettings, 'calibration': Calibration}


def recorded_frames(path: str, station: str) -> tuple[SweepSettings, list[tuple[Sweep, SweepSettings]]]:
    """Return (first settings, sweeps with the settings that hold for them) of one station in a recording.

    Raises:
        BagError: not readable, or without the station's sweeps or settings.
    """
    with BagReader(path) as bag:
        for name in ('if_samples', 'sweep_config'):
            bag.require(f'/{station}/{name}')
        settings, sweeps, first = {}, [], None
        for topic, _, message in bag.messages([f'/{station}/sweep_config', f'/{station}/if_samples']):
            item = from_message(message, _KINDS[topic.rsplit('/', 1)[-1]])
            if isinstance(item, SweepSettings):
                settings[item.peer] = item
                first = first or item
            elif item.peer in settings:
                sweeps.append((item, settings[item.peer]))
    if first is None or not sweeps:
        raise BagError(f'{path}: no sweeps of {station} with settings')
    return first, sweeps


def _bound(kind: int, address: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ':' in address else socket.AF_INET
    made = socket.socket(family, kind)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((address, port))
    except (OSError, OverflowError) as error:
        made.close()
        raise ConfigurationError(f'ip_address {address}, ip_port {port}: {error}') from None
    return made
