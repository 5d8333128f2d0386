"""Renders a scenario into a rosbag2 recording, as fast as possible, never holding more than a few sweeps."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from drfmcw_ros.bag import BagWriter, typestore
from drfmcw_ros.topics import SITE_TOPICS, STATION_TOPICS, split_station_topic

from .scenario import Scenario
from .timeline import NANOSECONDS, Event, Timeline

_BLOCK = 64  # measurements rendered at once


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


def events(timeline: Timeline, block: int = _BLOCK) -> Iterator[Event]:
    """Yield everything that a scenario publishes, in order."""
    yield from timeline.opening()
    while not timeline.finished:
        slots = timeline.slots(block)
        if len(slots) == 0:
            yield from timeline.due_mode_changes()
            continue
        yield from timeline.render(slots)
        timeline.advance(len(slots))


def write_recording(
    scenario: Scenario,
    path: Path | str,
    storage: str = 'mcap',
    progress: Callable[[int], None] | None = None,
    overwrite: bool = False,
) -> int:
    """Render a scenario into a recording of the measured topics; return the number of measurements.

    Args:
        scenario: what to simulate.
        path: of the recording, a directory.
        storage: 'mcap' or 'sqlite3'.
        progress: called with the number of measurements done so far.
        overwrite: replace a recording of that name.

    Raises:
        ConfigurationError: the recording exists or cannot be written.
    """
    timeline = Timeline(scenario)
    with BagWriter(path, storage, overwrite) as bag:
        for event in events(timeline):
            name = message_type(event.topic)
            bag.write(event.topic, name, event.stamp, to_rosbags(event.content, name))
            if progress is not None and event.sweep_id >= 0:
                progress(event.sweep_id + 1)
    return timeline.next_sweep_id
