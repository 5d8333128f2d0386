"""What a client of Foxglove's protocol gets from a real bridge beside a real publisher."""

import contextlib
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time

import pytest
import rclpy
from drfmcw_msgs.msg import RangeEstimate, StationCalibration
from ports import free_port
from rclpy.context import Context
from rclpy.serialization import deserialize_message

from drfmcw_gateway.foxglove_bridge import FoxgloveSettings
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.graph import qos

pytest.importorskip('foxglove')
client = pytest.importorskip('websockets.sync.client')

BRIDGE = sys.executable, '-m', 'drfmcw_gateway.foxglove_bridge'
LIMIT = 40.0  # for anything that is waited for, on a busy machine [s]
RANGES, CALIBRATION = '/master/slave/range', '/master/calibration'


@pytest.fixture
def publisher():
    """A process's worth of topics: ranges that count up, a latched calibration."""
    context, done = Context(), threading.Event()
    rclpy.init(context=context)
    node = rclpy.create_node('source', context=context)
    ranges = qos.publisher(node, RangeEstimate, RANGES, qos.RELIABLE)
    latched = qos.publisher(node, StationCalibration, CALIBRATION, qos.LATCHED)
    latched.publish(StationCalibration(station='master', alpha=1.000006))

    def publish():
        count = 0
        while not done.wait(0.02):
            count += 1
            ranges.publish(RangeEstimate(sweep_id=count, range=100.0 + 0.25 * count))

    thread = threading.Thread(target=publish)
    thread.start()
    yield ranges
    done.set()
    thread.join()
    context.try_shutdown()


@contextlib.contextmanager
def bridge(log):
    """The address of a bridge process that runs meanwhile and must end cleanly."""
    port = free_port()
    command = [*BRIDGE, '--port', str(port)]
    with open(log, 'w') as output, subprocess.Popen(command, stderr=output, stdout=output, env=os.environ) as process:
        try:
            end = time.monotonic() + LIMIT
            while True:
                with contextlib.suppress(OSError), socket.create_connection(('127.0.0.1', port), 1.0):
                    break
                assert time.monotonic() < end and process.poll() is None, log.read_text()
                time.sleep(0.1)
            yield f'ws://127.0.0.1:{port}'
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(LIMIT) == 0, log.read_text()


def offered(connection, topics):
    """Return the channels that the bridge offers, by topic, once it offers these."""
    found, end = {}, time.monotonic() + LIMIT
    while not topics <= set(found):
        message = connection.recv(timeout=max(0.1, end - time.monotonic()))
        if isinstance(message, str):
            data = json.loads(message)
            if data['op'] == 'advertise':
                found |= {channel['topic']: channel for channel in data['channels']}
    return found


def received(connection, channel, number, count):
    """Subscribe to a channel, and return the first messages of the subscription."""
    wish = json.dumps({'op': 'subscribe', 'subscriptions': [{'id': number, 'channelId': channel['id']}]})
    connection.send(wish)
    found, end = [], time.monotonic() + LIMIT
    while len(found) < count:
        message = connection.recv(timeout=max(0.1, end - time.monotonic()))
        if isinstance(message, bytes):
            if message[0] == 1 and struct.unpack_from('<I', message, 1)[0] == number:
                found.append(message[13:])
        # the library offers a new channel an instant before it knows it: whoever is quicker must ask again
        elif json.loads(message)['op'] == 'status':
            assert time.monotonic() < end, message
            time.sleep(0.1)
            connection.send(wish)
    return found


def connected(address):
    return client.connect(address, subprotocols=['foxglove.sdk.v1'])


def test_client_gets_what_is_published_with_its_definition(publisher, tmp_path):
    """Ranges arrive in order and bit by bit, a latched calibration reaches a second client too.

    Only what is shown is subscribed to.
    """
    with bridge(tmp_path / 'log') as address, connected(address) as first:
        channels = offered(first, {RANGES, CALIBRATION})
        assert publisher.get_subscription_count() == 0
        channel = channels[RANGES]
        assert (channel['encoding'], channel['schemaName'], channel['schemaEncoding']) == (
            'cdr', 'drfmcw_msgs/msg/RangeEstimate', 'ros2msg'
        )  # fmt: skip
        assert 'float64 range' in channel['schema'] and 'MSG: std_msgs/Header' in channel['schema']
        ranges = [deserialize_message(data, RangeEstimate) for data in received(first, channel, 1, 20)]
        ids = [r.sweep_id for r in ranges]
        assert ids == list(range(ids[0], ids[0] + 20))
        assert all(r.range == 100.0 + 0.25 * r.sweep_id for r in ranges)
        (calibration,) = received(first, channels[CALIBRATION], 2, 1)
        assert deserialize_message(calibration, StationCalibration).alpha == 1.000006
        with connected(address) as second:
            offer = offered(second, {CALIBRATION})[CALIBRATION]
            assert received(second, offer, 7, 1) == [calibration]
        first.send(json.dumps({'op': 'unsubscribe', 'subscriptionIds': [1]}))
        end = time.monotonic() + LIMIT
        while publisher.get_subscription_count():
            assert time.monotonic() < end
            time.sleep(0.05)


def test_bridge_in_use_and_wrong_settings_are_one_line():
    with socket.create_server(('127.0.0.1', 0)) as taken:
        # a process of its own: one that runs a node ignores signals when the node has ended
        command = [*BRIDGE, '--port', str(taken.getsockname()[1])]
        refused = subprocess.run(command, stderr=subprocess.PIPE, text=True, timeout=LIMIT, check=False)
    assert refused.returncode == 2
    assert 'cannot listen at 127.0.0.1:' in refused.stderr
    with pytest.raises(ConfigurationError, match='no loopback address'):
        FoxgloveSettings(address='10.0.7.2')
    with pytest.raises(ConfigurationError, match='key is given without certificate'):
        FoxgloveSettings(key='key.pem')
