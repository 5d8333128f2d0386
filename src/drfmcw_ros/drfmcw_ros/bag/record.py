"""`record`: write the running graph's topics into a rosbag2 recording."""

import argparse
import collections
import dataclasses
import fnmatch
import functools
import math
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.node import Node

from drfmcw_physics.settings import ConfigurationError

from ..commands.cli import Parser, guarded, split_ros_arguments
from ..graph import qos
from ..graph.messages import message_class
from ..graph.topics import is_for_displays, is_latched, is_measured
from ..nodes.diagnostics import ERROR, WARN, Diagnostics, Status
from ..nodes.runner import Finished, run
from .background import BackgroundWriter, State
from .files import STORAGES, BagWriter, UnwritableError, typestore

_LOOK_PERIOD = 0.2  # how often new topics are looked for [s]


@dataclasses.dataclass(frozen=True)
class RecorderSettings:
    """What is recorded and for how long."""

    patterns: tuple[str, ...] = ('*',)  # of topic names, as in a shell
    measured_only: bool = False
    duration: float = math.inf  # [s]
    storage: str = 'mcap'
    overwrite: bool = False
    resume: bool = False


class RecorderNode(Node):
    """Subscribes to every topic of the graph that is wanted, as it appears, and writes what arrives unread."""

    def __init__(self, path: str, settings: RecorderSettings, **kwargs: Any) -> None:
        """Open the recording.

        Raises:
            BagError: the recording exists already, or cannot be written.
        """
        super().__init__('recorder', **kwargs)
        self._settings = settings
        self.path = path
        writer = BagWriter(path, settings.storage, settings.overwrite, from_the_start=True, resume=settings.resume)
        self._writer = BackgroundWriter(writer)
        self._completed = False
        self._trouble = ''  # as last logged
        self._lost_reported = 0
        self._counts: collections.Counter[str] = collections.Counter()
        self._known: set[str] = set()
        self._ignored: set[str] = set()
        self._end = math.inf
        self._diagnostics = Diagnostics(self, 'recorder')
        self._diagnostics.add('Recording', self._diagnose)
        self._look()
        self._end = time.monotonic() + settings.duration  # from when it records: its end completes the recording
        self._timer = self.create_timer(_LOOK_PERIOD, self._look)

    @property
    def counts(self) -> Mapping[str, int]:
        """Messages that have arrived so far, by topic."""
        return self._counts

    def _look(self) -> None:
        if time.monotonic() >= self._end:
            raise Finished
        for topic, kinds in self.get_topic_names_and_types():
            if topic in self._known or topic in self._ignored:
                continue
            kind = kinds[0]
            if not self._wanted(topic) or kind not in typestore().fielddefs:
                self._ignored.add(topic)
                continue
            publishers = self.get_publishers_info_by_topic(topic)
            if not publishers:
                continue  # a subscriber alone: wait for someone who publishes
            self._known.add(topic)
            self._writer.add_topic(topic, kind)
            write = functools.partial(self._write, topic, kind)
            profile = qos.suiting(publishers, is_latched(topic))
            qos.subscription(self, message_class(kind), topic, write, profile, batch=True, raw=True)
            self.get_logger().info(f'recording {topic}')

    def _wanted(self, topic: str) -> bool:
        if is_for_displays(topic) or (self._settings.measured_only and not is_measured(topic)):
            return False
        return any(fnmatch.fnmatchcase(topic, pattern) for pattern in self._settings.patterns)

    def _write(self, topic: str, kind: str, messages: list[bytes]) -> None:
        now = time.time_ns()
        for raw in messages:
            self._writer.put(topic, kind, now, raw)
        self._counts[topic] += len(messages)

    def _diagnose(self, status: Status) -> None:
        state = self._writer.state()
        if not self._known:
            status.report(WARN, 'nobody publishes what is to be recorded')
        if state.trouble:
            status.report(ERROR, f'cannot write: {state.trouble}')
        elif state.slow:
            status.report(WARN, f'the disk is slow: nothing written for {state.delay:.1f} s')
        if state.lost > self._lost_reported:
            status.report(ERROR, f'{state.lost - self._lost_reported} messages lost: memory is full')
        self._log(state)
        self._lost_reported = state.lost
        status.value('recording', self.path)
        status.value('messages written', state.written)
        status.value('messages lost', state.lost)
        status.value('bytes waiting', state.waiting)
        for topic in sorted(self._known):
            status.value(topic, self._counts[topic])

    def _log(self, state: State) -> None:
        """Log when writing becomes impossible or possible, and while messages are lost."""
        log = self.get_logger()
        if state.trouble and not self._trouble:
            log.error(f'cannot write: {state.trouble}; what is written stays, the rest waits in memory')
        if self._trouble and not state.trouble:
            log.info(f'writing again; {state.lost} messages lost so far')
        if state.lost > self._lost_reported:
            log.error(f'{state.lost} messages lost so far: memory is full', throttle_duration_sec=10.0)
        self._trouble = state.trouble

    def destroy_node(self) -> None:
        """Complete the recording, whatever ended the process."""
        if not self._completed:
            self._completed = True
            try:
                lost = self._writer.close()
            except UnwritableError as error:
                print(f'drfmcw record: {error}; what was written before can be read, and repaired', file=sys.stderr)
            else:
                count = sum(self._counts.values()) - lost
                said = f'{self.path}: {count} messages on {len(self._known)} topics'
                print(said + (f', {lost} lost' if lost else ''), flush=True)
        super().destroy_node()


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog='drfmcw record', description=__doc__)
    parser.add_argument('recording', help='directory to create')
    parser.add_argument(
        '--topic', action='append', metavar='PATTERN', help="topics to record ('/master/*'), repeatable"
    )
    parser.add_argument(
        '--measured', action='store_true', help='only measured topics; the rest can be computed from them'
    )
    parser.add_argument('--duration', type=float, default=math.inf, metavar='S', help='stop after S seconds')
    parser.add_argument('--storage', choices=sorted(STORAGES), default='mcap', help='storage format (default mcap)')
    parser.add_argument('--resume', action='store_true', help='go on with a recording whose recorder died')
    parser.add_argument('--force', action='store_true', help='replace a recording of that name')
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the recorder; return the exit status."""
    own, ros = split_ros_arguments(argv)
    arguments = _parser().parse_args(own)
    settings = RecorderSettings(
        tuple(arguments.topic or ['*']),
        arguments.measured,
        arguments.duration,
        arguments.storage,
        arguments.force,
        arguments.resume,
    )

    def work() -> int:
        if not arguments.duration > 0.0:
            raise ConfigurationError(f'--duration = {arguments.duration:g} s must be above zero')
        return run(RecorderNode, ros, path=arguments.recording, settings=settings)

    return guarded('drfmcw record', work)


if __name__ == '__main__':
    sys.exit(main())
