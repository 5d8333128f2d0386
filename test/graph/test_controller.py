"""A controller beside a graph of real processes: what it reads, and what it reads when fusion dies and comes back."""

import asyncio
import math
import os
import shutil
import signal
import socket
import struct
import time

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from lifecycle_msgs.msg import Transition
from other_controller import answer, ask, certified, float32, started
from ports import free_port
from sensor_msgs.msg import JointState
from test_graph import LIMIT, STANDING, scenario_file, site
from test_lifecycle import change
from tf2_msgs.msg import TFMessage

from drfmcw_bringup.graph import FOLLOWER, FRAMES, FUSION, GATEWAY, parameters
from drfmcw_gateway.quantities import BLOCK, PAIR_QUANTITIES, offsets
from drfmcw_gateway.reading import STATES, Quality
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import stamp_ns

pytestmark = pytest.mark.graph

pytest.importorskip('asyncua')
pytest.importorskip('pymodbus')

START_LIMIT = 120.0  # on a busy machine [s]
DISTANCE = 100.0  # of STANDING [m]
MARGIN = 5.0  # of a promised time-out, on a busy machine [s]
AT = offsets(PAIR_QUANTITIES)


def block(port):
    """(quality, counter, range [m], standard deviation [m]) by a bare Modbus request, None while nobody answers."""
    try:
        with socket.create_connection(('127.0.0.1', port), 10.0) as connection:
            connection.sendall(struct.pack('>HHHBBHH', 1, 0, 6, 1, 4, BLOCK, 12))
            data = connection.recv(9 + 24, socket.MSG_WAITALL)[9:]
    except OSError:
        return None
    formats = {'quality': '>H', 'counter': '>I', 'range': '>f', 'range_std': '>f'}
    return tuple(struct.unpack_from(form, data, 2 * AT[name])[0] for name, form in formats.items())


def wait_for_gateway(live, port):
    """Wait until the gateway answers: making the address space of OPC UA takes seconds of processor time."""
    process, end = live.graph.members['gateway'].process, time.monotonic() + START_LIMIT
    while block(port) is None:
        assert process.poll() is None and time.monotonic() < end, live.logs()
        time.sleep(0.1)


def opcua(port, name):
    """(value, status) by asyncua's client."""
    from asyncua import Client, ua

    async def read():
        async with Client(f'opc.tcp://127.0.0.1:{port}/drfmcw/') as client:
            index = await client.get_namespace_index('urn:drfmcw:gateway')
            node = client.get_node(ua.NodeId(f'master/slave/{name}', index))
            data = await node.read_data_value(raise_on_bad_status=False)
            return (data.Value.Value if data.Value is not None else None), data.StatusCode

    return asyncio.run(asyncio.wait_for(read(), LIMIT))


def promised(live, begin, within, condition, what):
    """Wait for what was promised within a time of `begin` on the steady clock [s]."""
    live.wait(condition, what)
    assert time.monotonic() - begin <= within + MARGIN, what


def test_controllers_see_fusion_work_die_and_come_back(tmp_path):
    """Gateway and example subscriber, beside a recorder, which the deadline that fusion offers does not disturb."""
    ports = {'modbus_port': free_port(), 'opcua_port': free_port()}
    path = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.05})
    generous = {'timeout': 1.0, 'age_limit': 20.0}  # the machine may be busy
    lost_time = 3.0
    with site(tmp_path) as live:
        live.graph.start('gateway', GATEWAY, *parameters({**ports, **generous, 'lost_time': lost_time}))
        live.graph.start('follower', FOLLOWER, *parameters({**generous, 'margin': 1.0}))
        wait_for_gateway(live, ports['modbus_port'])
        live.start(path, {}, tmp_path / 'recording')

        def state():
            found = block(ports['modbus_port'])
            return found[0] & STATES if found else None

        live.wait(lambda: state() == Quality.VALID, 'a valid range in Modbus')
        _, counter, metres, std = block(ports['modbus_port'])
        assert metres == pytest.approx(DISTANCE, abs=5.0 * std)  # P(false failure) < 1e-6
        value, status = opcua(ports['opcua_port'], 'range')
        assert status.is_good() and value == pytest.approx(DISTANCE, abs=5.0 * std)
        live.wait(lambda: 'drive: the range is valid' in live.log('follower'), 'the follower to drive')
        live.wait(lambda: live.value('/gateway: Modbus', 'requests') not in ('', '0'), 'diagnostics of the gateway')
        live.wait(lambda: float(live.value('/recorder: Recording', '/master/slave/range') or 0) > 0, 'a recorded range')

        os.kill(live.graph.members['fusion'].process.pid, signal.SIGKILL)
        begin = time.monotonic()
        promised(live, begin, generous['timeout'], lambda: state() == Quality.STALE, 'silence in Modbus')
        assert math.isnan(block(ports['modbus_port'])[2])
        # the time-out or the middleware's lease may end first; the lost publisher is named in any case
        within = max(generous['timeout'], qos.RANGE_LEASE)
        named = 'stop: fusion gives no sign of life'
        promised(live, begin, within, lambda: named in live.log('follower'), 'the follower to stop')
        silent = 'BadNoCommunication'
        promised(
            live, begin, lost_time, lambda: opcua(ports['opcua_port'], 'range')[1].name == silent, 'silence in OPC UA'
        )

        live.graph.start('fusion again', FUSION, '--pair', 'master/slave')
        live.wait(lambda: state() == Quality.VALID, 'valid ranges again')
        assert block(ports['modbus_port'])[1] > counter
        live.wait(lambda: live.log('follower').count('drive: the range is valid') == 2, 'the follower to drive again')


def test_controllers_of_another_make_see_fusion_work_and_die(tmp_path):
    """open62541's client, encrypted, and pyModbusTCP's, each a process of its own beside a gateway that is one too."""
    from drfmcw_gateway.certificates import make_certificate

    trusted, key = make_certificate(tmp_path / 'server', 'gateway')
    own, _ = make_certificate(tmp_path / 'own', 'controller')
    shutil.copy(own, tmp_path)  # its key stays where it is
    files = {'certificate': str(trusted), 'key': str(key), 'clients': str(tmp_path)}
    ports = {'modbus_port': free_port(), 'opcua_port': free_port()}
    path = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.05})
    url = f'opc.tcp://127.0.0.1:{ports["opcua_port"]}/drfmcw/'
    block_of_pair = {'port': ports['modbus_port'], 'read': [[BLOCK, 12]], 'seconds': LIMIT}
    good, silent = 0x00000000, 0x80310000  # Good, BadNoCommunication (OPC 10000-6, A.2)
    with site(tmp_path) as live:
        settings = {**ports, **files, 'timeout': 1.0, 'age_limit': 20.0, 'lost_time': 3.0}
        live.graph.start('gateway', GATEWAY, *parameters(settings))
        wait_for_gateway(live, ports['modbus_port'])
        live.start(path, {})
        ((quality, *words),) = ask('pyModbusTCP', **block_of_pair, until=int(Quality.VALID))['blocks']
        metres, std = float32(words[AT['range'] - 1 :][:2]), float32(words[AT['range_std'] - 1 :][:2])
        assert quality & STATES == Quality.VALID
        assert metres == pytest.approx(DISTANCE, abs=5.0 * std)  # P(false failure) < 1e-6
        assert set(ask('o6', url=url)) == {'refused'}
        secure = certified(own.parent, trusted)
        watching = started('o6', url=url, **secure, watch='master/slave/range', until=silent, seconds=2 * LIMIT)
        live.wait(lambda: live.value('/gateway: OPC UA', 'clients') == '1', 'a session')
        live.diagnostics.clear()
        live.wait(lambda: live.value('/gateway: OPC UA', 'clients') == '1', 'a second of it')
        os.kill(live.graph.members['fusion'].process.pid, signal.SIGKILL)
        seen = answer(watching)['seen']
        assert seen[-1] == [None, silent]
        assert next(value for value, status in seen if status == good) == pytest.approx(DISTANCE, abs=5.0 * std)
        ((quality, *_),) = ask('pyModbusTCP', **block_of_pair, until=int(Quality.STALE))['blocks']
        assert quality & STATES == Quality.STALE


def test_follower_stops_when_fusion_hangs_or_is_deactivated(tmp_path):
    """Its process lives in both cases; deadline and liveliness of the middleware notice both, beside the time-out."""
    path = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.02})
    timeout = 1.0
    with site(tmp_path) as live:
        live.graph.start('follower', FOLLOWER, *parameters({'timeout': timeout, 'age_limit': 20.0, 'margin': 1.0}))
        live.start(path, {})

        def value(name):
            return live.value('/follow_range: Range master/slave', name)

        def drives(times):
            live.wait(lambda: live.log('follower').count('drive: the range is valid') >= times, f'drive {times}')
            live.wait(lambda: value('publishers alive') == '1', 'a publisher that is alive')
            return int(value('deadlines missed'))

        def decision():
            return [line for line in live.log('follower').splitlines() if 'master/slave: ' in line][-1]

        def stops(missed):
            promised(live, time.monotonic(), timeout, lambda: 'stop: ' in decision(), 'the follower to stop')
            live.wait(lambda: value('publishers alive') == '0', 'no sign of life')
            live.wait(lambda: int(value('deadlines missed')) >= missed + 5, 'deadlines that were missed')
            assert live.graph.members['fusion'].process.poll() is None

        missed = drives(1)
        fusion = live.graph.members['fusion'].process
        fusion.send_signal(signal.SIGSTOP)
        stops(missed)
        fusion.send_signal(signal.SIGCONT)
        missed = drives(2)
        assert change(live, '/fusion', Transition.TRANSITION_DEACTIVATE)
        stops(missed)
        assert change(live, '/fusion', Transition.TRANSITION_ACTIVATE)
        drives(3)


def test_frames_follow_the_range_and_stand_still_without_it(tmp_path):
    """Pose, joint and /tf: the antennas are as far apart in the frames as the range says, until fusion dies."""
    geometry = {'fixed_x': -2.0, 'fixed_z': 12.0, 'crane_x': -1.5, 'crane_y': 0.5, 'crane_z': 8.0}
    path = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.05})
    with site(tmp_path) as live:
        poses, joints, moved, fixed = [], [], [], []
        subscribe = live.monitor.create_subscription
        subscribe(PoseWithCovarianceStamped, '/master/slave/pose', poses.append, qos.RELIABLE)
        subscribe(JointState, '/joint_states', joints.append, qos.RELIABLE)
        subscribe(TFMessage, '/tf', lambda m: moved.extend(m.transforms), qos.RELIABLE)
        subscribe(TFMessage, '/tf_static', lambda m: fixed.extend(m.transforms), qos.LATCHED)
        live.graph.start('frames', FRAMES, *parameters({**geometry, 'interval': 0.0}))
        live.start(path, {})

        def counts():
            return len(poses), len(joints), len(moved)

        def all_beyond(before):
            return all(now >= n + 20 for now, n in zip(counts(), before, strict=True))

        def silent():
            found = live.diagnostics.get(('master/slave', '/frames: Pose'))
            return found is not None and found.message == 'no range'

        live.wait(lambda: all_beyond((0, 0, 0)) and len(fixed) == 2, 'the frames')
        live.wait(lambda: not silent(), 'diagnostics that see ranges')
        os.kill(live.graph.members['fusion'].process.pid, signal.SIGKILL)
        live.wait(silent, 'diagnostics that see none')
        before = counts()
        for _ in range(2):
            live.diagnostics.clear()
            live.wait(silent, 'another second')
        assert counts() == before
        live.graph.start('fusion again', FUSION, '--pair', 'master/slave')
        live.wait(lambda: all_beyond(before), 'the frames again')

        places = {t.child_frame_id: (t.header.frame_id, xyz(t.transform.translation)) for t in fixed}
        assert {child: parent for child, (parent, _) in places.items()} == {
            'master_antenna': 'rail', 'slave_antenna': 'crane',
        }  # fmt: skip
        ranges = {stamp_ns(a.message.header.stamp): a.message for a in live.monitor.arrivals}
        between = places['slave_antenna'][1] - places['master_antenna'][1]
        compared = 0
        for transform, pose, joint in zip(moved, poses, joints, strict=False):
            stamp = stamp_ns(transform.header.stamp)
            assert stamp == stamp_ns(pose.header.stamp) == stamp_ns(joint.header.stamp)
            assert (transform.header.frame_id, transform.child_frame_id) == ('rail', 'crane')
            if stamp in ranges:
                crane = xyz(transform.transform.translation)
                assert np.linalg.norm(crane + between) == pytest.approx(ranges[stamp].range, abs=1e-9)
                assert joint.position[0] == pose.pose.pose.position.x == crane[0]
                compared += 1
        assert compared >= 20


def xyz(vector):
    """A point or vector as an array [m]."""
    return np.array([vector.x, vector.y, vector.z])


def test_subscriber_that_asks_for_more_than_is_offered_is_warned(tmp_path):
    """It would never get a range; and the offer can be changed by a parameter."""
    asked = {'deadline': qos.RANGE_DEADLINE / 2.0}
    with site(tmp_path) as live:
        live.graph.start('fusion', FUSION, '--pair', 'master/slave')
        live.graph.start('follower', FOLLOWER, *parameters(asked))
        live.wait(lambda: 'offers a longer deadline than is asked for' in live.log('follower'), 'the warning')
        live.graph.stop('fusion')
        override = {'qos_overrides./master/slave/range.publisher.deadline': round(1e9 * asked['deadline'])}
        live.graph.start('generous fusion', FUSION, '--pair', 'master/slave', *parameters(override))
        live.wait(
            lambda: live.value('/follow_range: Range master/slave', 'publishers alive') == '1', 'a publisher that fits'
        )
