"""Where the time between a sweep and its range goes: when the middleware was given each message of the path."""

import collections
import functools
import struct
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from drfmcw_msgs.msg import BeatFrequency, IfSamples, RangeEstimate
from figures import Figure
from graph import STATIONS, scenario_overrides, start_fusion_and_stations
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rich.console import Console
from rich.progress import track

from drfmcw_bringup.graph import SIMULATOR, Graph, parameters, private_environment
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.config_files import find_config
from drfmcw_ros.graph import qos

_RATE = 500.0  # sweep pairs per second
_WARM_UP = 8.0  # start of the processes, discovery, first use of every code path [s]
_STAMP = struct.Struct('<iI')  # of the header, which comes first in each message, behind 4 bytes of encapsulation
_STEPS = (  # topic, message, what lies before it
    (f'/{STATIONS[0]}/if_samples', IfSamples, 'simulator'),
    (f'/{STATIONS[0]}/beat_frequency', BeatFrequency, 'station'),
    (f'/{STATIONS[0]}/{STATIONS[1]}/range', RangeEstimate, 'fusion'),
)
_Times = dict[str, list[tuple[int, int, int]]]  # of each topic: stamp, given to the middleware, received [ns]


def _keep(times: list[tuple[int, int, int]], taken: list[Any], message: bytes, info: Any) -> None:
    """Keep the times of a message and of all that wait behind it."""
    received = time.time_ns()
    (subscription,) = taken
    following = (message, info)
    while following is not None:
        raw, about = following
        seconds, nanoseconds = _STAMP.unpack_from(raw, 4)
        times.append((seconds * 10**9 + nanoseconds, about['source_timestamp'], received))
        following = subscription.handle.take_message(subscription.msg_type, True)


def _traced(node: Node) -> _Times:
    """Subscribe to every step; return where its times will be."""
    times: _Times = collections.defaultdict(list)
    for topic, kind, _ in _STEPS:
        taken: list[Any] = []
        keep: Any = functools.partial(_keep, times[topic], taken)  # rclpy passes two arguments, which its types lack
        taken.append(node.create_subscription(kind, topic, keep, qos.RELIABLE, raw=True))
    return times


def bench_latency(seconds: float, console: Console) -> list[Figure]:
    """Trace a sweep through the live graph at 500 sweep pairs per second: when was each message published?"""
    environment = private_environment()
    with tempfile.TemporaryDirectory(prefix='drfmcw-bench-') as directory, Graph(environment, Path(directory)) as graph:
        start_fusion_and_stations(graph)
        overrides = '[' + ', '.join(f'"{o}"' for o in scenario_overrides(_RATE, seconds + 60.0)) + ']'
        graph.start('simulator', SIMULATOR, *parameters({'scenario': find_config('crane'), 'overrides': overrides}))
        rclpy.init(args=[], domain_id=int(environment['ROS_DOMAIN_ID']))
        try:
            times = _spun(rclpy.create_node('trace'), seconds, console)
        finally:
            rclpy.try_shutdown()
        for member in graph.tend():
            raise ConfigurationError(f'graph: {member.name} ended: {graph.last_words(member)}')
    return _figures(times, seconds)


def _spun(node: Node, seconds: float, console: Console) -> _Times:
    times = _traced(node)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    for _ in track(range(round((_WARM_UP + seconds) * 10)), description='latency', console=console, transient=True):
        end = time.monotonic() + 0.1
        while (left := end - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)
    executor.shutdown()
    node.destroy_node()
    return times


def _figures(times: _Times, seconds: float) -> list[Figure]:
    begin = time.time_ns() - round(seconds * 1e9)
    figures = []
    name = f'{_RATE:g} sweep pairs/s traced'
    for topic, _, before in _STEPS:
        rows = np.array([row for row in times[topic] if row[0] >= begin], dtype=np.int64)
        if not len(rows):
            raise ConfigurationError(f'graph: nothing on {topic} in the measured time')
        published = (rows[:, 1] - rows[:, 0]) * 1e-6
        for share in (50, 99):
            label = f'{name}: {before} has published, after the stamp, p{share}'
            figures.append(Figure(label, float(np.percentile(published, share)), 'ms'))
    received = (rows[:, 2] - rows[:, 1]) * 1e-6
    figures += [
        Figure(f'{name}: range received, after publishing, p{s}', float(np.percentile(received, s)), 'ms')
        for s in (50, 99)
    ]
    return figures
