"""Renders a scenario into a rosbag2 recording, as fast as possible, never holding more than a few blocks of sweeps."""

import contextlib
import dataclasses
import itertools
import math
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.bag.files import BagWriter, typestore
from drfmcw_ros.graph.topics import SITE_TOPICS, STATION_TOPICS, split_station_topic
from drfmcw_ros.work.processes import Worker, WorkFailed

from .scenario import Scenario
from .timeline import NANOSECONDS, Event, Slots, Timeline

_BLOCK = 64  # measurements rendered at once
_AHEAD = 3  # blocks of a process that may wait to be written


def message_type(topic: str) -> str:
    """Return the type of a simulated topic."""
    return SITE_TOPICS.get(topic) or STATION_TOPICS[split_station_topic(topic)[1]]


def to_rosbags(content: Any, name: str) -> Any:
    """Return a dataclass with a message's fields as message of type `name`.

    Serialised by rosbags, equal messages have equal bytes; rclpy leaves padding as it finds it.
    """
    types = typestore().types
    cls: Any = types[name]
    values = {}
    for field in dataclasses.fields(cls):
        if field.name == 'header':
            seconds, nanoseconds = divmod(content.stamp, NANOSECONDS)
            stamp = types['builtin_interfaces/msg/Time'](sec=seconds, nanosec=nanoseconds)
            values['header'] = types['std_msgs/msg/Header'](stamp=stamp, frame_id=content.frame_id)
        elif field.default is dataclasses.MISSING:  # constants of the message have defaults
            values[field.name] = getattr(content, field.name)
    return cls(**values)


class _Block(NamedTuple):
    """Measurements that are rendered together, and what is published before them."""

    before: list[Event]
    slots: Slots | None


class _Message(NamedTuple):
    """One message as it is written."""

    topic: str
    type: str
    stamp: int
    data: bytes
    sweep_id: int


def _blocks(timeline: Timeline, size: int) -> Iterator[_Block]:
    """Yield the blocks of a scenario; the timeline stays at a block's start until the next one is asked for."""
    before = timeline.opening()
    while not timeline.finished:
        slots = timeline.slots(size)
        if len(slots) == 0:
            before += timeline.due_mode_changes()
            continue
        yield _Block(before, slots)
        timeline.advance(len(slots))
        before = []
    if before:
        yield _Block(before, None)


def _render(timeline: Timeline, block: _Block) -> Iterator[Event]:
    """Yield everything that is published with a block, in order; the IF samples are synthesised here."""
    yield from block.before
    if block.slots is not None:
        yield from timeline.render(block.slots)


def events(timeline: Timeline, block: int = _BLOCK) -> Iterator[Event]:
    """Yield everything that a scenario publishes, in order."""
    for part in _blocks(timeline, block):
        yield from _render(timeline, part)


def _share(order: tuple[Scenario, int, int]) -> Iterator[list[_Message]]:
    """Yield the serialised messages of every n-th block of a scenario; of (scenario, number of the first block, n)."""
    scenario, first, step = order
    store, timeline = typestore(), Timeline(scenario)
    for number, block in enumerate(_blocks(timeline, _BLOCK)):
        if number % step == first:
            messages = []
            for event in _render(timeline, block):
                name = message_type(event.topic)
                data = bytes(store.serialize_cdr(to_rosbags(event.content, name), name))
                messages.append(_Message(event.topic, name, event.stamp, data, event.sweep_id))
            yield messages


def _rendered(scenario: Scenario, jobs: int) -> Generator[list[_Message], None, None]:
    """Yield the messages of each block in order, rendered by `jobs` processes not far ahead of what is taken.

    Raises:
        ConfigurationError: a process died.
    """
    if jobs == 1:
        yield from _share((scenario, 0, 1))
        return
    with contextlib.ExitStack() as stack:
        # not forked: this process may have threads
        workers = [
            stack.enter_context(Worker(_share, start='forkserver', preload=[__name__], ahead=_AHEAD))
            for _ in range(jobs)
        ]
        try:
            for first, worker in enumerate(workers):
                worker.give((scenario, first, jobs))
            for blocks in itertools.cycle([worker.results() for worker in workers]):
                messages = next(blocks, None)
                if messages is None:  # no block of this share is left, so none of a later number either
                    return
                yield messages
        except WorkFailed as error:
            raise ConfigurationError(
                f'a rendering process was lost ({error}), by lack of memory perhaps; try --jobs 1'
            ) from None


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
    count = 0
    jobs = min(jobs, math.ceil(Timeline(scenario).sweep_count / _BLOCK))
    with BagWriter(path, storage, overwrite) as bag, contextlib.closing(_rendered(scenario, jobs)) as rendered:
        for messages in rendered:
            for message in messages:
                bag.write(message.topic, message.type, message.stamp, message.data)
                count = max(count, message.sweep_id + 1)
            if progress is not None:
                progress(count)
    return count
