"""What a controller reads: states, registers and status codes, by independent clients of both protocols."""

import asyncio
import dataclasses
import math
import socket
import struct
import time

import pytest
from other_controller import answer, ask, certified, float32, started
from ports import free_port

pytest.importorskip('asyncua')
pytest.importorskip('pymodbus')

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from pymodbus.client import ModbusTcpClient

from drfmcw_gateway.board import Board
from drfmcw_gateway.certificates import make_certificate
from drfmcw_gateway.gateway import main
from drfmcw_gateway.quantities import (
    BLOCK,
    GATEWAY_QUANTITIES,
    GATEWAY_REGISTERS,
    NOT_A_NUMBER,
    PAIR_QUANTITIES,
    PAIR_REGISTERS,
    QUALITY_MEANINGS,
    Kind,
    offsets,
    pair_registers,
)
from drfmcw_gateway.reading import FLAG_SHIFT, STATES, USABLE, Controller, Estimate, PairState, Quality
from drfmcw_gateway.serving import Servers
from drfmcw_gateway.settings import GatewaySettings
from drfmcw_physics.settings import ConfigurationError

SECOND = 1_000_000_000
STAMP = 1_800_000_000 * SECOND + 123_456_789
GOOD = Estimate(7, 0, 412.345678, 0.0012, -0.75, 0.011, 0, STAMP)
AT = offsets(PAIR_QUANTITIES)
LIMIT = 20.0  # for anything that is waited for, on a busy machine [s]
MARGIN = 2.0  # of a promised time-out, on a busy machine [s]


def reading_of(estimate, silence=0.0, age=0.01, **keywords):
    state = PairState(timeout=0.2, age_limit=1.0)
    state.take(estimate, 100.0, mixed=keywords.pop('mixed', False))
    return state.reading(100.0 + silence, estimate.stamp + round(age * SECOND), **keywords)


# --- quality ---


def test_exactly_one_state_is_set_whatever_happens():
    for flags in range(256):
        for silence in (0.0, 0.19, 0.2, 10.0):
            for age in (-5.0, 0.0, 5.0):
                for mixed in (False, True):
                    found = reading_of(dataclasses.replace(GOOD, flags=flags), silence, age, mixed=mixed)
                    assert (int(found.state)).bit_count() == 1
                    assert int(found.quality) >> FLAG_SHIFT == flags
                    usable = bool(found.state & USABLE)
                    assert usable == (silence < 0.2 and abs(age) <= 1.0 and not mixed and not flags & (1 | 2 | 16 | 32))
                    assert usable == math.isfinite(found.value('range'))
    assert PairState(0.2, 1.0).reading(0.0, 0).state == Quality.NO_RANGE


def test_zero_registers_are_never_a_quality():
    assert not any(int(state) == 0 for state in Quality if state & STATES)


@pytest.mark.parametrize(
    ('flags', 'state'),
    [
        (0, Quality.VALID),
        (4, Quality.DOUBTFUL),
        (8, Quality.DOUBTFUL),
        (64, Quality.DOUBTFUL),
        (128, Quality.DOUBTFUL),
        (1, Quality.REFUSED),
        (2, Quality.REFUSED),
        (16, Quality.REFUSED),
        (32, Quality.REFUSED),
        (160, Quality.REFUSED),
    ],
)
def test_flags_decide_as_the_documentation_says(flags, state):
    """docs/sensors_and_flags.md: what a controller drops is refused, the rest in doubt."""
    assert reading_of(dataclasses.replace(GOOD, flags=flags)).state == state


def test_flags_are_those_of_the_message():
    from drfmcw_msgs.msg import RangeEstimate

    from drfmcw_gateway import reading

    for name in ('WEAK_SIGNAL', 'MODE_MISMATCH', 'OUT_OF_LIMITS', 'SIGNAL_QUALITY'):
        assert getattr(reading, name) == getattr(RangeEstimate, name)


def test_silence_counts_before_it_has_lasted_too_long():
    """With a margin until the next look, the time-out is kept rather than exceeded."""
    assert reading_of(GOOD, silence=0.15).state == Quality.VALID
    assert reading_of(GOOD, silence=0.15, margin=0.05).state == Quality.STALE


def test_late_sweep_does_not_replace_a_newer_one_but_a_clock_set_back_does():
    state = PairState(0.2, 1.0)
    assert state.take(GOOD, 1.0)
    assert not state.take(dataclasses.replace(GOOD, stamp=STAMP - SECOND, range=1.0), 1.01)
    assert state.reading(1.02, STAMP).value('range') == GOOD.range
    assert state.late == 1
    assert state.take(dataclasses.replace(GOOD, stamp=STAMP - 3600 * SECOND, range=2.0), 1.03)


def test_controller_that_stops_changing_its_number_is_silent():
    controller = Controller(0.5)
    assert controller.silent(0.0)  # it has never written
    controller.write(1, 10.0)
    assert not controller.silent(10.4)
    controller.write(1, 10.4)  # the same number is no sign of life
    assert controller.silent(10.5)
    controller.write(2, 10.6)
    assert not controller.silent(11.0)
    assert not Controller(math.nan).silent(1e9)


# --- registers ---


def decoded(words, name):
    kind = next(q.kind for q in PAIR_QUANTITIES if q.name == name)
    part = words[AT[name] : AT[name] + kind.size]
    return struct.unpack(kind.value[0], struct.pack(f'>{kind.size}H', *part))[0]


def test_registers_hold_what_was_measured():
    words = pair_registers(reading_of(GOOD, age=0.013))
    assert len(words) == PAIR_REGISTERS <= BLOCK
    assert decoded(words, 'range') == pytest.approx(GOOD.range, abs=2e-5)  # half a step of a float32
    assert decoded(words, 'range_integer') == 4123457
    assert decoded(words, 'velocity_integer') == -7500
    assert decoded(words, 'protection_level') == pytest.approx(0.011)
    assert decoded(words, 'age') == 13
    assert decoded(words, 'counter') == 1
    assert decoded(words, 'stamp') * SECOND + decoded(words, 'stamp_nanoseconds') == STAMP


def test_registers_of_an_unusable_range_hold_no_number():
    for reading in (reading_of(GOOD, silence=0.3), reading_of(dataclasses.replace(GOOD, flags=32))):
        words = pair_registers(reading)
        assert math.isnan(decoded(words, 'range'))
        assert decoded(words, 'range_integer') == NOT_A_NUMBER


def test_infinite_and_unknown_numbers_have_registers():
    words = pair_registers(
        reading_of(dataclasses.replace(GOOD, protection_level=math.inf, velocity=math.nan, flags=64))
    )
    assert decoded(words, 'protection_level') == math.inf
    assert decoded(words, 'protection_level_integer') == 2**31 - 1
    assert math.isnan(decoded(words, 'velocity'))
    assert Kind.FLOAT32.registers(1e300) == (0x7F80, 0)


def test_numbers_of_two_registers_begin_at_even_ones():
    for quantities in (PAIR_QUANTITIES, GATEWAY_QUANTITIES):
        for quantity, offset in zip(quantities, offsets(quantities).values(), strict=True):
            assert offset % quantity.kind.size == 0, quantity.name


def test_every_bit_is_documented():
    assert list(QUALITY_MEANINGS) == list(Quality)


# --- servers, by clients that know nothing of them ---


class Site:
    """A board with servers, and ranges as a topic would bring them."""

    def __init__(self, **changes):
        ports = {'modbus_port': free_port(), 'opcua_port': free_port()}
        self.settings = dataclasses.replace(GatewaySettings(), pairs=['a/b', 'a/c'], **{**ports, **changes})
        self.board = Board(self.settings)
        self.servers = Servers(self.board)
        self.number = 0

    def give(self, pair='a/b', **changes):
        self.number += 1
        stamp = time.time_ns()
        self.board.pairs[pair].take(
            dataclasses.replace(GOOD, sweep_id=self.number, stamp=stamp, **changes), time.monotonic()
        )
        self.servers.renew([pair])
        return stamp

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.servers.stop()

    @property
    def url(self):
        return f'opc.tcp://127.0.0.1:{self.settings.opcua_port}/drfmcw/'


@pytest.fixture(scope='module')
def site():
    """Servers that need not be private to a test: making the address space takes a second."""
    with Site(timeout=0.5, lost_time=1.5) as found:
        yield found


async def read(client, name):
    """Return a DataValue, whatever its status."""
    index = await client.get_namespace_index('urn:drfmcw:gateway')
    return await client.get_node(ua.NodeId(name, index)).read_data_value(raise_on_bad_status=False)


async def wait_for_status(client, name, status):
    end = time.monotonic() + LIMIT
    while (value := await read(client, name)).StatusCode.value != status:
        assert time.monotonic() < end, value
        await asyncio.sleep(0.01)
    return value


def test_opcua_gives_value_status_and_times(site):
    async def work():
        async with Client(site.url) as client:
            stamp = site.give(range=512.25)
            value = await wait_for_status(client, 'a/b/range', ua.StatusCodes.Good)
            assert value.Value.Value == 512.25
            assert value.SourceTimestamp.timestamp() == pytest.approx(stamp * 1e-9, abs=2e-6)
            site.give(flags=128)
            doubtful = await wait_for_status(client, 'a/b/range', ua.StatusCodes.UncertainSensorNotAccurate)
            assert doubtful.Value.Value == GOOD.range
            site.give(flags=160)
            refused = await wait_for_status(client, 'a/b/range', ua.StatusCodes.BadSensorFailure)
            assert refused.Value is None or refused.Value.Value is None
            quality = (await read(client, 'a/b/quality')).Value.Value
            assert quality == Quality.REFUSED | 160 << FLAG_SHIFT

    asyncio.run(work())


def test_opcua_signals_silence_first_as_last_usable_value_then_as_bad(site):
    """Within `timeout` and `lost_time` of the last range, and not before 80 % of them: docs/controller.md."""

    async def work():
        async with Client(site.url) as client:
            site.give(range=77.0)
            begin = time.monotonic()
            await wait_for_status(client, 'a/b/range', ua.StatusCodes.Good)
            last = await wait_for_status(client, 'a/b/range', ua.StatusCodes.UncertainLastUsableValue)
            assert 0.8 * site.settings.timeout <= time.monotonic() - begin <= site.settings.timeout + MARGIN
            assert last.Value.Value == 77.0
            assert (await read(client, 'a/b/quality')).Value.Value & STATES == Quality.STALE
            await wait_for_status(client, 'a/b/range', ua.StatusCodes.BadNoCommunication)
            assert 0.8 * site.settings.lost_time <= time.monotonic() - begin <= site.settings.lost_time + MARGIN

    asyncio.run(work())


def test_opcua_signals_silence_as_bad_where_the_last_range_was_refused(site):
    async def work():
        async with Client(site.url) as client:
            site.give(flags=32)
            await wait_for_status(client, 'a/b/range', ua.StatusCodes.BadSensorFailure)
            await wait_for_status(client, 'a/b/range', ua.StatusCodes.BadNoCommunication)

    asyncio.run(work())


def test_opcua_says_that_nothing_has_come_yet(site):
    async def work():
        async with Client(site.url) as client:
            value = await read(client, 'a/c/range')
            assert value.StatusCode.value == ua.StatusCodes.BadWaitingForInitialData

    asyncio.run(work())


def test_opcua_subscription_gets_every_change(site):
    class Handler:
        def __init__(self):
            self.seen = []

        def datachange_notification(self, node, value, data):
            self.seen.append(value)

    async def work():
        async with Client(site.url) as client:
            index = await client.get_namespace_index('urn:drfmcw:gateway')
            handler = Handler()
            subscription = await client.create_subscription(10, handler)
            await subscription.subscribe_data_change(client.get_node(ua.NodeId('a/b/range', index)))
            for metres in (100.0, 101.0, 102.0):
                site.give(range=metres)
                end = time.monotonic() + LIMIT
                while metres not in handler.seen:
                    assert time.monotonic() < end, handler.seen
                    await asyncio.sleep(0.01)

    asyncio.run(work())


def test_opcua_clients_write_the_heartbeat_and_nothing_else(site):
    async def work():
        async with Client(site.url) as client:
            index = await client.get_namespace_index('urn:drfmcw:gateway')
            for name in ('a/b/range', 'a/b/quality', 'gateway/heartbeat'):
                with pytest.raises(ua.UaStatusCodeError):
                    await client.get_node(ua.NodeId(name, index)).write_value(ua.Variant(1.0, ua.VariantType.Double))
            heartbeat = client.get_node(ua.NodeId('gateway/controller_heartbeat', index))
            await heartbeat.write_value(ua.Variant(4711, ua.VariantType.UInt16))
            assert await heartbeat.read_value() == 4711
        assert site.board.controller.value == 4711

    asyncio.run(work())


def test_modbus_client_reads_blocks_and_writes_the_heartbeat(site):
    client = ModbusTcpClient('127.0.0.1', port=site.settings.modbus_port)
    assert client.connect()
    try:
        site.give(range=333.5)
        words = client.read_input_registers(BLOCK, count=PAIR_REGISTERS).registers
        assert client.convert_from_registers(words[4:6], client.DATATYPE.FLOAT32) == 333.5
        assert words[0] == Quality.VALID
        second = client.read_input_registers(2 * BLOCK, count=1).registers
        assert second == [int(Quality.NO_RANGE)]
        assert client.read_input_registers(1, count=1).registers == [2]  # pairs
        assert client.write_register(0, 1234).isError() is False
        assert site.board.controller.value == 1234
        assert client.read_holding_registers(0, count=1).registers == [1234]
        assert client.write_register(1, 1).isError()
        assert client.read_input_registers(3 * BLOCK, count=1).isError()  # no third pair
        assert client.read_coils(0, count=1).isError()
    finally:
        client.close()


def raw_request(port, unit, function, first, count):
    """Return the data of an answer; the request is made from the MODBUS Messaging on TCP/IP guide V1.0b, 3.1."""
    pdu = struct.pack('>BHH', function, first, count)
    with socket.create_connection(('127.0.0.1', port), 10.0) as connection:
        connection.sendall(struct.pack('>HHHB', 0xBEEF, 0, 1 + len(pdu), unit) + pdu)
        header = connection.recv(7, socket.MSG_WAITALL)
        transaction, protocol, length, answering = struct.unpack('>HHHB', header)
        assert (transaction, protocol, answering) == (0xBEEF, 0, unit)
        return connection.recv(length - 1, socket.MSG_WAITALL)


@pytest.mark.parametrize('unit', [0, 1, 255])
def test_modbus_bytes_are_those_of_the_specification(site, unit):
    site.give(range=-0.15625)
    answer = raw_request(site.settings.modbus_port, unit, 4, BLOCK + AT['range'], 2)
    assert answer == bytes.fromhex('04 04 BE20 0000')  # function, bytes, IEEE 754 binary32, high word first
    assert raw_request(site.settings.modbus_port, unit, 4, 50, 1) == bytes.fromhex('84 02')  # illegal data address
    assert raw_request(site.settings.modbus_port, unit, 1, 0, 1) == bytes.fromhex('81 01')  # illegal function


def test_modbus_signals_silence_within_the_configured_time(site):
    site.give(range=50.0)
    given = time.monotonic()
    states = []
    while time.monotonic() - given < 0.8:
        before = time.monotonic() - given
        (quality,) = struct.unpack('>H', raw_request(site.settings.modbus_port, 1, 4, BLOCK, 1)[2:])
        states.append((before, quality & STATES))
    assert states[0][1] == Quality.VALID
    assert all(state == Quality.STALE for before, state in states if before >= site.settings.timeout)


def test_modbus_limits_connections_and_addresses():
    with Site(opcua=False, modbus_connections=2, modbus_from='127.0.0.1') as site:
        address = ('127.0.0.1', site.settings.modbus_port)
        kept = [socket.create_connection(address, 10.0) for _ in range(2)]
        with socket.create_connection(address, 10.0) as third:
            assert third.recv(1) == b''  # closed at once
        for connection in kept:
            connection.sendall(bytes.fromhex('0001 0000 0006 01 04 0000 0001'))
            assert connection.recv(11, socket.MSG_WAITALL)[-2:] == b'\x00\x01'
            connection.close()
        assert site.servers.modbus.counts.refused == 1
    with Site(opcua=False, modbus_from='10.0.0.0/8') as site:
        with socket.create_connection(('127.0.0.1', site.settings.modbus_port), 10.0) as stranger:
            assert stranger.recv(1) == b''


def test_modbus_survives_rubbish(site):
    for rubbish in (b'\x00' * 300, b'GET / HTTP/1.1\r\n\r\n', bytes.fromhex('0001 0000 FFFF 01 04 0000 0001'), b'\xff'):
        with socket.create_connection(('127.0.0.1', site.settings.modbus_port), 10.0) as connection:
            connection.sendall(rubbish)
    assert raw_request(site.settings.modbus_port, 1, 4, 0, 1) == bytes.fromhex('04 02 0001')


def test_heartbeat_advances_and_silent_controller_shows_in_the_quality(site):
    board = Board(dataclasses.replace(site.settings, controller_timeout=0.1))
    board.pairs['a/b'].take(dataclasses.replace(GOOD, stamp=time.time_ns()), time.monotonic())
    assert board.readings()['a/b'].quality & Quality.CONTROLLER_SILENT
    assert board.gateway().controller == 2
    board.write_heartbeat(5)
    assert not board.readings()['a/b'].quality & Quality.CONTROLLER_SILENT
    beats = []
    end = time.monotonic() + LIMIT
    while len(set(beats)) < 3:
        assert time.monotonic() < end
        beats.append(raw_request(site.settings.modbus_port, 1, 4, 2, 1))


# --- clients of another make, in processes of their own ---

REFUSED_WRITES = {ua.StatusCodes.BadUserAccessDenied, ua.StatusCodes.BadNotWritable}


def attended(site, process, **values):
    """What a client found while ranges came 50 times a second."""
    while process.poll() is None:
        site.give(**values)
        time.sleep(0.02)
    return answer(process)


def test_open62541_reads_values_and_status_and_writes_the_heartbeat_only(site):
    names = ['a/b/range', 'a/b/range_std', 'a/b/quality', 'a/c/range', 'a/c/quality', 'gateway/pairs']
    heartbeat = 'gateway/controller_heartbeat'
    orders = [(heartbeat, 'UInt16', 4321), ('a/b/range', 'Double', 1.0), ('gateway/heartbeat', 'UInt16', 1)]
    found = attended(site, started('o6', url=site.url, read=names, write=orders), range=321.5)
    good = ua.StatusCodes.Good
    assert found['read'] == {
        'a/b/range': [321.5, good],
        'a/b/range_std': [GOOD.range_std, good],
        'a/b/quality': [float(Quality.VALID), good],
        'a/c/range': [None, ua.StatusCodes.BadWaitingForInitialData],
        'a/c/quality': [float(Quality.NO_RANGE), good],
        'gateway/pairs': [2.0, good],
    }
    assert found['written'].pop(heartbeat) == good and site.board.controller.value == 4321
    assert set(found['written'].values()) <= REFUSED_WRITES


def test_open62541_subscription_gets_ranges_and_then_silence(site):
    process = started('o6', url=site.url, watch='a/b/range', until=ua.StatusCodes.BadNoCommunication, seconds=LIMIT)
    metres, end = 0.0, time.monotonic() + LIMIT
    while metres < 50.0:  # a second of ranges after it has connected
        assert time.monotonic() < end and process.poll() is None
        metres += 1.0 if site.servers.opcua.sessions else 0.0
        site.give(range=metres)
        time.sleep(0.02)
    seen = answer(process)['seen']
    good = [value for value, status in seen if status == ua.StatusCodes.Good]
    assert good[-1] == metres and len(good) >= 10 and good == sorted(good)
    assert [status for _, status in seen[-2:]] == [
        ua.StatusCodes.UncertainLastUsableValue, ua.StatusCodes.BadNoCommunication,
    ]  # fmt: skip
    assert [value for value, _ in seen[-2:]] == [metres, None]


def test_pymodbustcp_reads_blocks_and_silence(site):
    order = {'port': site.settings.modbus_port, 'read': [[0, GATEWAY_REGISTERS], [BLOCK, PAIR_REGISTERS]]}
    found = attended(site, started('pyModbusTCP', **order, write=777), range=-0.15625)
    own, words = found['blocks']
    assert own[1] == 2 and found['written'] is True and found['holding'] == [777]
    assert site.board.controller.value == 777
    assert found['refused'] == [None, 2]  # illegal data address
    assert words[0] == Quality.VALID and float32(words[AT['range'] : AT['range'] + 2]) == -0.15625
    _, words = ask('pyModbusTCP', **order, until=int(Quality.STALE), seconds=LIMIT)['blocks']
    assert words[0] & STATES == Quality.STALE and math.isnan(float32(words[AT['range'] : AT['range'] + 2]))


# --- certificates ---


@pytest.fixture(scope='module')
def certificates(tmp_path_factory):
    """Directories of the server, a known client and a stranger; and one with the known client's certificate."""
    root = tmp_path_factory.mktemp('certificates')
    for name in ('server', 'client', 'stranger'):
        assert main(['--make-certificate', str(root / name), '--name', name]) == 0
    (root / 'known').mkdir()
    (root / 'known' / 'client.der').write_bytes((root / 'client' / 'certificate.der').read_bytes())
    return root


def secured(certificates, **changes):
    files = {
        'certificate': str(certificates / 'server' / 'certificate.der'),
        'key': str(certificates / 'server' / 'key.pem'),
        'clients': str(certificates / 'known'),
    }
    return files | changes


async def connected(url, certificates, who):
    """Read a range as `who`; None connects without security."""
    client = Client(url)
    if who:
        from cryptography import x509

        directory = certificates / who
        own = x509.load_der_x509_certificate((directory / 'certificate.der').read_bytes())
        names = own.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        client.application_uri = names.get_values_for_type(x509.UniformResourceIdentifier)[0]
        await client.set_security(
            SecurityPolicyBasic256Sha256,
            certificate=directory / 'certificate.der',
            private_key=directory / 'key.pem',
            server_certificate=certificates / 'server' / 'certificate.der',
        )
    async with client:
        return await read(client, 'a/b/range')


def test_only_known_clients_connect_and_only_encrypted(certificates):
    with Site(modbus=False, **secured(certificates)) as site:
        site.give(range=200.0)
        value = asyncio.run(connected(site.url, certificates, 'client'))
        assert value.StatusCode.value != ua.StatusCodes.BadWaitingForInitialData
        for stranger in ('stranger', None):
            with pytest.raises((ua.UaError, ConnectionError, TimeoutError, asyncio.TimeoutError)):
                asyncio.run(asyncio.wait_for(connected(site.url, certificates, stranger), LIMIT))


def test_open62541_connects_encrypted_with_a_known_certificate_only(certificates):
    """A known one, a stranger's, and none: the same files and the same server as with asyncua's client."""
    with Site(modbus=False, **secured(certificates)) as site:
        site.give(range=200.0)
        trusted = certificates / 'server' / 'certificate.der'

        def connected_by(who):
            secure = certified(certificates / who, trusted) if who else {}
            return ask('o6', url=site.url, read=['a/b/counter'], **secure)

        assert connected_by('client')['read']['a/b/counter'] == [1.0, ua.StatusCodes.Good]
        assert connected_by('stranger') == {'refused': ua.StatusCodes.BadCertificateUntrusted}
        assert set(connected_by(None)) == {'refused'}


def test_network_address_needs_certificates():
    with pytest.raises(ConfigurationError, match='no loopback address: certificate, key and clients must be given'):
        dataclasses.replace(GatewaySettings(), opcua_address='0.0.0.0')


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'certificate': 'x'}, 'certificate is given without key'),
        ({'clients': 'x'}, 'clients is given without certificate'),
        ({'pairs': ['a']}, "'a' is not 'first/second'"),
        ({'pairs': ['a/b', 'a/b']}, 'given twice'),
        ({'pairs': [f'a/{n}' for n in range(65)]}, 'at most 64'),
        ({'opcua': False, 'modbus': False}, 'nothing to serve'),
        ({'timeout': 3.0}, 'lost_time'),
        ({'modbus_address': 'crane'}, "'crane' is no IP address"),
        ({'modbus_from': '10.0.0.1/8'}, 'modbus_from'),
    ],
)
def test_wrong_settings_are_named(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        dataclasses.replace(GatewaySettings(), **changes)


def test_wrong_files_are_named(certificates, tmp_path):
    (tmp_path / 'text').write_text('no certificate')
    (tmp_path / 'empty').mkdir()
    cases = {
        'certificate: .*text holds no certificate': {'certificate': str(tmp_path / 'text')},
        'key: .*missing': {'key': str(tmp_path / 'missing')},
        'is not the RSA key of the certificate': {'key': str(certificates / 'stranger' / 'key.pem')},
        'holds no certificate': {'clients': str(tmp_path / 'empty')},
        'is no directory': {'clients': str(tmp_path / 'text')},
    }
    for message, changes in cases.items():
        with pytest.raises(ConfigurationError, match=message):
            Site(modbus=False, **secured(certificates, **changes))


def test_key_is_private_and_nothing_is_overwritten(certificates, tmp_path, capsys):
    assert (certificates / 'server' / 'key.pem').stat().st_mode & 0o777 == 0o600
    assert main(['--make-certificate', str(certificates / 'server')]) == 2
    assert 'exists already' in capsys.readouterr().err
    certificate, key = make_certificate(tmp_path / 'new', 'x')
    key.chmod(0o644)
    with pytest.raises(ConfigurationError, match='others may read'):
        Site(modbus=False, **secured(certificates, certificate=str(certificate), key=str(key)))


def test_port_that_is_taken_is_named():
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ConfigurationError, match=f'127.0.0.1:{port}'):
            Site(opcua=False, modbus_port=port)
        with pytest.raises(ConfigurationError, match=f'127.0.0.1:{port}'):
            Site(modbus=False, opcua_port=port)
