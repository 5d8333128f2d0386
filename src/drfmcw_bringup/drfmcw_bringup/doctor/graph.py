"""The running graph: whether participants find each other, QoS that does not fit, publishers, stamps."""

import contextlib
import itertools
import time
from collections.abc import Iterator
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import message_class, stamp_ns
from drfmcw_ros.graph.topics import PAIR_TOPICS, STATION_TOPICS, is_latched, split_station_topic

from .finding import ERROR, OK, WARN, Finding

_NAMES = ('drfmcw_doctor', 'drfmcw_doctor_peer')
_LIMIT = 15.0  # for two participants to find each other; takes up to 3 s on an idle machine [s]
_APART = 1.0  # of a stamp and the system clock, beyond which they do not belong together [s]
_ONE_SOURCE = ('beat_frequency', 'if_samples', 'range', 'status')
"""Topics on which nobody can separate a second node's messages from the first one's."""


@contextlib.contextmanager
def participants(domain_id: int | None = None) -> Iterator[tuple[Node, Node, SingleThreadedExecutor]]:
    """Give two nodes, each a participant of its own, and the first one's executor."""
    with contextlib.ExitStack() as cleanup:
        made = []
        for name in _NAMES:
            context = rclpy.Context()
            rclpy.init(args=[], context=context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
            cleanup.callback(context.try_shutdown)
            node = Node(name, context=context)
            cleanup.callback(node.destroy_node)
            made.append(node)
        executor = SingleThreadedExecutor(context=made[0].context)
        executor.add_node(made[0])
        cleanup.callback(executor.shutdown)
        yield made[0], made[1], executor


def check_graph(seconds: float, domain_id: int | None = None) -> Iterator[Finding]:
    """Yield what is wrong with the nodes that run.

    Args:
        seconds: how long to look for nodes and to listen.
        domain_id: ROS domain; None takes the environment's.
    """
    with participants(domain_id) as (node, peer, executor):
        began = time.monotonic()
        heard: list[Any] = []
        qos.subscription(node, String, '/drfmcw_doctor', heard.append, qos.LATCHED)
        qos.publisher(peer, String, '/drfmcw_doctor', qos.LATCHED).publish(String(data='found'))
        while not heard and time.monotonic() - began < _LIMIT:
            executor.spin_once(0.1)
        if not heard:
            said = f'two participants on this machine did not find each other within {_LIMIT:.0f} s'
            yield Finding(ERROR, 'discovery', said, 'see range, multicast, shared memory and the firewall')
            return
        rmw = rclpy.utilities.get_rmw_implementation_identifier()
        said = f'two participants found each other in {time.monotonic() - began:.1f} s, with {rmw}'
        yield Finding(OK, 'discovery', said)
        yield from _running(node, executor, seconds)


def _running(node: Node, executor: SingleThreadedExecutor, seconds: float) -> Iterator[Finding]:
    ages: dict[str, float] = {}
    listened: set[str] = set()
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for topic, kinds in node.get_topic_names_and_types():
            if topic not in listened and _is_stamped(topic) and node.count_publishers(topic):
                listened.add(topic)
                _listen(node, topic, kinds[0], ages)
        executor.spin_once(0.1)
    nodes = {f'{n[1].rstrip("/")}/{n[0]}' for n in node.get_node_names_and_namespaces()}
    nodes = {name for name in nodes if not name.startswith(f'/{_NAMES[0]}')}
    if not nodes:
        yield Finding(OK, 'nodes', 'none runs in this ROS domain; `run` and `demo` have a domain of their own')
        return
    yield Finding(OK, 'nodes', ', '.join(sorted(nodes)))
    found = [*_mismatches(node), *_rivals(node), *_stamps(ages)]
    yield from found or [Finding(OK, 'topics', 'QoS of all publishers and subscriptions fit, one publisher each')]


def _is_stamped(topic: str) -> bool:
    """Return True for streams of the contract with stamps; latched ones may be old rightly."""
    name = split_station_topic(topic)[1]
    return (name in STATION_TOPICS or name in PAIR_TOPICS) and not is_latched(topic)


def _listen(node: Node, topic: str, kind: str, ages: dict[str, float]) -> None:
    def take(message: Any) -> None:
        ages[topic] = (time.time_ns() - stamp_ns(message.header.stamp)) * 1e-9

    qos.subscription(node, message_class(kind), topic, take, qos.SENSOR)


def _owner(info: Any) -> str:
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'


def _mismatches(node: Node) -> Iterator[Finding]:
    """Yield pairs of nodes that share a topic and yet do not hear each other."""
    for topic, _ in node.get_topic_names_and_types():
        deaf: dict[tuple[str, str], str] = {}
        hearing = set()
        infos = itertools.product(node.get_publishers_info_by_topic(topic), node.get_subscriptions_info_by_topic(topic))
        for publisher, subscription in infos:
            pair = (_owner(publisher), _owner(subscription))
            fits, reason = qos_check_compatible(publisher.qos_profile, subscription.qos_profile)
            if fits == QoSCompatibility.ERROR:
                deaf[pair] = ' '.join(reason.removeprefix('ERROR: ').rstrip(';').split())
            else:
                hearing.add(pair)  # by another subscription, which asks for less
        for (sender, receiver), reason in deaf.items():
            if (sender, receiver) not in hearing:
                said = f'{topic}: {receiver} hears nothing of {sender}: {reason}'
                advice = 'set qos_overrides parameters of one of the two (declare_qos_overrides:=true lists them)'
                yield Finding(ERROR, 'QoS', said, advice)


def _rivals(node: Node) -> Iterator[Finding]:
    for topic, _ in node.get_topic_names_and_types():
        owners = [_owner(info) for info in node.get_publishers_info_by_topic(topic)]
        if split_station_topic(topic)[1] in _ONE_SOURCE and len(owners) > 1:
            said = f'{len(owners)} publishers on {topic}: {", ".join(sorted(owners))}'
            yield Finding(ERROR, 'publishers', said, 'end one of them, or give the second graph another ROS_DOMAIN_ID')


def _stamps(ages: dict[str, float]) -> Iterator[Finding]:
    for topic, age in sorted(ages.items()):
        if abs(age) > _APART:
            said = f'{topic} is stamped {abs(age):.1f} s {"before" if age > 0.0 else "after"} the system clock'
            advice = "synchronise the computers' clocks, or set time_offset; right for a replay or a simulated time"
            yield Finding(WARN, 'stamps', said, advice)
