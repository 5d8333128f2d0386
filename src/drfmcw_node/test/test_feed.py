"""The digitiser's feed: what is sent arrives, and damage costs only what it hit."""

import contextlib
import dataclasses
import math
import socket
import struct
import threading
import time
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drfmcw_node.processing.processor import StationProcessor
from drfmcw_node.processing.records import Sweep
from drfmcw_node.sources.feed import (
    HEADER_SIZE,
    Frame,
    FrameParser,
    Request,
    TurnsRequest,
    decode_requests,
    encode,
    encode_fragments,
    encode_request,
)
from drfmcw_node.sources.reassembly import FragmentAssembler
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
    sent = [
        frame(0, rate=12.5, priority=-3),
        frame(1, 0),
        frame(2, 64, iq=True, peer='slave', mode=1, temperature=31.5, pll_locked=False),
        frame(3, peer='slave', version=1),  # of a digitiser that knows no rates
    ]
    stream = b''.join(map(encode, sent))
    parser, received, at = FrameParser(), [], 0
    while at < len(stream):
        size = data.draw(st.sampled_from(pieces))
        received += parser.feed(stream[at : at + size])
        at += size
    assert len(received) == 4 and parser.malformed == 0 and parser.skipped == 0
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


def test_a_frame_of_an_unknown_version_is_none():
    newer = bytearray(encode(frame(1)))
    newer[4] = 3
    parser = FrameParser()
    received = parser.feed(bytes(newer) + encode(frame(2)))
    assert [f.sweep_id for f in received] == [2] and parser.malformed == 1


REQUESTS = [Request(0, 3.41e-6, 'slave'), TurnsRequest(25.0, 2, 'slave'), Request(1, 6e-7), TurnsRequest(0.0, -1000)]


@given(where=st.integers(0, 1 + 2 * 52 + 2 * 56))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_requests_cut_anywhere(where):
    stream = b'x' + b''.join(map(encode_request, REQUESTS))
    first, rest = decode_requests(stream[:where])
    second, rest = decode_requests(rest + stream[where:])
    assert first + second == REQUESTS and rest == b''


def test_a_digitiser_of_version_1_finds_its_requests_as_they_were():
    body = struct.pack('<4sBBHd32s', b'DRFR', 1, 1, 0, 6e-7, b'slave')
    assert encode_request(Request(1, 6e-7, 'slave')) == body + struct.pack('<I', zlib.crc32(body))


@pytest.mark.parametrize('request_', REQUESTS[:2])
def test_requests_of_other_versions_and_damaged_ones_are_skipped(request_):
    newer, damaged = (bytearray(encode_request(request_)) for _ in range(2))
    newer[4], damaged[20] = 3, damaged[20] ^ 1
    stream = bytes(newer) + bytes(damaged) + encode_request(REQUESTS[2])
    assert decode_requests(stream) == (REQUESTS[2:3], b'')


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


def test_rates_reach_whichever_digitiser_connects(received):
    """Asked for before there is one, and of one that replaces another; of one of version 1 modes alone are."""
    source = opened(TcpSource, received)
    source.start()
    asked, mode = TurnsRequest(25.0, 1, 'slave'), Request(1, 6e-7, 'slave')
    try:
        assert source.request(asked)
        assert not source.request(mode)  # whoever sees ranges asks for it again
        for number in range(2):
            with socket.create_connection(('127.0.0.1', source.port), WAIT) as digitiser:
                digitiser.sendall(encode(frame(number)))
                assert decode_requests(digitiser.recv(4096))[0] == [asked]
        with socket.create_connection(('127.0.0.1', source.port), WAIT) as older:
            older.sendall(encode(frame(2, version=1)))
            received.until(3)
            assert source.request(asked) and source.request(mode)
            assert decode_requests(older.recv(4096))[0] == [mode]
        assert source.request(TurnsRequest(0.0, 0, 'slave'))  # none any more
        with socket.create_connection(('127.0.0.1', source.port), WAIT) as last:
            last.sendall(encode(frame(3)))
            received.until(4)
            assert source.request(mode)
            assert decode_requests(last.recv(4096))[0] == [mode]
    finally:
        source.stop()
    assert not received.errors


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


def udp_requests(sender, count):
    """The next different requests that reach a digitiser, which repeats of the same one do not change."""
    sender.settimeout(WAIT)
    found = []
    while len(found) < count:
        requests, rest = decode_requests(sender.recv(4096))
        assert len(requests) == 1 and rest == b''
        found += [request for request in requests if request not in found]
    return found


def test_requests_go_back_to_the_sender_over_udp_and_rates_again_and_again(received):
    """What was asked for before there is a digitiser, what is asked of a running one, and what a restarted one gets."""
    source = opened(UdpSource, received)
    source.start()
    asked, other, mode = TurnsRequest(25.0, 1, 'slave'), TurnsRequest(5.0, 0, 'second'), Request(1, 6e-7, 'slave')

    def send(sender, number, **changes):
        for datagram in encode_fragments(dataclasses.replace(frame(number), **changes), number):
            sender.sendto(datagram, ('127.0.0.1', source.port))
        received.until(number + 1)

    try:
        assert source.request(asked)  # for later
        assert not source.request(mode)  # nobody is there
        with udp_socket() as first:
            send(first, 0)
            assert udp_requests(first, 1) == [asked]
            assert source.request(mode) and source.request(other)
            send(first, 1)
            assert {mode, other} <= set(udp_requests(first, 3))
        time.sleep(0.3)  # after which another sender is taken
        with udp_socket() as restarted:
            send(restarted, 2)
            end, number, found = time.monotonic() + WAIT, 3, set()
            while found != {asked, other} and time.monotonic() < end:
                send(restarted, number)
                number += 1
                restarted.settimeout(0.05)
                with contextlib.suppress(TimeoutError):
                    found |= set(decode_requests(restarted.recv(4096))[0])
            assert found == {asked, other}  # each repeated; a mode is not
        time.sleep(0.3)
        with udp_socket() as older:
            send(older, number, version=1)
            assert source.request(mode)
            send(older, number + 1, version=1)
            assert udp_requests(older, 1) == [mode]  # the first one: no rates before it
    finally:
        source.stop()
    assert not received.errors


def test_address_in_use_is_said(received):
    with socket.create_server(('127.0.0.1', 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ConfigurationError, match=f'ip_port {port}'):
            opened(TcpSource, received, port)


# --- clients that are slow, silent, hostile ---


def rubbish(count, seed=1):
    return np.random.default_rng(seed).bytes(count)


@pytest.fixture
def running(received):
    """Return a function that starts a source; it ends with the test."""
    started = []

    def start(kind, **changes):
        source = kind(
            'master',
            SocketSettings(ip_port=0, **changes),
            deliver=received.deliver,
            failed=received.errors.append,
        )
        source.start()
        started.append(source)
        return source

    yield start
    for source in started:
        source.stop()
    assert not received.errors


def connected(source):
    return socket.create_connection(('127.0.0.1', source.port), WAIT)


def until(condition):
    """Wait for something that another thread does."""
    for _ in range(round(WAIT / 0.01)):
        if condition():
            return
        time.sleep(0.01)
    raise AssertionError('it did not happen')


@pytest.mark.parametrize(
    'sent', [b'', b'D', encode(frame(7))[:500], rubbish(300)], ids=['silent', 'drip', 'slow', 'noise']
)
def test_clients_that_do_not_deliver_lock_nobody_out(sent, running, received):
    """As many as may connect, ten times over, before the digitiser does; it is heard all the same."""
    source = running(TcpSource)
    with contextlib.ExitStack() as open_ones:
        for _ in range(80):
            idle = open_ones.enter_context(connected(source))
            with contextlib.suppress(OSError):
                idle.sendall(sent)
        with connected(source) as digitiser:
            digitiser.sendall(encode(frame(1)))
            assert received.until(1) == [1]
            for _ in range(20):
                open_ones.enter_context(connected(source))
            digitiser.sendall(encode(frame(2)))
            assert received.until(2) == [1, 2]
    until(lambda: source.counts()['connections'] == 101)


def test_a_frame_that_is_not_finished_is_given_up(running):
    source = running(TcpSource, feed_timeout=0.3)
    with connected(source) as slow:
        slow.settimeout(WAIT)
        slow.sendall(encode(frame(1))[:200])
        assert slow.recv(1) == b''
    until(lambda: source.counts()['disconnected clients'] == 1)
    assert 'did not finish' in source.trouble()


def test_a_second_digitiser_waits_while_the_first_one_sends(running, received):
    """Its frames come after those of the first; none of both is mixed in between."""
    source = running(TcpSource)
    with connected(source) as first, connected(source) as second:
        first.sendall(encode(frame(1)))
        received.until(1)
        second.sendall(encode(frame(100)))
        for number in range(2, 30):
            first.sendall(encode(frame(number)))
            received.until(number)
        assert received.until(30) == [*range(1, 30), 100]


def test_headers_that_promise_much_cost_little(running, received):
    """Whole headers of frames as large as allowed, one in the other: the checksums of all would take minutes."""
    source = running(TcpSource)
    header = bytearray(encode(frame(1, 0))[: HEADER_SIZE - 4])
    header[48:52] = (1 << 20).to_bytes(4, 'little')
    evil = bytes(header) + zlib.crc32(header).to_bytes(4, 'little')
    with connected(source) as client:
        with contextlib.suppress(OSError):
            client.sendall(evil * 30_000)
        with connected(source) as digitiser:
            digitiser.sendall(encode(frame(1)))
            assert received.until(1) == [1]
    assert source.counts()['malformed frames'] < 50


def test_unfinished_datagrams_take_bounded_memory(running, received):
    """30 000 pieces of frames that never end, and the digitiser's frame among them is complete.

    The socket may lose datagrams that come faster than they are read, so the digitiser sends until it is heard.
    """
    source = running(UdpSource, feed_samples=1 << 16)
    tracemalloc.start()
    try:
        with udp_socket() as hostile, udp_socket() as digitiser:
            for number in range(30_000):
                header = struct.pack('<4sBBHHHI', b'DRFU', 1, 0, number % 200, 201, 0, number // 200)
                hostile.sendto(header + bytes(1 + 1399 * (number % 2)), ('127.0.0.1', source.port))
                assert number % 100 or source.assembler.held <= source.assembler.bound
            for number in range(1, 200):
                for datagram in encode_fragments(frame(number, 2048), number):
                    digitiser.sendto(datagram, ('127.0.0.1', source.port))
                time.sleep(0.01)
                if received.frames:
                    break
        received.until(1)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()  # all that follows in this process would take four times as long
    assert source.assembler.bound < 500_000
    assert peak < 4_000_000  # the bound, and what the test itself and the received frames take
    assert source.assembler.incomplete > 30


def test_assembler_keeps_its_bound_and_drops_the_greedy():
    """Pieces of one byte and of 1400, many senders: the count stays within the bound, and a modest sender is served."""
    assembler = FragmentAssembler(largest_count=4096)
    rng = np.random.default_rng(3)
    modest = list(encode_fragments(frame(5, 2048), 5))
    assert assembler.feed(modest[0], 'modest') is None
    for _ in range(20_000):
        number, index, size = (int(rng.integers(high)) for high in (50, 16, 1400))
        header = struct.pack('<4sBBHHHI', b'DRFU', 1, 0, index, 17, 0, number)
        assembler.feed(header + bytes(size + 1), f'greedy {rng.integers(3)}')
        assert assembler.held <= assembler.bound
    found = [assembler.feed(datagram, 'modest') for datagram in modest[1:]]
    assert found[-1] is not None and found[-1].sweep_id == 5


def test_pieces_are_given_up_after_a_while():
    assembler = FragmentAssembler()
    first, second, third = encode_fragments(frame(1, 2048), 1)
    assembler.feed(first, now=0.0)
    assembler.feed(second, now=0.9)
    assert assembler.feed(third, now=1.1) is None
    assert assembler.incomplete == 1 and assembler.held < 2000


def udp_socket():
    return socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


def test_senders_that_are_not_listed_are_not_heard(running, received):
    tcp, udp = running(TcpSource, feed_from='10.0.0.0/8'), running(UdpSource, feed_from='10.0.0.0/8,::1')
    with connected(tcp) as client, udp_socket() as sender:
        client.settimeout(WAIT)
        assert client.recv(1) == b''
        for datagram in encode_fragments(frame(1), 1):
            sender.sendto(datagram, ('127.0.0.1', udp.port))
        until(lambda: udp.counts()['refused datagrams'])
    assert tcp.counts()['refused connections'] == 1 and not received.frames
    with pytest.raises(ConfigurationError, match='feed_from'):
        SocketSettings(feed_from='10.0.0.0/40')


# --- names from outside ---


def test_reasons_of_dropped_sweeps_are_bounded():
    """Sweeps with a thousand names: as many diagnostics keys as there may be, each on one short line."""
    processor = StationProcessor()
    for number in range(1000):
        samples = np.zeros(16, np.int16)
        peer = f'peer{number}\n' + 'x' * 90
        processor.process([Sweep('master', peer, number, 8192.0, False, samples, number, '')])
    assert len(processor.dropped) == 33 and processor.dropped.total() == 1000
    assert all(key.isprintable() and len(key) <= 120 for key in processor.dropped)
