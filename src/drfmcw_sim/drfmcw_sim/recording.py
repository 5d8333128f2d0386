"""Renders a scenario into a rosbag2 recording, as fast as possible, never holding more than a few blocks of sweeps."""

import collections
import copy
import dataclasses
import math
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, NamedTuple

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.bag import BagWriter, typestore
from drfmcw_ros.topics import SITE_TOPICS, STATION_TOPICS, split_station_topic

from .scenario import Scenario
from .timeline import NANOSECONDS, Event, Slots, Timeline

_BLOCK = 64  # measurements rendered at once
_AHEAD = 3  # blocks per process that may wait to be written


def message_type(topic: str) -> str:
    """Return the type of a simulated topic."""
    return SITE_TOPICS.get(topic) or STATION_TOPICS[split_station_topic(topic)[1]]


def to_rosbags(content: Any, name: str) -> Any:
    """Return a dataclass with a message's fields as message of type `name`.

    Serialised by rosbags, equal messages have equal bytes; rclpy leaves padding as it finds it.
    """
    types = typestore().types
    cls = types[name]
    values = {}
    for field in dataclasses.fields(cls):
        if field.name == 'header':
            seconds, nanoseconds = divmod(content.stamp, NANOSECONDS)
            stamp = types['builtin_interfaces/msg/Time'](sec=seconds, nanosec=nanoseconds)
            values['header'] = types['std_msgs/msg/Header'](stamp=stamp, frame_id=content.frame_id)
        elif field.default is dataclasses.MISSING:  # constants of the message have defaults
            values[field.name] = getattr(content, field.name)
    return cls(**values)


@dataclasses.dataclass(frozen=True)
class _Block:
    """Measurements that are rendered together, and what is published before them."""

    timeline: Timeline  # as it stands before them
    slots: Slots
    before: list[Event]

    def events(self) -> Iterator[Event]:
        """Yield everything that is published, in order; the IF samples are synthesised here."""
        yield from self.before
        if len(self.slots):
            yield from self.timeline.render(self.slots)


class _Message(NamedTuple):
    """One message as it is written."""

    topic: str
    type: str
    stamp: int
    data: bytes
    sweep_id: int


def _blocks(timeline: Timeline, size: int) -> Iterator[_Block]:
    """Yield a scenario cut into blocks; moves the timeline to its end."""
    before = timeline.opening()
    while not timeline.finished:
        slots = timeline.slots(size)
        if len(slots) == 0:
            before += timeline.due_mode_changes()
            continue
        yield _Block(copy.deepcopy(timeline), slots, before)
        timeline.advance(len(slots))
        before = []
    if before:
        yield _Block(timeline, timeline.slots(0), before)


def events(timeline: Timeline, block: int = _BLOCK) -> Iterator[Event]:
    """Yield everything that a scenario publishes, in order."""
    for part in _blocks(timeline, block):
        yield from part.events()


def _messages(block: _Block) -> list[_Message]:
    """Return a block's serialised messages; in a process of its own where several render."""
    store, result = typestore(), []
    for event in block.events():
        name = message_type(event.topic)
        data = bytes(store.serialize_cdr(to_rosbags(event.content, name), name))
        result.append(_Message(event.topic, name, event.stamp, data, event.sweep_id))
    return result


def _end_with_parent() -> None:
    """Let a rendering process end when the one that started it is gone, however it went; Ctrl-C is that one's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _rendered(blocks: Iterator[_Block], jobs: int) -> Iterator[list[_Message]]:
    """Yield the messages of each block in order, rendered by `jobs` processes not far ahead of what is taken.

    Raises:
        ConfigurationError: a process died.
    """
    if jobs == 1:
        yield from map(_messages, blocks)
        return
    # forkserver: this process may have threads, which a fork would leave in any state
    context = multiprocessing.get_context('forkserver')
    context.set_forkserver_preload([__name__])
    pool = ProcessPoolExecutor(jobs, context, _end_with_parent)
    under_way: collections.deque[Future] = collections.deque()
    try:
        for block in blocks:
            under_way.append(pool.submit(_messages, block))
            if len(under_way) > _AHEAD * jobs:
                yield under_way.popleft().result()
        while under_way:
            yield under_way.popleft().result()
    except BrokenProcessPool:
        raise ConfigurationError('a rendering process was killed, by lack of memory perhaps; try --jobs 1') from None
    finally:
        pool.shutdown(cancel_futures=True)


def write_recording(
    scenario: Scenario,
    path: Path | str,
    storage: str = 'mcap',
    progress: Callable[[int], None] | None = None,
    overwrite: bool = False,
    jobs: int = 1,
) -> int:
    """Render a scenario into a recording of the measured topics; return the number of measurements.

    Args:
        scenario: what to simulate.
        path: of the recording, a directory.
        storage: 'mcap' or 'sqlite3'.
        progress: called with the number of measurements done so far.
        overwrite: replace a recording of that name.
        jobs: processes that render; the recording is the same, byte by byte, whatever their number.

    Raises:
        ConfigurationError: the recording exists or cannot be written, or a rendering process died.
    """
    timeline = Timeline(scenario)
    jobs = min(jobs, math.ceil(timeline.sweep_count / _BLOCK))
    with BagWriter(path, storage, overwrite) as bag:
        for messages in _rendered(_blocks(timeline, _BLOCK), jobs):
            for message in messages:
                bag.write(message.topic, message.type, message.stamp, message.data)
            if progress is not None:
                progress(max(message.sweep_id for message in messages) + 1)
    return timeline.next_sweep_id
