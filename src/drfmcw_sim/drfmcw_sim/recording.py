"""Renders a scenario into a rosbag2 recording, as fast as possible, never holding more than a few sweeps."""

import functools
import importlib
from collections.abc import Callable, Iterator
from pathlib import Path

from drfmcw_ros.bag import BagWriter
from drfmcw_ros.messages import to_message
from drfmcw_ros.topics import SITE_TOPICS, STATION_TOPICS, split_station_topic
from rclpy.serialization import serialize_message

from .scenario import Scenario
from .timeline import Event, Timeline

_BLOCK = 64  # measurements rendered at once


def message_type(topic: str) -> str:
    """Return the type of a simulated topic."""
    return SITE_TOPICS.get(topic) or STATION_TOPICS[split_station_topic(topic)[1]]


@functools.cache
def message_class(topic: str) -> type:
    """Return the ROS message class of a simulated topic."""
    package, _, name = message_type(topic).split('/')
    return getattr(importlib.import_module(f'{package}.msg'), name)


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


def write_recording(scenario: Scenario, path: Path | str, storage: str = 'mcap', progress: Callable[[int], None] | None = None) -> int:
    """Render a scenario into a recording of the measured topics; return the number of measurements.

    Args:
        scenario: what to simulate.
        path: of the recording, a directory; must not exist.
        storage: 'mcap' or 'sqlite3'.
        progress: called with the number of measurements done so far.

    Raises:
        ConfigurationError: the recording exists or cannot be written.
    """
    timeline = Timeline(scenario)
    with BagWriter(path, storage) as bag:
        for event in events(timeline):
            message = serialize_message(to_message(event.content, message_class(event.topic)))
            bag.write(event.topic, message_type(event.topic), event.stamp, message)
            if progress is not None and event.sweep_id >= 0:
                progress(event.sweep_id + 1)
    return timeline.next_sweep_id
