"""Playing a recording's measured topics into the live graph, keeping or scaling time."""

import argparse
import collections
import contextlib
import functools
import itertools
import math
import struct
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

import rclpy
from drfmcw_msgs.msg import BeatFrequency
from rclpy.node import Node
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

from drfmcw_physics.settings import ConfigurationError

from ..graph import qos
from ..graph.messages import NANOSECONDS, message_class
from ..graph.topics import STATION_TOPICS, is_latched, is_measured, is_per_peer, split_station_topic
from ..nodes.diagnostics import WARN, Diagnostics, Status
from ..nodes.runner import spinning
from ..work.progress import Progress
from .files import BagReader, typestore

_SETTLE_TIME = 0.25  # between settings and the first sweep that uses them, so that they arrive first [s]
_QUIET_TIME = 3.5  # without a new subscriber, after which all count as there: DDS announces every 3 s who is there [s]
_LONGEST_PAUSE = 1.0  # a longer one, of a recording made in pieces, is cut to this [s]
_WINDOW = 20  # unanswered sweeps per station at full speed; with 100, on one core, weather came after its sweeps
_ANSWER_LIMIT = 1.0  # how long such a wait may last before playing goes on [s]
_STAMP = struct.Struct('<iI')  # of the header that every message begins with, behind 4 bytes of encapsulation


class PlayerNode(Node):
    """Publishes serialised messages on the measured topics and counts the stations' answers."""

    def __init__(self, bag: BagReader, flow_control: bool, **kwargs: Any) -> None:
        """Create publishers of all measured topics of the recording; with flow control also listen to the answers."""
        super().__init__('player', **kwargs)
        self.stations: list[str] = []
        self._senders: dict[tuple[str, str], Any] = {}  # by topic and peer (of topics per peer only)
        self._answered = threading.Condition()
        self._waiting: collections.Counter[str] = collections.Counter()
        self._sent = self._reported = 0
        Diagnostics(self, 'player').add('Playing', self._diagnose)
        for topic, kind in bag.topics.items():
            if not is_measured(topic):
                continue
            station, name = split_station_topic(topic)
            profile = qos.LATCHED if is_latched(topic) else qos.RELIABLE
            peers = {m.peer for _, _, m in bag.messages({topic})} if is_per_peer(topic) else {''}
            for peer in peers:
                sender = qos.publisher(self, message_class(kind), topic, profile, instance=peer or None)
                self._senders[topic, peer] = sender
            if name == 'if_samples':
                self.stations.append(station)
                if flow_control:
                    answer = functools.partial(self._count, station)
                    qos.subscription(
                        self, BeatFrequency, f'/{station}/beat_frequency', answer, qos.RELIABLE, batch=True
                    )

    def _diagnose(self, status: Status) -> None:
        if self._sent == self._reported:
            status.report(WARN, 'nothing sent in the last second')
        status.value('messages per second', self._sent - self._reported)
        self._reported = self._sent

    def _count(self, station: str, messages: list[BeatFrequency]) -> None:
        with self._answered:
            self._waiting[station] = max(0, self._waiting[station] - len(messages))
            self._answered.notify()

    def wait_for_subscribers(self, limit: float) -> list[str]:
        """Wait at most `limit` seconds until each station has a listener; return the stations that have none.

        Other nodes listen only to weather, status or settings: also wait until no further subscriber appears.
        Settings end with this process: a fusion that is found too late would never get them.
        """
        end = time.monotonic() + limit
        matched: dict[tuple[str, str], int] = {}
        changed = time.monotonic()
        while time.monotonic() < end:
            now = {key: sender.get_subscription_count() for key, sender in self._senders.items()}
            if now != matched:
                matched, changed = now, time.monotonic()
            if time.monotonic() - changed > _QUIET_TIME and all(matched[f'/{s}/if_samples', ''] for s in self.stations):
                break
            time.sleep(0.02)
        return [s for s in self.stations if not matched.get((f'/{s}/if_samples', ''))]

    def send(self, topic: str, raw: bytes, flow_control: bool) -> None:
        """Publish one serialised message; with flow control wait until the stations keep up."""
        station, name = split_station_topic(topic)
        if flow_control and name == 'if_samples':
            with self._answered:
                if not self._answered.wait_for(lambda: self._waiting[station] < _WINDOW, _ANSWER_LIMIT):
                    self.get_logger().warning(f"'{station}' does not answer; going on", throttle_duration_sec=5.0)
                    self._waiting[station] = 0
                self._waiting[station] += 1
        peer = _peer(topic, raw) if is_per_peer(topic) else ''
        self._senders[topic, peer].publish(raw)
        self._sent += 1


def play(arguments: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    """Play a recording as the command line of `replay --publish` says.

    Raises:
        ConfigurationError: negative rate or loop count, unreadable recording, no samples in it.
    """
    if not arguments.rate >= 0.0 or math.isinf(arguments.rate) or arguments.loop < 0:
        raise ConfigurationError(f'--rate {arguments.rate:g} and --loop {arguments.loop} must not be negative')
    with BagReader(arguments.recording) as bag, contextlib.ExitStack() as cleanup:
        if not any(split_station_topic(t)[1] == 'if_samples' for t in bag.topics):
            raise ConfigurationError(f"{bag.path}: holds no '/<station>/if_samples'")
        rclpy.init(args=['player', *ros_arguments])
        cleanup.callback(rclpy.try_shutdown)
        node = PlayerNode(bag, flow_control=not arguments.rate)
        cleanup.enter_context(spinning(node))
        for station in node.wait_for_subscribers(arguments.wait):
            node.get_logger().warning(f"nobody listens to '/{station}/if_samples'")
        _play(node, bag, arguments)
    return 0


def _play(node: PlayerNode, bag: BagReader, arguments: argparse.Namespace) -> None:
    total = bag.message_count * arguments.loop or None
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console) as progress:
        task = progress.add_task('playing', total=total)
        began = time.monotonic()
        skipped = 0.0  # recorded time cut out of long pauses [s]
        added = 0.0  # time spent to let settings arrive [s]
        origin = last = 0  # recorded time of the first and of the last message [ns]
        settings_sent = False
        for count, (topic, recorded, raw) in enumerate(_messages(bag, arguments.loop)):
            if not rclpy.ok():
                return
            if count == 0:
                origin = last = recorded
            skipped += max(0.0, (recorded - last) * 1e-9 - _LONGEST_PAUSE)
            last = recorded
            if is_latched(topic):
                settings_sent = True
            elif settings_sent:
                time.sleep(_SETTLE_TIME)
                added += _SETTLE_TIME
                settings_sent = False
            if arguments.rate:
                due = began + added + ((recorded - origin) * 1e-9 - skipped) / arguments.rate
                pause = due - time.monotonic()
                if pause > 0:
                    time.sleep(pause)
            if arguments.restamp:
                raw = _restamped(raw, time.time_ns())
            node.send(topic, raw, flow_control=not arguments.rate)
            if count % 64 == 0:
                progress.update(task, completed=count)


def _messages(bag: BagReader, loops: int) -> Iterator[tuple[str, int, bytes]]:
    """Yield (topic, time [ns], serialised message) of `loops` rounds; stamps and sweep numbers go on."""
    topics = {t for t in bag.topics if is_measured(t)}
    if loops == 1:
        yield from ((topic, time_ns, raw) for topic, time_ns, _, raw in bag.raw_messages(topics, whole=True))
        return
    kept = [(topic, time_ns, raw) for topic, time_ns, _, raw in bag.raw_messages(topics, whole=True)]
    numbers = {_sweep_id(raw)[1] for topic, _, raw in kept if topic.endswith('/if_samples')}
    next_number = max(numbers) + 1
    times = [t for topic, t, _ in kept if topic.endswith('/if_samples')]  # settings come some time before
    span = times[-1] - times[0]
    period = span + max(1, span // len(numbers))
    # settings that never changed still hold in later rounds
    counts = collections.Counter((topic, _peer(topic, raw)) for topic, _, raw in kept if is_per_peer(topic))
    changing = {split_station_topic(topic)[1] for (topic, _), count in counts.items() if count > 1}
    for round_number in itertools.count() if loops == 0 else range(loops):
        shift = round_number * period
        for topic, time_ns, raw in kept:
            if round_number:
                if is_latched(topic) and split_station_topic(topic)[1] not in changing:
                    continue
                raw = _restamped(raw, _stamp(raw) + shift)
                if topic.endswith('/if_samples'):
                    raw = _renumbered(raw, round_number * next_number)
            yield topic, time_ns + shift, raw


def _peer(topic: str, raw: bytes) -> str:
    """Return the peer that a serialised message of a topic per peer is for."""
    message: Any = typestore().deserialize_cdr(raw, STATION_TOPICS[split_station_topic(topic)[1]])
    return message.peer


def _stamp(raw: bytes) -> int:
    seconds, nanoseconds = _STAMP.unpack_from(raw, 4)
    return seconds * NANOSECONDS + nanoseconds


def _restamped(raw: bytes, stamp: int) -> bytes:
    """Return a serialised message with another header stamp [ns]."""
    return raw[:4] + _STAMP.pack(*divmod(stamp, NANOSECONDS)) + raw[12:]


def _sweep_id(raw: bytes) -> tuple[int, int]:
    """Return (offset, value) of the sweep number in a serialised IfSamples: behind frame_id, station and peer."""
    at = 12
    for _ in range(3):
        length = struct.unpack_from('<I', raw, at)[0]
        at = (at + 4 + length + 3) // 4 * 4
    at = 4 + (at - 4 + 7) // 8 * 8  # CDR aligns to the start of the body
    return at, struct.unpack_from('<Q', raw, at)[0]


def _renumbered(raw: bytes, shift: int) -> bytes:
    at, number = _sweep_id(raw)
    return raw[:at] + struct.pack('<Q', number + shift) + raw[at + 8 :]
