"""Streams that are served beside the executor: every message once and in order, and nothing else is held up."""

import threading
import time

import pytest
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Temperature

from drfmcw_ros.graph import qos, streams
from drfmcw_ros.nodes.runner import Executor, Finished, spin

pytestmark = pytest.mark.graph

LIMIT = 30.0  # for discovery on a busy machine [s]
COUNT = 600


@pytest.fixture
def node():
    """A node of the default context, as `spin` wants it, in the ROS domain that conftest.py gives to this process."""
    rclpy.init(args=[])
    made = Node('listener')
    yield made
    made.destroy_node()
    rclpy.try_shutdown()


def published(node, topic, pause, listeners):
    """A thread that publishes 0, 1, 2, ... as soon as so many listen."""
    sender = node.create_publisher(Temperature, topic, qos.DEEP)

    def run():
        end = time.monotonic() + LIMIT
        while sender.get_subscription_count() < listeners and time.monotonic() < end:
            time.sleep(0.01)
        for number in range(COUNT):
            sender.publish(Temperature(temperature=float(number)))
            time.sleep(pause)

    return threading.Thread(target=run)


@pytest.mark.parametrize('gather', [0.0, 1e-3])
def test_every_message_comes_once_and_in_order_while_timers_go_on(node, gather):
    """Also at a rate at which messages are gathered; a timer and a subscription that is no stream have their turns."""
    heard, seldom, ticks, end = [], [], [], time.monotonic() + 2.0 * LIMIT

    def take(messages):
        heard.extend(m.temperature for m in messages)

    def tick():
        ticks.append(len(heard))
        if len(heard) == len(seldom) == COUNT or time.monotonic() > end:
            raise Finished

    qos.subscription(node, Temperature, '/often', take, qos.DEEP, batch=True, gather=gather)
    qos.subscription(node, Temperature, '/often', lambda m: seldom.append(m.temperature), qos.DEEP)
    node.create_timer(0.02, tick)
    executor = Executor()
    executor.add_node(node)
    sending = published(node, '/often', 1e-3, 2)
    sending.start()
    with pytest.raises(Finished):
        spin(executor, node)
    sending.join()
    executor.shutdown()
    assert heard == seldom == [float(n) for n in range(COUNT)]
    assert len({t for t in ticks if 0 < t < COUNT}) > 1, 'the timer fired while messages came'


def test_a_node_without_streams_is_not_kept_waiting(node):
    assert not streams.serve(node, LIMIT)


def test_a_subscription_that_was_destroyed_is_served_no_more(node):
    created = qos.subscription(node, Temperature, '/gone', lambda messages: None, qos.DEEP, batch=True)
    node.destroy_subscription(created)
    assert not streams.serve(node, LIMIT)
