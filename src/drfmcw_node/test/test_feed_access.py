"""Who may feed a station: keys, certificates, and what happens to those who have none."""

import contextlib
import shutil
import ssl
import struct
import subprocess
import time
from pathlib import Path

import pytest
from test_feed import (  # noqa: F401 - fixtures
    WAIT,
    connected,
    frame,
    received,
    rubbish,
    running,
    udp_socket,
    until,
)

from drfmcw_node.send_sweeps import _UdpSender
from drfmcw_node.sources.feed import (
    SEALED_PAYLOAD,
    Request,
    TurnsRequest,
    decode_requests,
    encode,
    encode_fragments,
    encode_request,
)
from drfmcw_node.sources.sealing import (
    HELLO_SIZE,
    TO_DIGITISER,
    TO_STATION,
    SealedDatagrams,
    SealedStream,
    SealError,
    decode_hello,
    read_key,
    seal,
)
from drfmcw_node.sources.sockets import SocketSettings, caution
from drfmcw_node.sources.tcp import TcpSource
from drfmcw_node.sources.udp import UdpSource
from drfmcw_physics.settings import ConfigurationError

KEY = b'sixteen bytes or more of it'


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / 'key'
    path.write_bytes(KEY + b'\n')
    path.chmod(0o600)
    return str(path)


def test_key_file_is_refused_where_others_may_read_it_or_it_is_short(tmp_path, key_file):
    assert read_key(key_file) == KEY
    Path(key_file).chmod(0o640)
    with pytest.raises(ConfigurationError, match='chmod 600'):
        read_key(key_file)
    Path(key_file).write_bytes(b'short')
    Path(key_file).chmod(0o600)
    with pytest.raises(ConfigurationError, match='at least 16'):
        read_key(key_file)
    with pytest.raises(ConfigurationError, match='feed_key'):
        read_key(str(tmp_path / 'none'))


def flipped(message):
    """Return a message of whose last byte one bit is wrong."""
    return message[:-1] + bytes([message[-1] ^ 1])


def greeted(source):
    """Return a connection and the session that the station gave to it."""
    client = connected(source)
    client.settimeout(WAIT)
    return client, decode_hello(client.recv(HELLO_SIZE))


def test_tcp_with_a_key(running, received, key_file):  # noqa: F811
    """Sealed frames are heard; plain ones, those of another key, repeated and left-out ones end the connection."""
    source = running(TcpSource, feed_key=key_file)
    client, session = greeted(source)
    recorded = [seal(encode(frame(i)), KEY, TO_STATION, i, session) for i in range(4)]
    with client:
        client.sendall(recorded[0] + recorded[1])
        assert received.until(2) == [0, 1]
        request = Request(1, 6e-7, 'slave')
        assert source.request(request)
        answer = SealedStream(KEY, session, TO_DIGITISER, 1000).feed(client.recv(4096))
        assert decode_requests(answer) == ([request], b'')
    attacks = [
        lambda of: encode(frame(9)),
        lambda of: seal(encode(frame(9)), b'another key of 16 bytes', TO_STATION, 0, of),
        lambda of: recorded[0],  # a recorded connection, played again
        lambda of: seal(encode(frame(9)), KEY, TO_DIGITISER, 0, of),  # what the station said, sent back
        lambda of: seal(encode(frame(9)), KEY, TO_STATION, 1, of),  # the first one left out
        lambda of: flipped(seal(encode(frame(9)), KEY, TO_STATION, 0, of)),
        lambda of: struct.pack('<4sBBHIQ16s', b'DRFA', 1, 0, 0, 1 << 31, 0, of),
        lambda of: rubbish(200),
    ]
    for attack in attacks:
        hostile, session = greeted(source)
        with hostile:
            hostile.sendall(attack(session))
            with contextlib.suppress(ConnectionResetError):
                assert hostile.recv(1) == b''
    client, session = greeted(source)
    with client:
        client.sendall(seal(encode(frame(5)), KEY, TO_STATION, 0, session))
        assert received.until(3) == [0, 1, 5]
    assert source.counts()['disconnected clients'] == len(attacks)


def test_udp_with_a_key(running, received, key_file):  # noqa: F811
    source = running(UdpSource, feed_key=key_file)
    pieces = list(encode_fragments(frame(1, 2048), 1, SEALED_PAYLOAD))
    begin = time.time_ns()
    sealed = [seal(piece, KEY, TO_STATION, begin + i) for i, piece in enumerate(pieces)]
    assert max(map(len, sealed)) <= 1472  # one Ethernet frame with IPv4
    with udp_socket() as sender:
        for datagram in [*pieces, sealed[0][:-1] + b'?', *reversed(sealed), *sealed]:  # the last ones are replayed
            sender.sendto(datagram, ('127.0.0.1', source.port))
        until(lambda: source.counts()['refused datagrams'] == 2 * len(pieces) + 1)
    assert received.until(1) == [1]


def test_udp_requests_are_sealed_and_sender_hears_no_other(running, received, key_file, capsys):  # noqa: F811
    """The example's sender says a request once, however often it is repeated, and refuses what bears no seal."""
    source = running(UdpSource, feed_key=key_file)
    sender = _UdpSender(('127.0.0.1', source.port), KEY)
    source.request(TurnsRequest(25.0, 1, 'slave'))
    said, number, end = '', 0, time.monotonic() + WAIT
    while said.count('requested') < 2 and time.monotonic() < end:
        sender.send(frame(number))
        number += 1
        if number == 20:
            source.request(TurnsRequest(5.0, 0, 'slave'))
        time.sleep(0.01)
        said += capsys.readouterr().out
    assert said == "requested: rate 25 Hz, priority 1, peer 'slave'\nrequested: rate 5 Hz, priority 0, peer 'slave'\n"
    sender.close()
    with udp_socket() as station:
        station.bind(('127.0.0.1', 0))
        sender = _UdpSender(station.getsockname(), KEY)
        sender.send(frame(0))
        _, address = station.recvfrom(1 << 16)
        request = encode_request(TurnsRequest(50.0, 1, 'slave'))
        station.sendto(request, address)
        station.sendto(seal(request, KEY, TO_STATION, time.time_ns()), address)  # what a sender said, sent back
        with udp_socket() as stranger:
            stranger.sendto(seal(request, KEY, TO_DIGITISER, time.time_ns()), address)
        time.sleep(0.1)
        sender.send(frame(1))
        found = capsys.readouterr()
        assert found.out == '' and 'no sealed message' in found.err and 'another direction' in found.err
        good = seal(request, KEY, TO_DIGITISER, time.time_ns())
        for _ in range(2):
            station.sendto(good, address)  # the second one is a replay
        time.sleep(0.1)
        sender.send(frame(2))
        found = capsys.readouterr()
        assert found.out.count('rate 50 Hz') == 1 and 'repeated' in found.err
        sender.close()


def test_sealed_datagrams_count_once_and_in_their_time():
    started = 1_700_000_000_000_000_000
    box = SealedDatagrams(KEY, started)
    good = [seal(b'x', KEY, TO_STATION, started + 1 + i) for i in range(5000)]
    for datagram in reversed(good[:100]):
        assert box.open(datagram, started) == b'x'
    for stale in (good[50], seal(b'x', KEY, TO_STATION, started), seal(b'x', KEY, TO_STATION, started + 11 * 10**9)):
        with pytest.raises(SealError):
            box.open(stale, started)
    for datagram in good[100:]:
        box.open(datagram, started)
    for datagram in good:
        with pytest.raises(SealError):
            box.open(datagram, started)


@pytest.fixture
def authority(tmp_path):
    """Files of an authority, a station and a digitiser, made by openssl."""
    if not shutil.which('openssl'):
        pytest.skip('no openssl to make certificates with')

    def openssl(*words):
        subprocess.run(['openssl', *words], cwd=tmp_path, check=True, capture_output=True, timeout=60)

    for name in ('authority', 'other'):
        openssl(
            *f'req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN={name}'.split(),
            *f'-keyout {name}.key -out {name}.pem'.split(),
        )
    (tmp_path / 'names').write_text('subjectAltName=IP:127.0.0.1\n')
    for name, signer in (('station', 'authority'), ('digitiser', 'authority'), ('stranger', 'other')):
        openssl(
            *f'req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN={name}'.split(),
            *f'-keyout {name}.key -out {name}.csr'.split(),
        )
        openssl(
            *f'x509 -req -in {name}.csr -CA {signer}.pem -CAkey {signer}.key -CAcreateserial'.split(),
            *f'-days 2 -extfile names -out {name}.pem'.split(),
        )
    return tmp_path


def test_tls(running, received, authority):  # noqa: F811
    """A digitiser with a certificate of the authority is heard; one of another, without one, or without TLS is not."""
    source = running(
        TcpSource,
        tls_certificate=str(authority / 'station.pem'),
        tls_key=str(authority / 'station.key'),
        tls_clients=str(authority / 'authority.pem'),
        feed_timeout=1.0,
    )

    def client(name):
        context = ssl.create_default_context(cafile=authority / 'authority.pem')
        if name:
            context.load_cert_chain(authority / f'{name}.pem', authority / f'{name}.key')
        return context.wrap_socket(connected(source), server_hostname='127.0.0.1')

    with connected(source) as silent, connected(source) as plain:  # before the handshake
        plain.sendall(encode(frame(8)))
        for name in ('stranger', ''):
            with pytest.raises(OSError), client(name) as refused:
                refused.sendall(encode(frame(9)))
                if refused.recv(1) == b'':
                    raise ConnectionResetError
        with client('digitiser') as digitiser:
            digitiser.sendall(encode(frame(1, 100_000)))
            assert received.until(1) == [1]
            assert source.request(Request(1, 6e-7, 'slave'))
            assert decode_requests(digitiser.recv(4096))[0] == [Request(1, 6e-7, 'slave')]
        silent.settimeout(WAIT)
        assert silent.recv(1) == b''


def test_only_a_feed_that_anyone_reaches_is_cautioned(key_file):
    assert not caution(SocketSettings())
    assert 'feed_key' in caution(SocketSettings(ip_address='0.0.0.0'))
    assert not caution(SocketSettings(ip_address='0.0.0.0', feed_key=key_file))
    with pytest.raises(ConfigurationError, match='TLS needs source tcp'):
        SocketSettings(tls_certificate='a', tls_key='b').refuse_tls()
    with pytest.raises(ConfigurationError, match='go together'):
        SocketSettings(tls_certificate='a')
