"""Requests on their way from the graph to a digitiser, and what the digitiser grants on its way back."""

import math
import socket

import numpy as np
import pytest
import rclpy
from drfmcw_msgs.msg import SweepConfig, SweepSchedule
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from drfmcw_node.sources.feed import Frame, Request, TurnsRequest, decode_requests, encode
from drfmcw_node.station import StationNode
from drfmcw_physics.rules.schedule import Share
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import to_message

WAIT = 20.0  # for anything, on a busy machine [s]


@pytest.fixture(scope='module', autouse=True)
def context():
    rclpy.init()
    yield
    rclpy.try_shutdown()


class Peers(Node):
    """A station of two peers, whoever asks it for something, and its digitiser."""

    def __init__(self):
        super().__init__('peers')
        values = {'source': 'tcp', 'ip_port': 0, 'peer': 'slave_1,slave_2'}
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        self.station = StationNode(namespace='/master', parameter_overrides=overrides)
        self.settings, self.granted = [], []
        latched = qos.latched_subscription(4)
        qos.subscription(self, SweepConfig, '/master/sweep_config', self.settings.append, latched)
        qos.subscription(self, SweepSchedule, '/master/sweep_schedule', self.granted.append, latched)
        self.publishers_ = {
            (kind, peer): qos.publisher(self, kind, f'/master/{topic}', qos.LATCHED, instance=peer)
            for kind, topic in ((SweepConfig, 'sweep_request'), (SweepSchedule, 'schedule_request'))
            for peer in ('slave_1', 'slave_2')
        }
        self.executor_ = SingleThreadedExecutor()
        for node in (self, self.station):
            self.executor_.add_node(node)
        self._number = 0

    def until(self, condition):
        for _ in range(int(WAIT / 0.05)):
            if condition():
                return
            self.executor_.spin_once(timeout_sec=0.05)
        raise AssertionError('it did not happen in time')

    def newest(self, peer):
        """The newest settings for a peer."""
        return next((s for s in reversed(self.settings) if s.peer == peer), None)

    def shares(self):
        """What is granted: peer, rate and priority, in the order of publication."""
        return [(s.peer, s.rate, s.priority) for s in self.granted]

    def ask_mode(self, peer, start_delay, mode):
        message = to_message(SweepSettings('master', peer), SweepConfig)
        message.mode, message.start_delay = mode, start_delay
        self.publishers_[SweepConfig, peer].publish(message)

    def ask(self, peer, **turns):
        self.publishers_[SweepSchedule, peer].publish(to_message(Share('master', peer, **turns), SweepSchedule))

    def connect(self):
        digitiser = socket.create_connection(('127.0.0.1', self.station._owner.source.port), WAIT)
        digitiser.settimeout(0.02)
        return digitiser

    def send(self, digitiser, peer, **changes):
        """Send a sweep of a pair."""
        self._number += 1
        samples = np.random.default_rng(self._number).integers(-3000, 3000, 2048).astype(np.int16)
        digitiser.sendall(encode(Frame(self._number, 0, 8192.0, False, samples, peer, **changes)))

    def received(self, digitiser, count):
        """Return the next requests that reach the digitiser."""
        requests, rest = [], b''

        def read():
            nonlocal rest
            try:
                found, rest = decode_requests(rest + digitiser.recv(4096))
            except TimeoutError:
                return False
            requests.extend(found)
            return len(requests) >= count

        self.until(read)
        return requests


@pytest.fixture
def peers():
    made = Peers()
    yield made
    made.station.destroy_node()
    made.destroy_node()


def test_rates_go_to_the_digitiser_and_what_it_grants_is_published(peers):
    peers.until(lambda: peers.newest('slave_1') and peers.newest('slave_2'))
    peers.ask('slave_1', rate=25.0, priority=1)  # before there is a digitiser
    peers.until(lambda: peers.station._owner._passed)
    with peers.connect() as digitiser:
        peers.send(digitiser, 'slave_2')
        assert peers.received(digitiser, 1) == [TurnsRequest(25.0, 1, 'slave_1')]
        assert peers.shares() == []  # nobody states one
        peers.send(digitiser, 'slave_1', rate=20.0, priority=1)
        peers.until(lambda: peers.granted)
        peers.ask_mode('slave_1', 6e-7, 1)
        assert peers.received(digitiser, 1) == [Request(1, 6e-7, 'slave_1')]
        peers.send(digitiser, 'slave_1', rate=20.0, priority=1, mode=1, start_delay=6e-7)
        peers.until(lambda: peers.newest('slave_1').mode == 1)
        peers.ask_mode('slave_1', 6e-7, 1)  # nothing new
        peers.ask('slave_1', rate=25.0, priority=1)  # nothing new either
        peers.ask('slave_2', rate=5.0)
        peers.ask('slave_1')  # none any more
        found = peers.received(digitiser, 2)
        assert sorted(found, key=lambda r: r.peer) == [TurnsRequest(0.0, 0, 'slave_1'), TurnsRequest(5.0, 0, 'slave_2')]
        peers.send(digitiser, 'slave_1', mode=1, start_delay=6e-7)
        peers.until(lambda: len(peers.granted) > 1)
    assert peers.shares() == [('slave_1', 20.0, 1), ('slave_1', 0.0, 0)]


def test_a_request_of_a_rate_leaves_the_settings_as_they_are(peers):
    peers.until(lambda: peers.newest('slave_1') and peers.newest('slave_2'))
    with peers.connect() as digitiser:
        peers.ask('slave_1', rate=25.0)
        peers.send(digitiser, 'slave_1', rate=25.0)
        peers.until(lambda: peers.granted)
    assert len(peers.settings) == 2


def test_a_digitiser_without_rates_gets_modes(peers):
    """Of version 1 of the feed; what it is asked for beyond that is said in the log."""
    said = []
    peers.station.warn = said.append
    peers.until(lambda: peers.newest('slave_1'))
    with peers.connect() as digitiser:
        peers.send(digitiser, 'slave_1', version=1)
        peers.until(lambda: peers.station.processor.sweeps)
        peers.ask('slave_1', rate=25.0)
        peers.until(lambda: peers.station._owner._passed)
        peers.ask_mode('slave_1', 6e-7, 1)
        assert peers.received(digitiser, 1) == [Request(1, 6e-7, 'slave_1')]
        peers.send(digitiser, 'slave_1', version=1, mode=1, start_delay=6e-7)
        peers.until(lambda: peers.newest('slave_1').mode == 1)
    assert any('knows no rates' in line for line in said)
    assert peers.shares() == []


@pytest.mark.parametrize(
    ('wrong', 'reason'),
    [
        ({'rate': -1.0}, 'rate = -1 Hz is outside'),
        ({'rate': math.nan}, 'rate is NaN'),
        ({'priority': 2000}, 'priority = 2000'),
    ],
)
def test_wrong_requests_of_rates_are_refused(peers, wrong, reason):
    said = []
    peers.station.warn = said.append
    peers.until(lambda: peers.newest('slave_1'))
    peers.ask('slave_1', **wrong)
    peers.until(lambda: said)
    assert reason in said[0]
    assert not peers.station._owner._passed


@pytest.mark.parametrize('start_delay', [0.5, math.nan])
def test_wrong_requests_of_modes_are_refused(peers, start_delay):
    said = []
    peers.station.warn = said.append
    peers.until(lambda: peers.newest('slave_1'))
    peers.ask_mode('slave_1', start_delay, 1)
    peers.until(lambda: said)
    assert 'sweep_request' in said[0] and 'start_delay' in said[0]


def test_a_grant_that_cannot_be_is_not_published(peers):
    peers.until(lambda: peers.newest('slave_1'))
    with peers.connect() as digitiser:
        for wrong in ({'rate': math.nan}, {'rate': -5.0}, {'rate': math.inf}, {'rate': 5.0, 'priority': 1 << 30}):
            peers.send(digitiser, 'slave_1', **wrong)
        peers.send(digitiser, 'slave_1', rate=10.0)
        peers.until(lambda: peers.granted)
    assert peers.shares() == [('slave_1', 10.0, 0)]
