"""Processes that die, that are set up wrongly, and nodes that publish what is not theirs."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rclpy
from checkout import ROOT
from diagnostic_msgs.msg import DiagnosticArray
from drfmcw_msgs.msg import BeatFrequency
from rclpy.executors import SingleThreadedExecutor
from test_graph import STANDING, scenario_file, site

from drfmcw_bringup import graph as graphs
from drfmcw_bringup.graph import STATION, Graph, Member
from drfmcw_bringup.run import start_graph
from drfmcw_ros.bag.files import BagReader
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.publishers import Publishers
from drfmcw_ros.work import children
from drfmcw_sim.scenario import read_scenario

pytestmark = [pytest.mark.graph, pytest.mark.timeout(180)]

STOP_LIMIT = 60.0  # on a busy machine; what ends by force only takes twenty seconds [s]


class Ended:
    """Stands for a process's handle: has ended with a status."""

    def __init__(self, status):
        self.returncode = status

    def poll(self):
        return self.returncode


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test sets, in place of the one that delays are counted with."""
    now = [1000.0]
    monkeypatch.setattr(graphs.time, 'monotonic', lambda: now[0])
    return now


def test_restart_delay_grows_and_a_long_run_resets_it(clock, monkeypatch):
    """0.5 s, 1 s, 2 s ... 30 s while a process dies at once; 0.5 s again after one that ran for some time."""
    graph = Graph({})
    monkeypatch.setattr(graph, '_spawn', lambda command, log: Ended(1))
    member = graph.members['station'] = Member('station', [], Ended(1), None, keep_alive=True, started=clock[0])
    delays = []
    for _ in range(9):
        assert graph.tend() == []
        began, restarts = clock[0], member.restarts
        while member.restarts == restarts:
            clock[0] += 0.25
            assert graph.tend() == []
        delays.append(clock[0] - began)
    assert delays == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0, 30.0]
    clock[0] += 100.0
    graph.tend()
    assert member.delay == 0.5


def test_wrong_configuration_is_final_but_a_recorder_that_once_ran_is_tried_again(clock):
    graph = Graph({})
    for name, options, restarts, final in (
        ('station', {'keep_alive': True}, 0, True),
        ('later', {'keep_alive': True}, 3, True),
        ('recorder', {'keep_alive': True, 'optional': True}, 0, True),
        ('full', {'keep_alive': True, 'optional': True}, 1, False),
    ):
        graph.members = {name: Member(name, [], Ended(2), None, restarts=restarts, started=clock[0], **options)}
        assert bool(graph.tend()) == final, name


def test_wrong_station_setting_ends_run_with_its_status(tmp_path):
    """A real station that refuses its settings ends for good, with one line."""
    with Graph(log_directory=tmp_path) as graph:
        wrong = ('--station', 'master', '--ros-args', '-p', 'estimator:=paper', '-p', 'window:=7')
        member = graph.start('station', STATION, *wrong, keep_alive=True)
        end = time.monotonic() + 30.0
        while not (ended := graph.tend()) and time.monotonic() < end:
            time.sleep(0.1)
        assert [(m.name, m.process.returncode, m.restarts) for m in ended] == [('station', 2, 0)]
        assert 'window' in graph.last_words(member)


def recorded_ranges(path):
    """Number of ranges in a recording."""
    with BagReader(path) as bag:
        return sum(t == '/master/slave/range' for t, _, _ in bag.stored_messages({'/master/slave/range'}))


def test_recorder_that_is_killed_does_not_end_the_graph(tmp_path):
    """Ranges go on, and so does the recording, in a further file."""
    path = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.02})
    with site(tmp_path) as s:
        start_graph(
            s.graph, path, read_scenario(path), {'rate': 1.0}, s.monitor, tmp_path / 'run', keep_alive=True
        )  # fmt: skip
        s.wait((tmp_path / 'run' / 'run_0.mcap').exists, 'the recording')
        s.wait(lambda: recorded_ranges(tmp_path / 'run' / 'run_0.mcap') > 20, 'recorded ranges')
        recorder = s.graph.members['recorder']
        recorder.process.send_signal(signal.SIGKILL)
        before = s.monitor.total

        def again():
            assert s.graph.tend() == []
            return recorder.restarts == 1 and (tmp_path / 'run' / 'run_1.mcap').exists()

        s.wait(again, 'the recorder')
        s.wait(lambda: s.monitor.total > before + 100, 'further ranges')
        s.wait(lambda: recorded_ranges(tmp_path / 'run' / 'run_1.mcap') > 20, 'further recorded ranges')
        s.graph.stop()
    with BagReader(tmp_path / 'run') as bag:
        assert len(bag.unfinished) == 1
    assert recorded_ranges(tmp_path / 'run') > recorded_ranges(tmp_path / 'run' / 'run_1.mcap') > 20


def test_fusion_that_is_killed_comes_back(tmp_path):
    """It makes the ranges: they stop, the keeper starts it again, they are true. P(false failure) < 1e-6 (6 sigma)."""
    path = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.02})
    with site(tmp_path) as s:
        start_graph(s.graph, path, read_scenario(path), {'rate': 1.0}, s.monitor, keep_alive=True)
        s.wait(lambda: s.monitor.total > 50, 'ranges')
        fusion = s.graph.members['fusion']
        fusion.process.send_signal(signal.SIGKILL)
        s.wait_for_end('fusion')
        s.wait(lambda: s.monitor.rate() == 0.0, 'the ranges to stop')
        s.wait(lambda: s.graph.tend() == [] and fusion.restarts == 1, 'the keeper to start it again')
        count = s.monitor.total
        s.wait(lambda: s.monitor.total >= count + 100, 'ranges of the new process')
        assert [m.restarts for m in s.graph.members.values()] == [m is fusion for m in s.graph.members.values()]
        ranges = [a.message for a in s.monitor.arrivals[count:]]
        assert all(abs(r.range - 100.0) < 6.0 * r.range_std for r in ranges if r.flags == 0)
        assert sum(r.flags == 0 for r in ranges) > 50


# --- two publishers on one topic ---


def numbers(*added):
    """Publishers that have taken these numbers."""
    publishers = Publishers('/x')
    for number in added:
        publishers.add(number)
    return publishers


def test_one_publisher_with_losses_is_trusted():
    assert numbers(*range(1, 50), *range(60, 200), 1000).doubt == ''


def test_restarted_publisher_is_trusted_after_a_trial():
    """Its first 20 messages wait: a dead predecessor says nothing more."""
    assert 'another node' in numbers(*range(1, 500), 1).doubt
    assert 'another node' in numbers(*range(1, 500), *range(1, 19)).doubt
    assert numbers(*range(1, 500), *range(1, 25)).doubt == ''


@pytest.mark.parametrize('ratio', [1, 2, 7, 15])
@pytest.mark.parametrize('start', [1, 400, 500, 501])
def test_two_living_publishers_are_noticed_at_once(ratio, start):
    """The second one from its first message on in doubt, and both as soon as the first one speaks again."""
    publishers = numbers(*range(1, 500))
    first, second = iter(range(500, 2000)), iter(range(start, 2000))
    for _ in range(5):
        publishers.add(next(second))
        for _ in range(ratio):
            publishers.add(next(first))
    assert publishers.several
    assert publishers.doubt == 'two nodes publish on /x'


def test_spoofed_beats_are_refused_with_the_reason(tmp_path):
    """Another node sends the master's beats, 100 m farther: no range of it comes out, and diagnostics say why."""
    path = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.02})
    with site(tmp_path) as s:
        s.start(path, {'rate': 1.0})
        s.wait(lambda: s.monitor.total > 100, 'ranges')
        genuine = s.monitor.newest['master/slave'].range
        spoof = s.monitor.create_publisher(BeatFrequency, '/master/beat_frequency', qos.RELIABLE)
        s.wait(lambda: spoof.get_subscription_count() > 0, 'the match of the spoofed beats')

        def forge(message):
            if forge.sent < 400:
                message.frequency += 1000.0
                forge.sent += 1
                forge.own.add((message.sweep_id, message.frequency))
                spoof.publish(message)

        forge.sent, forge.own = 0, set()

        def hear(message):
            if (message.sweep_id, message.frequency) not in forge.own:
                forge(message)

        s.monitor.create_subscription(BeatFrequency, '/master/beat_frequency', hear, qos.RELIABLE)
        s.wait(
            lambda: any(
                'two nodes publish on /master/beat_frequency' in d.message
                for (_, name), d in list(s.diagnostics.items())
                if name == '/fusion: Inputs'
            ),
            'the refusal',
        )
        s.wait(lambda: forge.sent >= 100, 'further spoofed beats')
        ranges = [a.message.range for a in s.monitor.arrivals if a.message.flags == 0]
        assert all(abs(r - genuine) < 0.1 for r in ranges)


# --- run ---


def test_run_has_a_domain_of_its_own(tmp_path):
    """It says how to join; nobody in the environment's domain hears it."""
    path = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.02})
    command = [sys.executable, '-m', 'drfmcw_bringup.run', str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ, cwd=ROOT) as process:
        try:
            line = process.stdout.readline()
            domain = int(re.search(r'export ROS_DOMAIN_ID=(\d+) ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST', line)[1])
            assert domain != int(os.environ.get('ROS_DOMAIN_ID') or 0)
            assert _hears_ranges(domain)
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(30.0) in (0, 130)


@pytest.mark.timeout(900)
def test_interrupt_at_any_moment_ends_run_and_all_its_processes(tmp_path):
    """Whatever is being imported, started or stopped meanwhile: soon, in silence, and nobody stays behind."""
    moments = np.random.default_rng(14).uniform(0.0, 6.0, 6)  # [s]
    path = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.02})
    for number, moment in enumerate(moments):
        mark = f'{tmp_path}/{number}'
        command = children.command('drfmcw_bringup.run', str(path), '--fast', '--record', mark)
        with open(tmp_path / 'said', 'w+', encoding='utf-8') as said:
            process = subprocess.Popen(
                command, stdout=said, stderr=said, env=os.environ | {'MARK': mark}, preexec_fn=children.prepare
            )
            time.sleep(moment)
            process.send_signal(signal.SIGINT)
            status = process.wait(STOP_LIMIT)
            said.seek(0)
            words = said.read()
        assert status in (130, -signal.SIGINT), f'{moment} s: {status}: {words}'
        assert 'Traceback' not in words and 'ignored' not in words, f'{moment} s: {words}'
        end = time.monotonic() + STOP_LIMIT
        while (left := _marked(mark)) and time.monotonic() < end:  # who was just being forked
            time.sleep(0.1)
        assert not left, f'{moment} s: {left}'


def _marked(mark):
    """The processes whose environment holds a mark."""
    found = []
    for environment in Path('/proc').glob('[0-9]*/environ'):
        with contextlib.suppress(OSError):  # has just ended
            if f'MARK={mark}\0'.encode() in environment.read_bytes():
                found.append(environment.parent.joinpath('cmdline').read_bytes())
    return found


def test_who_missed_an_interrupt_gets_another():
    """A process that ends at the second one ends by itself, long before force."""
    twice = 'import signal, sys\nsignal.signal(signal.SIGINT, lambda *_: signal.signal(signal.SIGINT, end))\n'
    twice += 'def end(*_): sys.exit(7)\nprint(flush=True)\nwhile True: signal.pause()'
    with subprocess.Popen([sys.executable, '-c', twice], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        with Graph() as graph:
            graph.members['deaf'] = Member('deaf', [], process, None, False)
        assert process.returncode == 7


def _hears_ranges(domain):
    """Whether diagnostics of a fusion arrive in a domain."""
    rclpy.init(args=[], domain_id=domain, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node('listener')
        heard = []
        node.create_subscription(DiagnosticArray, '/diagnostics', lambda m: heard.extend(m.status), qos.RELIABLE)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        end = time.monotonic() + 40.0
        while time.monotonic() < end and not any(s.name.startswith('/fusion: ') for s in heard):
            executor.spin_once(0.1)
        node.destroy_node()
        return any(s.name.startswith('/fusion: ') for s in heard)
    finally:
        rclpy.utilities.try_shutdown()
