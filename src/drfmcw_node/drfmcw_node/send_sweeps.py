"""Sends a station's recorded sweeps as a digitiser would: an example of the feed protocol, and a test signal.

ros2 run drfmcw_node send_sweeps RECORDING --station master --to tcp://127.0.0.1:9000
"""

import argparse
import select
import socket
import ssl
import sys
import time
import urllib.parse
from collections.abc import Sequence
from typing import Any

from drfmcw_physics.rules.schedule import NO_TURNS
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import Parser, guarded

from .sources.feed import (
    FRAGMENT_PAYLOAD,
    SEALED_PAYLOAD,
    Frame,
    Request,
    TurnsRequest,
    decode_requests,
    encode,
    encode_fragments,
)
from .sources.recording import recorded_frames, recorded_shares
from .sources.sealing import (
    HELLO_SIZE,
    TO_DIGITISER,
    TO_STATION,
    DatagramSealer,
    SealedDatagrams,
    SealedStream,
    SealError,
    decode_hello,
    read_key,
    seal,
)

_RETRY = 1.0  # [s]
_TIMEOUT = 5.0  # of a connection [s]
_LARGEST_REQUEST = 1024  # [bytes]


def main(argv: Sequence[str] | None = None) -> int:
    """Send and return the exit status."""
    parser = Parser(prog='send_sweeps', description='Send recorded sweeps to a station node as a digitiser would.')
    parser.add_argument('recording', help='rosbag2 recording with if_samples and sweep_config')
    parser.add_argument('--station', required=True, help='whose sweeps are sent')
    parser.add_argument('--to', required=True, metavar='tcp://HOST:PORT', help='or udp://HOST:PORT, the station node')
    parser.add_argument('--rate', type=float, default=0.0, metavar='HZ', help='sweeps per second (as recorded)')
    parser.add_argument('--repeat', type=int, default=1, metavar='N', help='send the recording N times (default: 1)')
    parser.add_argument('--key', default='', metavar='FILE', help='key that the station shares (its feed_key)')
    parser.add_argument('--tls-ca', metavar='FILE', help='authority of the station (PEM): connect with TLS')
    parser.add_argument('--tls-certificate', metavar='FILE', help='certificate chain to show to the station (PEM)')
    parser.add_argument('--tls-key', metavar='FILE', help='private key of that certificate (PEM)')
    parser.add_argument('--now', action='store_true', help='stamp sweeps with the time of sending')
    arguments = parser.parse_args(argv)
    return guarded(parser.prog, lambda: _send(arguments))


def _send(arguments: argparse.Namespace) -> None:
    target = urllib.parse.urlsplit(arguments.to)
    try:
        address = (target.hostname, target.port)
    except ValueError:
        address = (None, None)
    if target.scheme not in ('tcp', 'udp') or None in address:
        raise ConfigurationError(f"--to '{arguments.to}' is not tcp://HOST:PORT or udp://HOST:PORT")
    if arguments.rate < 0.0 or arguments.repeat < 1:
        raise ConfigurationError('--rate must not be negative and --repeat at least 1')
    _, sweeps = recorded_frames(arguments.recording, arguments.station)
    shares = recorded_shares(arguments.recording, arguments.station)
    key, context = read_key(arguments.key), _tls(arguments)
    if context is not None and target.scheme != 'tcp':
        raise ConfigurationError('--tls-ca: TLS needs tcp://; udp:// takes --key')
    sender = _TcpSender(address, key, context) if target.scheme == 'tcp' else _UdpSender(address, key)
    span = sweeps[-1][0].stamp - sweeps[0][0].stamp + 1_000_000
    start, sent = time.monotonic(), 0
    for round_number in range(arguments.repeat):
        for sweep, settings in sweeps:
            passed = sweep.stamp - sweeps[0][0].stamp + round_number * span
            due = sent / arguments.rate if arguments.rate else passed * 1e-9
            time.sleep(max(0.0, start + due - time.monotonic()))
            stamp = time.time_ns() if arguments.now else sweep.stamp + round_number * span
            granted = shares[sweep.peer].at(sweep.stamp) if sweep.peer in shares else None
            rate, priority = granted[1].turns if granted is not None else NO_TURNS
            sender.send(
                Frame(
                    sweep_id=sweep.sweep_id + round_number * (sweeps[-1][0].sweep_id + 1),
                    stamp=stamp,
                    full_scale=sweep.full_scale,
                    iq=sweep.iq,
                    samples=sweep.samples,
                    peer=sweep.peer,
                    mode=settings.mode,
                    start_delay=settings.start_delay,
                    rate=rate,
                    priority=priority,
                )
            )
            sent += 1
    sender.close()
    print(f'{sent} sweeps sent to {arguments.to}')


def _tls(arguments: argparse.Namespace) -> ssl.SSLContext | None:
    """Return what TLS needs, None where it is not asked for."""
    if not arguments.tls_ca:
        if arguments.tls_certificate or arguments.tls_key:
            raise ConfigurationError('--tls-certificate and --tls-key need --tls-ca')
        return None
    try:
        context = ssl.create_default_context(cafile=arguments.tls_ca)
        if arguments.tls_certificate:
            context.load_cert_chain(arguments.tls_certificate, arguments.tls_key)
    except OSError as error:
        raise ConfigurationError(f'--tls-ca, --tls-certificate, --tls-key: {error}') from None
    return context


class _TcpSender:
    """Connects, and connects again where the station went away."""

    def __init__(self, address: tuple[str, int], key: bytes, context: ssl.SSLContext | None) -> None:
        self._address, self._key, self._context = address, key, context
        self._socket: socket.socket | None = None
        self._received = b''
        self._session, self._number = b'', 0
        self._requests: SealedStream | None = None

    def send(self, frame: Frame) -> None:
        """Send one frame; wait for the station where it is not there."""
        data = encode(frame)
        while True:
            try:
                if self._socket is None:
                    self._socket = self._connected()
                message = data
                if self._key:
                    message = seal(data, self._key, TO_STATION, self._number, self._session)
                    self._number += 1
                self._socket.sendall(message)
                self._say_requests(self._socket)
                return
            except (OSError, SealError) as error:
                print(f'send_sweeps: {self._address[0]}:{self._address[1]}: {error}; trying again', file=sys.stderr)
                self.close()
                self._socket = None
                time.sleep(_RETRY)

    def close(self) -> None:
        """End the connection after everything was sent."""
        if self._socket is not None:
            self._socket.close()

    def _connected(self) -> socket.socket:
        """Return a connection, with the session of a station that has a key."""
        made = socket.create_connection(self._address, timeout=_TIMEOUT)
        try:
            if self._context is not None:
                made = self._context.wrap_socket(made, server_hostname=self._address[0])
            if self._key:
                hello = b''
                while len(hello) < HELLO_SIZE:
                    received = made.recv(HELLO_SIZE - len(hello))
                    if not received:
                        raise ConnectionError('the station closed the connection')
                    hello += received
                self._session, self._number = decode_hello(hello), 0
                self._requests = SealedStream(self._key, self._session, TO_DIGITISER, _LARGEST_REQUEST)
        except BaseException:
            made.close()
            raise
        return made

    def _say_requests(self, connection: socket.socket) -> None:
        """Show what the station asks for; a recording cannot follow it."""
        while select.select([connection], [], [], 0.0)[0]:
            data = connection.recv(4096)
            if not data:
                raise ConnectionError('the station closed the connection')
            if self._requests is not None:
                data = self._requests.feed(data)
            requests, self._received = decode_requests(self._received + data)
            for request in requests:
                _say(request)


def _say(request: Request | TurnsRequest) -> None:
    if isinstance(request, Request):
        asked = f'mode {request.mode}, start_delay {request.start_delay:g} s'
    else:
        asked = f'rate {request.rate:g} Hz, priority {request.priority}'
    print(f'requested: {asked}, peer {request.peer!r}')


class _UdpSender:
    """Sends datagrams, whether or not someone receives them."""

    def __init__(self, address: tuple[str, int], key: bytes) -> None:
        self._sealer = DatagramSealer(key, TO_STATION) if key else None
        self._sealed = SealedDatagrams(key, direction=TO_DIGITISER) if key else None
        self._newest: dict[tuple[type, str], Request | TurnsRequest] = {}  # by kind and peer
        try:
            family, kind, _, _, found = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise ConfigurationError(f'{address[0]}:{address[1]}: {error}') from None
        self._address: Any = found  # whose form depends on the family
        self._socket = socket.socket(family, kind)
        self._number = 0

    def send(self, frame: Frame) -> None:
        """Send one frame."""
        for datagram in encode_fragments(frame, self._number, SEALED_PAYLOAD if self._sealer else FRAGMENT_PAYLOAD):
            self._socket.sendto(datagram if self._sealer is None else self._sealer.seal(datagram), self._address)
        self._number += 1
        self._say_requests()

    def _say_requests(self) -> None:
        """Show what the station asks for, once while it repeats it; what others send is not heard."""
        while select.select([self._socket], [], [], 0.0)[0]:
            datagram, sender = self._socket.recvfrom(_LARGEST_REQUEST)
            if sender[:2] != self._address[:2]:
                continue
            try:
                message = datagram if self._sealed is None else self._sealed.open(datagram, time.time_ns())
            except SealError as error:
                print(f'send_sweeps: {sender[0]}: {error}', file=sys.stderr)
                continue
            for request in decode_requests(message)[0]:
                kind = type(request), request.peer
                if self._newest.get(kind) != request:
                    self._newest[kind] = request
                    _say(request)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


if __name__ == '__main__':
    raise SystemExit(main())
