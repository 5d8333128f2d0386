"""Renders a scenario into a rosbag2 recording, as fast as possible, never holding more than a few blocks of sweeps."""

import contextlib
import dataclasses
import itertools
import math
import multiprocessing
import os
import queue
import signal
import threading
import traceback
from collections.abc import Callable, Generator, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.bag.files import BagWriter, typestore
from drfmcw_ros.topics import SITE_TOPICS, STATION_TOPICS, split_station_topic

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
    """Yield a scenario cut into blocks, each while the timeline stands before it; one without sweeps has no slots."""
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


def _messages(scenario: Scenario, share: int, jobs: int) -> Iterator[list[_Message]]:
    """Yield the serialised messages of every `jobs`-th block of a scenario, from number `share` on."""
    store, timeline = typestore(), Timeline(scenario)
    for number, block in enumerate(_blocks(timeline, _BLOCK)):
        if number % jobs == share:
            messages = []
            for event in _render(timeline, block):
                name = message_type(event.topic)
                data = bytes(store.serialize_cdr(to_rosbags(event.content, name), name))
                messages.append(_Message(event.topic, name, event.stamp, data, event.sweep_id))
            yield messages


def _send_share(connection: Connection, scenario: Scenario, share: int, jobs: int) -> None:
    """Send a share of the blocks, then None; a process's whole life, which ends when nobody takes them any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where the mask was not inherited
    waiting: queue.Queue[list[_Message] | None] = queue.Queue(_AHEAD)

    def send() -> None:
        try:
            while (messages := waiting.get()) is not None:
                connection.send(messages)
            connection.send(None)
        except OSError:  # whoever took them has ended, or does not want them any more
            os._exit(1)

    sender = threading.Thread(target=send)
    sender.start()
    try:
        for messages in _messages(scenario, share, jobs):
            waiting.put(messages)
        waiting.put(None)
        sender.join()
    except BaseException:
        traceback.print_exc()
        os._exit(1)


def _rendered(scenario: Scenario, jobs: int) -> Generator[list[_Message], None, None]:
    """Yield the messages of each block in order, rendered by `jobs` processes not far ahead of what is taken.

    A process renders every jobs-th block and sends it through a pipe of its own, which tells when it has died.

    Raises:
        ConfigurationError: a process died.
    """
    if jobs == 1:
        yield from _messages(scenario, 0, 1)
        return
    # forkserver: this process may have threads, which a fork would leave in any state
    context = multiprocessing.get_context('forkserver')
    context.set_forkserver_preload([__name__])
    workers = []
    # Ctrl-C reaches every process of the terminal; only this one is to answer it. Those started now inherit the mask,
    # which the start of the resource tracker would undo.
    resource_tracker.ensure_running()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        for share in range(jobs):
            receiver, sender = context.Pipe(duplex=False)
            process = context.Process(target=_send_share, args=(sender, scenario, share, jobs), daemon=True)
            process.start()
            sender.close()
            workers.append((process, receiver))
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for _, receiver in itertools.cycle(workers):
            messages = receiver.recv()
            if messages is None:
                return
            yield messages
    except (EOFError, OSError):
        raise ConfigurationError('a rendering process was killed, by lack of memory perhaps; try --jobs 1') from None
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for process, receiver in workers:
            receiver.close()
            process.kill()
            process.join()


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
