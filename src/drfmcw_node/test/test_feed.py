"""The digitiser's feed: what is sent arrives, and damage costs only what it hit."""

import dataclasses
import math
import socket
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drfmcw_node.sources.feed import (
    HEADER_SIZE,
    FragmentAssembler,
    Frame,
    FrameParser,
    Request,
    decode_requests,
    encode,
    encode_fragments,
    encode_request,
)
from drfmcw_node.sources.sockets import SocketSettings
from drfmcw_node.sources.tcp import TcpSource
from drfmcw_node.sources.udp import UdpSource
from drfmcw_physics.settings import ConfigurationError

WAIT = 10.0  # [s]


def frame(number=0, count=300, iq=False, **changes):
    samples = np.random.default_rng(number).integers(-32768, 32767, count, np.int16)
    return Frame(number, 1_700_000_000_000_000_000 + number, 8192.0, iq, samples, start_delay=3.41e-6, **changes)


def same(first, second):
    for field in dataclasses.fields(Frame):
        a, b = getattr(first, field.name), getattr(second, field.name)
        if field.name == 'samples':
            assert np.array_equal(a, b)
        else:
            assert a == b or (a != a and b != b), field.name


@given(pieces=st.lists(st.integers(1, 1000), min_size=1, max_size=40), data=st.data())
@settings(max_examples=50, deadline=None, derandomize=True)
def test_stream_cut_anywhere(pieces, data):
    sent = [frame(0), frame(1, 0), frame(2, 64, iq=True, peer='slave', mode=1, temperature=31.5, pll_locked=False)]
    stream = b''.join(map(encode, sent))
    parser, received, at = FrameParser(), [], 0
    while at < len(stream):
        size = data.draw(st.sampled_from(pieces))
        received += parser.feed(stream[at : at + size])
        at += size
    assert len(received) == 3 and parser.malformed == 0 and parser.skipped == 0
    for a, b in zip(sent, received, strict=True):
        same(a, b)


@given(where=st.integers(0, 3 * (HEADER_SIZE + 604) - 1), value=st.integers(1, 255))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_one_wrong_byte_costs_one_frame(where, value):
    stream = bytearray(b''.join(encode(frame(i)) for i in range(4)))
    stream[where] ^= value
    parser = FrameParser()
    received = parser.feed(bytes(stream))
    lost = where // (HEADER_SIZE + 604)
    assert [f.sweep_id for f in received] == [i for i in range(4) if i != lost]
    assert parser.skipped == HEADER_SIZE + 604


@given(noise=st.binary(max_size=2000), lost=st.integers(0, 200))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_resynchronises_after_noise_and_a_lost_piece(noise, lost):
    """After noise, and after bytes that never came, the next whole frame is found."""
    parser = FrameParser()
    received = parser.feed(noise + encode(frame(1))[: -1 - lost] + encode(frame(2)) + encode(frame(3)))
    assert [f.sweep_id for f in received][-2:] == [2, 3]


@given(order=st.permutations(range(6)))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_datagrams_in_any_order(order):
    sent = [frame(i, 2048, peer='slave') for i in range(2)]
    datagrams = [d for i, f in enumerate(sent) for d in encode_fragments(f, i)]
    assert len(datagrams) == 6
    assembler = FragmentAssembler()
    received = [f for i in order if (f := assembler.feed(datagrams[i])) is not None]
    assert assembler.malformed == assembler.incomplete == 0
    for a, b in zip(sent, sorted(received, key=lambda f: f.sweep_id), strict=True):
        same(a, b)


def test_lost_and_damaged_datagrams_are_counted():
    assembler = FragmentAssembler()
    for number in range(30):
        for index, datagram in enumerate(encode_fragments(frame(number, 2048), number)):
            if index:
                assert assembler.feed(datagram) is None
    assert assembler.incomplete == 30 - 16
    assert assembler.feed(b'DRFU') is None and assembler.feed(bytes(100)) is None
    damaged = bytearray(next(encode_fragments(frame(99, 10), 99)))
    damaged[-10] ^= 1
    assert assembler.feed(bytes(damaged)) is None
    assert assembler.malformed == 3


def test_requests():
    sent = [Request(0, 3.41e-6, 'slave'), Request(1, 6e-7)]
    stream = b'x' + b''.join(map(encode_request, sent))
    assert decode_requests(stream) == (sent, b'')
    first, rest = decode_requests(stream[:-5])
    assert first == sent[:1] and decode_requests(rest + stream[-5:]) == (sent[1:], b'')


def test_name_too_long():
    with pytest.raises(ConfigurationError, match='longer than 32 bytes'):
        encode(frame(peer='x' * 33))


class Received:
    """Collects what a source delivers."""

    def __init__(self):
        self.frames, self.errors, self._changed = [], [], threading.Condition()

    def deliver(self, frames):
        with self._changed:
            self.frames += frames
            self._changed.notify_all()

    def until(self, count):
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.frames) >= count, WAIT)
        return [f.sweep_id for f in self.frames]


@pytest.fixture
def received():
    return Received()


def opened(source, received, port=0):
    return source('master', SocketSettings(ip_port=port), deliver=received.deliver, failed=received.errors.append)


def test_tcp_survives_a_lost_connection(received):
    """A digitiser that vanishes in mid-frame, even without closing, can come back."""
    source = opened(TcpSource, received)
    source.start()
    try:
        silent = socket.create_connection(('127.0.0.1', source.port), WAIT)
        silent.sendall(encode(frame(1)) + encode(frame(2))[:100])
        assert received.until(1) == [1]
        with socket.create_connection(('127.0.0.1', source.port), WAIT) as again:
            again.sendall(encode(frame(3)))
            assert received.until(2) == [1, 3]
            assert source.connected
            request = Request(1, 6e-7, 'slave')
            assert source.request(request)
            assert decode_requests(again.recv(4096))[0] == [request]
        silent.close()
        with socket.create_connection(('127.0.0.1', source.port), WAIT) as third:
            third.sendall(encode(frame(4)))
            assert received.until(3) == [1, 3, 4]
    finally:
        source.stop()
    assert not received.errors and source.counts()['malformed frames'] == 1 and not source.connected


def test_udp(received):
    source = opened(UdpSource, received)
    source.start()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for number in range(5):
                for datagram in encode_fragments(frame(number, 2048), number):
                    sender.sendto(datagram, ('127.0.0.1', source.port))
                received.until(number + 1)
    finally:
        source.stop()
    assert received.until(5) == [0, 1, 2, 3, 4] and not received.errors
    assert math.isfinite(received.frames[0].start_delay)


def test_address_in_use_is_said(received):
    with socket.create_server(('127.0.0.1', 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ConfigurationError, match=f'ip_port {port}'):
            opened(TcpSource, received, port)
