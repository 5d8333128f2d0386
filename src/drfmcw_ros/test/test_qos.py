"""Readings and streams with whatever QoS they are published, overrides of QoS, unique names in diagnostics."""

import contextlib
import dataclasses
import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import Temperature

from drfmcw_ros.graph import messages, qos
from drfmcw_ros.nodes.diagnostics import Diagnostics

pytestmark = pytest.mark.graph

LIMIT = 30.0  # for discovery on a busy machine [s]
TOPIC = '/site/temperature'


@pytest.fixture(scope='module')
def context():
    """A context in the ROS domain that conftest.py gives to this process."""
    made = rclpy.Context()
    rclpy.init(args=[], context=made)
    yield made
    made.try_shutdown()


@contextlib.contextmanager
def spinning(context, **nodes):
    """Nodes by name, and a function that spins them until a condition holds."""
    executor = SingleThreadedExecutor(context=context)
    made = [Node(name, context=context, **options) for name, options in nodes.items()]
    for node in made:
        executor.add_node(node)

    def until(condition):
        end = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < end
            executor.spin_once(0.05)

    yield (*made, until)
    executor.shutdown()
    for node in made:
        node.destroy_node()


def reading(value):
    """A temperature."""
    return Temperature(temperature=value)


@pytest.mark.parametrize('profile', [qos.WEATHER, qos.RELIABLE, qos.SENSOR], ids=['latched', 'reliable', 'best_effort'])
def test_readings_of_every_sensor_arrive(context, profile):
    """Latched ones also where they were published before; the others once the subscription is matched."""
    with spinning(context, sensor={}, listener={}) as (sensor, listener, until):
        sender = sensor.create_publisher(Temperature, TOPIC, profile)
        if profile is qos.WEATHER:
            sender.publish(reading(7.0))
        heard = []
        qos.readings(listener, Temperature, TOPIC, heard.append)
        if profile is not qos.WEATHER:
            until(sender.get_subscription_count)
            sender.publish(reading(7.0))
        until(lambda: heard)
        assert [m.temperature for m in heard] == [7.0], 'and once only'


def test_sensor_that_comes_later_is_heard_too(context):
    """Beside the latched readings of a sensor that was there before."""
    with spinning(context, sensor={}, other={}, listener={}) as (sensor, other, listener, until):
        sensor.create_publisher(Temperature, TOPIC, qos.WEATHER).publish(reading(7.0))
        heard = set()
        first = qos.FirstTopics(listener)
        first.readings(Temperature, TOPIC, lambda m: heard.add(m.temperature))
        until(lambda: heard == {7.0})
        late = other.create_publisher(Temperature, TOPIC, qos.SENSOR)
        until(late.get_subscription_count)
        late.publish(reading(8.0))
        until(lambda: first.poll() or heard == {7.0, 8.0})


def publish(sender, numbers):
    """Send numbers, which fit into the queue of whoever listens."""
    for number in numbers:
        sender.publish(reading(float(number)))


@pytest.mark.parametrize('profile', [qos.RELIABLE, qos.SENSOR], ids=['reliable', 'best_effort'])
def test_streams_of_every_reliability_arrive(context, profile):
    with spinning(context, sensor={}, listener={}) as (sensor, listener, until):
        heard = []
        qos.stream(listener, Temperature, TOPIC, heard.extend, qos.RELIABLE)
        sender = sensor.create_publisher(Temperature, TOPIC, profile)
        until(sender.get_subscription_count)
        publish(sender, range(100))
        until(lambda: len(heard) >= 100)
        assert [m.temperature for m in heard] == list(range(100))


def test_stream_of_publishers_of_both_reliabilities_comes_once(context):
    """The reliable publisher's messages reach two subscriptions, and each is handed over once."""
    made = []
    with spinning(context, sensor={}, other={}, listener={}) as (sensor, other, listener, until):
        heard = []
        qos.stream(listener, Temperature, TOPIC, heard.extend, qos.RELIABLE, on_created=made.append)
        reliable = sensor.create_publisher(Temperature, TOPIC, qos.RELIABLE)
        until(reliable.get_subscription_count)
        publish(reliable, range(50))
        until(lambda: len(heard) == 50)
        loose = other.create_publisher(Temperature, TOPIC, qos.SENSOR)
        until(lambda: loose.get_subscription_count() and reliable.get_subscription_count() == 2)
        until(lambda: len(made) == 2 and made[1].get_publisher_count() == 2)
        publish(reliable, range(50, 150))
        publish(loose, range(1000, 1100))
        until(lambda: len(heard) >= 250)
        publish(reliable, [150])
        until(lambda: heard[-1].temperature == 150.0)
        numbers = [m.temperature for m in heard]
        assert sorted(numbers) == [*range(151), *range(1000, 1100)]
        assert made[0].topic_name == made[1].topic_name == TOPIC


def test_override_changes_one_topic_only(context):
    """It is a parameter of the node then, and the profile that others share stays as it was."""
    name = 'qos_overrides./a.publisher.reliability'
    given = {'parameter_overrides': [Parameter(name, value='best_effort')]}
    with spinning(context, changed=given) as (node, _):
        changed = qos.publisher(node, Temperature, '/a', qos.RELIABLE)
        other = qos.publisher(node, Temperature, '/b', qos.RELIABLE)
        assert changed.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        assert other.qos_profile.reliability == qos.RELIABLE.reliability == ReliabilityPolicy.RELIABLE
        listed = {n for n in node._parameters if n.startswith('qos_overrides')}
        assert listed == {f'qos_overrides./a.publisher.{x}' for x in ('history', 'depth', 'reliability')}


@pytest.mark.parametrize('switch', [False, True])
def test_overrides_are_listed_behind_one_switch(context, switch):
    given = {'parameter_overrides': [Parameter('declare_qos_overrides', value=switch)]}
    with spinning(context, listed=given) as (node, _):
        qos.publisher(node, Temperature, 'a', qos.RELIABLE)
        qos.subscription(node, Temperature, 'b', print, qos.RELIABLE)
        assert sum(n.startswith('qos_overrides') for n in node._parameters) == (6 if switch else 0)


class Heard:
    """What a subscription with the profile of ranges is notified of."""

    def __init__(self, node):
        self.alive = self.missed = 0
        self.incompatible = False
        events = SubscriptionEventCallbacks(
            liveliness=self._liveliness, deadline=self._deadline, incompatible_qos=self._incompatible
        )
        qos.subscription(node, Temperature, TOPIC, lambda m: None, qos.range_profile(), events=events)

    def _liveliness(self, event):
        self.alive = event.alive_count

    def _deadline(self, event):
        self.missed = event.total_count

    def _incompatible(self, event):
        self.incompatible = True


def test_publisher_is_alive_while_its_executor_runs_and_not_longer(context):
    """Signs come from the executor: one that hangs gives none, though the middleware's threads live on.

    The subscriber asks for automatic liveliness, which the offer includes.
    """
    with spinning(context, listener={}) as (listener, _), spinning(context, giver={}) as (giver, _):
        heard = Heard(listener)
        sender = qos.publisher(giver, Temperature, TOPIC, qos.RANGE)
        signs = qos.live(giver, [sender])

        def wait(alive, *nodes):
            end = time.monotonic() + LIMIT
            while heard.alive != alive:
                assert time.monotonic() < end
                for node in nodes:
                    node.executor.spin_once(0.01)

        for _ in range(2):
            wait(1, listener, giver)
            wait(0, listener)
        wait(1, listener, giver)
        giver.destroy_timer(signs)
        wait(0, listener, giver)
        assert not heard.incompatible


def test_silence_between_two_messages_is_an_event_of_the_deadline(context):
    """Signs of life go on: the deadline is about messages, the lease about the publisher."""
    with spinning(context, listener={}, giver={}) as (listener, giver, until):
        heard = Heard(listener)
        sender = qos.publisher(giver, Temperature, TOPIC, qos.RANGE)
        qos.live(giver, [sender])
        until(sender.get_subscription_count)
        sender.publish(reading(7.0))
        until(lambda: heard.missed >= 3)
        assert heard.alive == 1


def test_two_stations_do_not_hide_each_other_in_the_diagnostics(context):
    """An aggregator keeps the newest status of each name."""
    stations = {'namespace': '/master'}, {'namespace': '/slave'}
    with spinning(context, station=stations[0]) as (one, _), spinning(context, station=stations[1]) as (two, until):
        names = set()
        heard = []
        two.create_subscription(DiagnosticArray, '/diagnostics', heard.append, qos.RELIABLE)
        for node in (one, two):
            Diagnostics(node, node.get_namespace()).add('Sweeps', lambda status: None)
        other = SingleThreadedExecutor(context=context)
        other.add_node(one)

        def both():
            other.spin_once(0.05)
            names.update(status.name for array in heard for status in array.status)
            return len(names) == 4

        until(both)
        assert names == {f'/{one}/station: {task}' for one in ('master', 'slave') for task in ('Sweeps', 'Software')}


@dataclasses.dataclass
class Reading:
    """The fields of a temperature; counts how often it is made into a message."""

    stamp: int = 1
    frame_id: str = 'site'
    variance: float = 0.0
    made: int = 0

    @property
    def temperature(self):
        self.made += 1
        return 20.0


@pytest.mark.parametrize(('profile', 'kept'), [(qos.WEATHER, True), (qos.RELIABLE, False)], ids=['latched', 'volatile'])
def test_message_that_nobody_would_get_is_not_made(context, profile, kept):
    """A latched one is made: who comes later gets it. From a subscriber on, every one is made."""
    heard, source = [], Reading()
    with spinning(context, sensor={}, listener={}) as (sensor, listener, until):
        publisher = qos.publisher(sensor, Temperature, TOPIC, profile)
        messages.publish(publisher, source)
        assert source.made == kept
        qos.readings(listener, Temperature, TOPIC, heard.append)
        until(lambda: len(heard) == kept and publisher.get_subscription_count())
        until(lambda: messages.publish(publisher, source) or len(heard) > kept)
    assert all(message.temperature == 20.0 for message in heard)
