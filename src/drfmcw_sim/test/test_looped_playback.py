"""A scenario that starts again when it ends: time goes on."""

import itertools
import time

import pytest
import rclpy
import yaml
from drfmcw_msgs.msg import IfSamples
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import stamp_ns
from drfmcw_sim.simulator import Simulator

LIMIT = 60.0  # on a busy machine [s]
SWEEPS = 20
SCENARIO = {
    'stations': {'master': {}, 'slave': {}},
    'pairs': [{'first': 'master', 'second': 'slave', 'standing': {'distances': [100.0], 'sweeps': SWEEPS}}],
    'timing': {'sweep_interval': 0.05},
}


@pytest.fixture(autouse=True)
def context():
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.mark.parametrize('start', ['now', 'scenario'])
def test_stamps_and_sweeps_go_on_where_the_scenario_starts_again(tmp_path, start):
    """At 20 times real time the first run ends ahead of the clock; the second must not jump back to it."""
    path = tmp_path / 'scenario.yaml'
    path.write_text(yaml.safe_dump(SCENARIO))
    values = {'scenario': str(path), 'rate': 20.0, 'at_end': 'loop', 'start': start, 'mode_control': 'range'}
    simulator = Simulator(parameter_overrides=[Parameter(name, value=value) for name, value in values.items()])
    listener = rclpy.create_node('listener')
    heard = []
    qos.subscription(listener, IfSamples, '/master/if_samples', heard.append, qos.RELIABLE)
    qos.subscription(listener, IfSamples, '/slave/if_samples', lambda _: None, qos.RELIABLE)
    executor = SingleThreadedExecutor()
    for node in (simulator, listener):
        executor.add_node(node)
    end = time.monotonic() + LIMIT
    try:
        while len(heard) < 3 * SWEEPS:
            assert time.monotonic() < end, f'{len(heard)} sweeps heard'
            executor.spin_once(timeout_sec=0.05)
    finally:
        listener.destroy_node()
        simulator.destroy_node()
    for before, after in itertools.pairwise(heard):
        assert stamp_ns(after.header.stamp) > stamp_ns(before.header.stamp)
        assert after.sweep_id > before.sweep_id
