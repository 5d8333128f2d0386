"""The recorder as a process on a live graph: killed at any moment, on a full disk, it keeps what it has written."""

import contextlib
import random
import resource
import signal
import subprocess
import sys
import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Temperature
from std_msgs.msg import UInt8MultiArray

from drfmcw_bringup.graph import private_environment
from drfmcw_ros.bag.files import BagReader
from drfmcw_ros.graph.messages import to_time
from drfmcw_ros.nodes.runner import spinning

pytestmark = pytest.mark.timeout(120)
FAST, SLOW = '/fast', '/slow'
_MATCH_LIMIT = 20.0  # of discovery, on a busy machine [s]


class Talker:
    """Publishes sizeable messages at 200 Hz and small ones at 1 Hz, and keeps the diagnostics that it hears."""

    def __init__(self, environment):
        rclpy.init(
            args=[],
            domain_id=int(environment['ROS_DOMAIN_ID']),
            signal_handler_options=rclpy.signals.SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node('talker')
        self._fast = self.node.create_publisher(UInt8MultiArray, FAST, QoSProfile(depth=1000))
        self._slow = self.node.create_publisher(Temperature, SLOW, QoSProfile(depth=1000))
        self.sent = {FAST: [], SLOW: []}  # times [ns]
        self.diagnostics = []
        self.node.create_subscription(
            DiagnosticArray, '/diagnostics', lambda m: self.diagnostics.extend(m.status), QoSProfile(depth=10)
        )
        self.node.create_timer(0.005, self._publish_fast)
        self.node.create_timer(1.0, self._publish_slow)
        self._running = contextlib.ExitStack()
        self._running.enter_context(spinning(self.node))

    def _publish_fast(self):
        if self._fast.get_subscription_count():
            now = time.time_ns()
            self._fast.publish(UInt8MultiArray(data=now.to_bytes(8, 'little') + bytes(4000)))
            self.sent[FAST].append(now)

    def _publish_slow(self):
        if self._slow.get_subscription_count():
            now = time.time_ns()
            message = Temperature()
            message.header.stamp = to_time(now)
            self._slow.publish(message)
            self.sent[SLOW].append(now)

    def heard(self, text):
        """Whether the recorder's diagnostics have said something."""
        return any(text in status.message for status in list(self.diagnostics) if 'recorder' in status.name)

    def newest(self):
        """What the recorder's diagnostics say now."""
        return next(s.message for s in reversed(list(self.diagnostics)) if 'recorder: Recording' in s.name)

    def close(self):
        self._running.close()
        self.node.destroy_node()
        rclpy.utilities.try_shutdown()


@pytest.fixture
def environment():
    """A ROS domain of its own."""
    return private_environment()


@pytest.fixture
def talker(environment):
    """What the recorder records."""
    talking = Talker(environment)
    yield talking
    talking.close()


@contextlib.contextmanager
def recorder(environment, path, *options, **how):
    """A recorder's process, which is killed at the end if it still runs."""
    command = [sys.executable, '-m', 'drfmcw_ros.bag.record', str(path), *options]
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True, **how) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()


def wait_until(condition, limit=_MATCH_LIMIT):
    """Wait for something; fail where it does not come."""
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def recorded_times(path):
    """{topic: times of publishing [ns]} of a recording."""
    found = {FAST: [], SLOW: []}
    with BagReader(path) as bag:
        for topic, _, m in bag.messages({FAST, SLOW} & bag.topics.keys()):
            stamp = int.from_bytes(bytes(m.data[:8]), 'little') if topic == FAST else 0
            found[topic].append(stamp or m.header.stamp.sec * 10**9 + m.header.stamp.nanosec)
    return found


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_killed_at_any_moment_it_loses_at_most_a_second(environment, talker, tmp_path, storage):
    """SIGKILL at four seeded moments: every message older than 1 s at that moment is in the recording, in order."""
    rng = random.Random(11)
    paths = [tmp_path / f'run{attempt}' for attempt in range(4)]
    with contextlib.ExitStack() as stack:
        options = ('--topic', FAST, '--topic', SLOW, '--storage', storage)
        processes = [stack.enter_context(recorder(environment, path, *options)) for path in paths]
        wait_until(lambda: all((path / 'metadata.yaml').exists() for path in paths))
        wait_until(lambda: talker.node.count_subscribers(SLOW) == 4 == talker.node.count_subscribers(FAST))
        for path, process in zip(paths, processes, strict=True):
            time.sleep(rng.uniform(1.2, 3.0))
            killed = time.time_ns()
            process.send_signal(signal.SIGKILL)
            process.wait()
            recorded = recorded_times(path)
            for topic, times in recorded.items():
                due = [t for t in talker.sent[topic] if t < killed - 1_000_000_000]
                first = due.index(times[0])  # those before were sent while the subscription was being matched
                assert times[: len(due) - first] == due[first:], topic
            assert len(recorded[FAST]) > 20
            suffix = {'mcap': 'mcap', 'sqlite3': 'db3'}[storage]
            assert (path / f'{path.name}_0.{suffix}').exists()


def test_recorder_that_died_goes_on_in_a_further_file(environment, talker, tmp_path):
    """With --resume: one recording of both files, as rosbag2 splits them; a complete one is not added to."""
    path = tmp_path / 'run'
    for end in (signal.SIGKILL, signal.SIGINT):
        before = len(recorded_times(path)[FAST]) if path.exists() else 0
        with recorder(environment, path, '--topic', FAST, '--resume') as process:
            wait_until(lambda before=before: path.exists() and len(recorded_times(path)[FAST]) > before + 100)
            process.send_signal(end)
            process.wait(20.0)
    assert sorted(p.name for p in path.iterdir()) == ['metadata.yaml', 'run_0.mcap', 'run_1.mcap']
    with BagReader(path) as bag:
        assert len(bag.unfinished) == 1
        times = recorded_times(path)[FAST]
        assert bag.message_count == len(times)
    assert times == sorted(times)
    with recorder(environment, path, '--resume') as process:
        assert process.wait(20.0) == 2
        assert 'is complete' in process.stderr.read()


def test_full_disk_is_reported_and_survived(environment, talker, tmp_path):
    """A limit on the file's size stands for the full disk: diagnostics and log say so, and then it goes on."""
    path = tmp_path / 'run'
    limit = 1_500_000
    stop = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))  # noqa: E731
    with recorder(environment, path, '--topic', FAST, preexec_fn=stop) as process:
        wait_until(lambda: talker.heard('cannot write'), 40.0)
        full = path.stat(), (path / 'run_0.mcap').stat().st_size
        assert full[1] <= limit
        before = recorded_times(path)[FAST]
        assert len(before) > 100
        assert process.poll() is None
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        wait_until(lambda: (path / 'run_0.mcap').stat().st_size > limit)
        wait_until(lambda: 'cannot write' not in talker.newest())
        process.send_signal(signal.SIGINT)
        assert process.wait(20.0) == 0
        said = process.stderr.read()
    assert 'cannot write' in said
    assert 'writing again; 0 messages lost' in said
    after = recorded_times(path)[FAST]
    assert after[: len(before)] == before
    first = talker.sent[FAST].index(after[0])
    assert talker.sent[FAST][first : first + len(after)] == after, 'nothing between is missing: it waited in memory'


def test_ended_on_a_full_disk_it_leaves_what_was_written(environment, talker, tmp_path):
    """Stopped while nothing can be written: one line, and a recording that can be read."""
    path = tmp_path / 'run'
    stop = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1_500_000, 1_500_000))  # noqa: E731
    with recorder(environment, path, '--topic', FAST, preexec_fn=stop) as process:
        wait_until(lambda: talker.heard('cannot write'), 40.0)
        process.send_signal(signal.SIGINT)
        process.wait(20.0)
        said = process.stderr.read()
    assert 'what was written before can be read' in said
    assert 'Traceback' not in said
    assert len(recorded_times(path)[FAST]) > 100
    assert sorted(p.name for p in path.iterdir()) == ['metadata.yaml', 'run_0.mcap']
