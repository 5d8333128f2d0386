"""QoS profiles of the contract, and publishers and subscriptions that use them and can be overridden by parameters."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rclpy.topic_endpoint_info import TopicEndpointInfo

from . import streams

_HIGH_RATE = 700.0  # of a stream, from which on waking up for each message costs too much [1/s]
_RATE_TIME = 0.1  # over which a stream's rate is counted [s]

RELIABLE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=400,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Streams: reliable (REP 2003), deep enough for 0.4 s at 1000 sweeps/s."""

DEEP = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=5000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""A recorder's subscriptions, and results, which are small: deep enough for seconds without processor time."""

LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Settings and calibration: the last one reaches late joiners."""

RANGE_DEADLINE, RANGE_LEASE = 0.1, 1.0
"""What the publisher of ranges offers: a range at least so often, and a sign of life [s]. A subscriber may ask for the
same or more; one that asks for nothing gets ranges as ever."""

WEATHER = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=20,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Readings that hold for minutes: the last ones reach late joiners, such as a recorder, and none is lost when fast."""

SENSOR = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=400,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""A subscriber that every publisher suits, as REP 2003 has it for sensors; what the network loses is not sent again."""

_SWITCH = 'declare_qos_overrides'
_HELD = 1000  # messages of latched topics, one of each publisher or several


def range_profile(
    deadline: float = RANGE_DEADLINE,
    lease: float = RANGE_LEASE,
    liveliness: LivelinessPolicy = LivelinessPolicy.AUTOMATIC,
) -> QoSProfile:
    """Return the profile of ranges: a missed deadline and a publisher that gives no sign of life are events.

    Args:
        deadline: between two ranges [s]; what a subscriber asks for must not be below what the publisher offers.
        lease: after which a publisher without a sign of life counts as dead [s]; likewise.
        liveliness: who gives the signs; a subscriber that asks for AUTOMATIC takes those of any publisher.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=400,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
        deadline=Duration(seconds=deadline),
        liveliness=liveliness,
        liveliness_lease_duration=Duration(seconds=lease),
    )


RANGE = range_profile(liveliness=LivelinessPolicy.MANUAL_BY_TOPIC)
"""Ranges, as fusion publishes them: its executor gives the signs of life, not the middleware's threads (`live`)."""

_SIGNS = 4  # of life within a lease

_INFINITE = Duration(seconds=9223372036, nanoseconds=854775807).nanoseconds  # as the middleware writes it
_TIMED = (QoSPolicyKind.DEADLINE, QoSPolicyKind.LIVELINESS, QoSPolicyKind.LIVELINESS_LEASE_DURATION)


def _overridable(profile: QoSProfile, instance: str | None) -> QoSOverridingOptions:
    """Return which policies parameters can override: the usual ones, and times where the profile states them."""
    usual = QoSOverridingOptions.with_default_policies(entity_id=instance)
    if profile.deadline.nanoseconds in (0, _INFINITE):
        return usual
    return QoSOverridingOptions((*usual.policy_kinds, *_TIMED), entity_id=instance)


def latched_subscription(depth: int) -> QoSProfile:
    """Return the subscriber's profile of a latched topic with up to `depth` publishers (one per peer)."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def suiting(publishers: Sequence[TopicEndpointInfo], latched: bool) -> QoSProfile:
    """Return the profile with which everything that some publishers send arrives, as for a recorder.

    What was published before, and still holds, arrives too: settings, weather.

    Args:
        publishers: of one topic, as the graph shows them; none where only others listen so far.
        latched: the contract has the topic latched.
    """
    if any(p.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for p in publishers):
        return SENSOR  # a foreign sensor's; a reliable subscription would get nothing
    held = {p.qos_profile.durability for p in publishers} == {DurabilityPolicy.TRANSIENT_LOCAL}
    return latched_subscription(_HELD) if held or latched else DEEP


def publisher(
    node: Node, message_type: type, topic: str, profile: QoSProfile, instance: str | None = None
) -> Publisher:
    """Create a publisher whose QoS can be overridden by parameters.

    Args:
        node: owner.
        message_type: ROS message class.
        topic: relative or absolute name.
        profile: default QoS.
        instance: distinguishes several publishers of one node on one topic (one per peer).
    """
    options = _overriding(node, topic, 'publisher', instance, profile)
    return node.create_publisher(message_type, topic, _copy(profile), qos_overriding_options=options)


def live(node: Node, publishers: Sequence[Publisher]) -> Timer:
    """Give signs of life for publishers from the node's executor until the timer that is returned is destroyed.

    Args:
        node: whose executor must not hang for longer than the shortest lease.
        publishers: with a lease, such as those with `RANGE`.
    """

    def sign() -> None:
        for publisher in publishers:
            publisher.assert_liveliness()

    sign()
    leases = [publisher.qos_profile.liveliness_lease_duration.nanoseconds or _INFINITE for publisher in publishers]
    return node.create_timer(
        1e-9 * min(leases, default=_INFINITE) / _SIGNS, sign, clock=Clock(clock_type=ClockType.STEADY_TIME)
    )


def _copy(profile: QoSProfile) -> QoSProfile:
    """Return a copy: rclpy writes overrides into the profile that it is given."""
    names = ('history', 'depth', 'reliability', 'durability', 'lifespan', 'deadline', 'liveliness')
    same: Any = {name: getattr(profile, name) for name in (*names, 'liveliness_lease_duration')}
    return QoSProfile(**same)


def _overriding(
    node: Node, topic: str, entity: str, instance: str | None, profile: QoSProfile
) -> QoSOverridingOptions | None:
    """Return which QoS policies of a topic are parameters: all where one is given or the switch says so, else none.

    rclpy declares four parameters per publisher or subscription, which would make up most of `ros2 param list`.
    """
    if not node.has_parameter(_SWITCH):
        descriptor = ParameterDescriptor(
            description='declare the QoS of every topic as parameters (qos_overrides), so that they are listed',
            read_only=True,
        )
        node.declare_parameter(_SWITCH, False, descriptor)
    start = f'qos_overrides.{node.resolve_topic_name(topic)}.{entity}{f"_{instance}" if instance else ""}.'
    given = any(name.startswith(start) for name in node._parameter_overrides)
    return _overridable(profile, instance) if given or node.get_parameter(_SWITCH).value else None


class _Rate:
    """How many messages a second a stream brings."""

    def __init__(self) -> None:
        self.value = 0.0
        self._count, self._since = 0, time.monotonic()

    def add(self, count: int) -> None:
        """Count messages that were taken now."""
        self._count += count
        elapsed = time.monotonic() - self._since
        if elapsed > _RATE_TIME:
            self.value = self._count / elapsed
            self._count, self._since = 0, self._since + elapsed


def subscription(
    node: Node,
    message_type: type,
    topic: str,
    callback: Callable[[Any], None],
    profile: QoSProfile,
    batch: bool = False,
    instance: str | None = None,
    raw: bool = False,
    gather: float = 0.0,
    numbers: Callable[[int], None] | None = None,
    events: SubscriptionEventCallbacks | None = None,
    wanted: Callable[[Mapping[str, int]], bool] | None = None,
) -> Subscription:
    """Create a subscription whose QoS can be overridden by parameters.

    Args:
        node: owner.
        message_type: ROS message class.
        topic: relative or absolute name.
        callback: gets each message; with `batch`, a list of all messages that wait at the middleware, so that
            work is shared under load and delay stays low when idle.
        profile: default QoS.
        batch: see callback.
        instance: distinguishes several subscriptions of one node on one topic.
        raw: messages stay serialised (bytes).
        gather: with `batch`, how long to let further messages arrive before taking them all [s], while they come at a
            high rate: together they cost less each, but at a low rate none shall wait.
        numbers: with `batch`, gets the number that the publisher gave to each message, before `callback` gets them.
        events: callbacks of missed deadlines, of publishers that came or died, and of incompatible profiles, of which a
            warning is logged otherwise.
        wanted: with `batch`, gets what the middleware says about each message; those for which it is False go no
            further.
    """
    created: list[Subscription] = []
    rate = _Rate()

    def drain(first: Any, about: Any) -> None:
        if gather > 0.0 and rate.value > _HIGH_RATE:
            time.sleep(gather)
        messages, infos = [first], [about]
        handle = created[0].handle
        while len(messages) < profile.depth:
            taken = handle.take_message(message_type, raw)
            if taken is None:
                break
            messages.append(taken[0])
            infos.append(taken[1])
        rate.add(len(messages))
        if wanted is not None:
            messages = [message for message, info in zip(messages, infos, strict=True) if wanted(info)]
        if numbers is not None:
            for info in infos:
                numbers(info['publication_sequence_number'])
        if messages:
            callback(messages)

    taking: Any = drain if batch else callback  # rclpy passes what its signature asks for, which its types lack
    created.append(
        node.create_subscription(
            message_type,
            topic,
            taking,
            _copy(profile),
            qos_overriding_options=_overriding(node, topic, 'subscription', instance, profile),
            raw=raw,
            event_callbacks=events,
        )
    )
    if batch:
        streams.add(node, streams.Stream(created[0], drain))
    return created[0]


def readings(
    node: Node,
    message_type: type,
    topic: str,
    callback: Callable[[Any], None],
    on_created: Callable[[Subscription], None] = lambda created: None,
    batch: bool = False,
) -> None:
    """Subscribe to readings of somebody else's sensor, whatever QoS it publishes them with.

    Latched readings are asked for first. Where a publisher offers less, a further subscription asks for less: reliable
    ones, then best-effort ones. Where different publishers share the topic, a reading may come twice.

    Args:
        node: owner.
        message_type: ROS message class.
        topic: relative or absolute name.
        callback: gets each message; with `batch`, a list, as in `subscription`.
        on_created: gets each subscription that is made.
        batch: see callback.
    """
    profiles = iter((('latched', WEATHER), ('reliable', DEEP), ('best_effort', SENSOR)))

    def ask() -> None:
        name, profile = next(profiles)
        asked = False

        def ask_for_less(event: Any) -> None:
            nonlocal asked
            if not asked:
                asked = True
                ask()

        instance = None if profile is WEATHER else name
        events = None if profile is SENSOR else SubscriptionEventCallbacks(incompatible_qos=ask_for_less)
        on_created(subscription(node, message_type, topic, callback, profile, batch, instance=instance, events=events))

    ask()


def stream(
    node: Node,
    message_type: type,
    topic: str,
    callback: Callable[[Any], None],
    profile: QoSProfile,
    gather: float = 0.0,
    on_created: Callable[[Subscription], None] = lambda created: None,
) -> None:
    """Subscribe to somebody else's stream, reliable or best-effort: hand over lists of messages, each message once.

    A best-effort publisher is found by the event that its profile does not suit. A further, best-effort subscription
    then hears it, and what reliable publishers send as well: that would come twice.

    Args:
        node: owner.
        message_type: ROS message class.
        topic: relative or absolute name.
        callback: gets a list of all messages that wait at the middleware.
        profile: default QoS, reliable.
        gather: as in `subscription`.
        on_created: gets each subscription that is made; the last one made is matched with all publishers.
    """
    once = _Once(2 * profile.depth)

    def hear_best_effort(event: Any) -> None:
        if once.active:
            return
        once.active = True
        on_created(
            subscription(
                node,
                message_type,
                topic,
                callback,
                SENSOR,
                batch=True,
                instance='best_effort',
                gather=gather,
                wanted=once,
            )
        )

    events = SubscriptionEventCallbacks(incompatible_qos=hear_best_effort)
    on_created(
        subscription(
            node, message_type, topic, callback, profile, batch=True, gather=gather, events=events, wanted=once
        )
    )


class _Once:
    """Which messages of two subscriptions to one topic come for the first time."""

    def __init__(self, most: int) -> None:
        """Remember up to `most` messages once `active`."""
        self.active = False
        self._most = most
        self._known: dict[tuple[int, int], None] = {}  # time of publishing [ns], publisher's number; the oldest first

    def __call__(self, about: Mapping[str, int]) -> bool:
        """Return whether a message, by what the middleware says about it, has not come yet."""
        if not self.active:
            return True
        key = about['source_timestamp'], about['publication_sequence_number']
        if key in self._known:
            return False
        self._known[key] = None
        if len(self._known) > self._most:
            del self._known[next(iter(self._known))]
        return True


class FirstTopics:
    """Subscriptions whose messages are taken before those of a stream that depends on them.

    Topics have no order among each other. A reading that was published before a sweep waits at the middleware when the
    sweep's result arrives, but an executor may serve the result first; `poll`, called by the stream's callback, puts
    that right.
    """

    def __init__(self, node: Node) -> None:
        """Start with no topic."""
        self._node = node
        self._subscriptions: list[tuple[Subscription, type, Callable[[Any], None]]] = []

    def subscription(
        self, message_type: type, topic: str, callback: Callable[[Any], None], profile: QoSProfile
    ) -> None:
        """Subscribe as the function of this name does."""
        created = subscription(self._node, message_type, topic, callback, profile)
        self._subscriptions.append((created, message_type, callback))

    def readings(self, message_type: type, topic: str, callback: Callable[[Any], None]) -> None:
        """Subscribe as the function of this name does."""

        def keep(created: Subscription) -> None:
            self._subscriptions.append((created, message_type, callback))

        readings(self._node, message_type, topic, callback, keep)

    def poll(self) -> None:
        """Hand over all messages that wait."""
        for created, message_type, callback in self._subscriptions:
            while (taken := created.handle.take_message(message_type, False)) is not None:
                callback(taken[0])
