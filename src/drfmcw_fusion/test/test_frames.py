"""Where the crane stands: the geometry, and the node that publishes it."""

import time

import numpy as np
import pytest
import rclpy
from drfmcw_msgs.msg import RangeEstimate
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from drfmcw_fusion.crane.frames import FramesNode
from drfmcw_fusion.crane.geometry import SiteGeometry
from drfmcw_fusion.pipeline import Flag
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.graph import qos
from drfmcw_ros.nodes.runner import spinning

SITE = {'fixed_x': -2.0, 'fixed_y': 0.5, 'fixed_z': 12.5, 'crane_x': -1.5, 'crane_y': -0.5, 'crane_z': 8.0}


@pytest.mark.parametrize('forward', [True, False])
@pytest.mark.parametrize('at', [-300.0, -20.0, 15.0, 900.0])
def test_position_is_the_inverse_of_the_distance_in_space(forward, at):
    """To rounding, wherever the antennas are."""
    site = SiteGeometry(forward=forward, **SITE)
    antenna = np.array([at, 0.0, 0.0]) + site.crane_antenna
    if (antenna[0] > site.fixed_x) != forward:
        antenna[0] = 2.0 * site.fixed_x - antenna[0]
    distance = np.linalg.norm(antenna - site.fixed_antenna)
    position, _ = site.position(float(distance), 0.0)
    assert position == pytest.approx(antenna[0] - site.crane_x, abs=1e-9)


def test_standard_deviation_is_that_of_many_ranges():
    """Drawn with seed 5: the spread of 20000 positions agrees within 3 %, six of its own standard deviations."""
    site = SiteGeometry(**SITE)
    ranges = np.random.default_rng(5).normal(20.0, 0.002, 20_000)
    spread = np.std([site.position(float(r), 0.0)[0] for r in ranges])
    assert site.position(20.0, 0.002)[1] == pytest.approx(spread, rel=0.03)


@pytest.mark.parametrize('distance', [0.0, 4.0, -5.0, float('nan'), float('inf')])
def test_no_position_follows_from_an_impossible_range(distance):
    """The antennas are 4.6 m apart across the rail."""
    assert SiteGeometry(**SITE).position(distance, 0.001) is None


@pytest.mark.parametrize('wrong', [{'pair': 'master'}, {'pair': 'a/a'}, {'rail_frame': 'crane'}, {'rail_frame': ''}])
def test_wrong_geometry_is_refused(wrong):
    with pytest.raises(ConfigurationError):
        SiteGeometry(**wrong)


@pytest.mark.graph
def test_node_publishes_pose_joint_and_frame_of_valid_ranges_only():
    rclpy.init(args=[])
    given = SITE | {'interval': 0.0}
    frames = FramesNode(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
    other = Node('other')
    poses, joints, moved = [], [], []
    other.create_subscription(PoseWithCovarianceStamped, '/master/slave/pose', poses.append, qos.RELIABLE)
    other.create_subscription(JointState, '/joint_states', joints.append, qos.RELIABLE)
    other.create_subscription(TFMessage, '/tf', lambda m: moved.extend(m.transforms), qos.RELIABLE)
    sender = other.create_publisher(RangeEstimate, '/master/slave/range', qos.RELIABLE)
    try:
        with spinning(frames, other):
            end = time.monotonic() + 30.0
            counts = [made.get_subscription_count for made in (frames._pose, frames._joint, frames._tf)]
            while not (sender.get_subscription_count() and all(count() for count in counts)):
                assert time.monotonic() < end
                time.sleep(0.02)
            flagged = int(Flag.WEAK_SIGNAL)
            for second, distance, flags in ((1, 100.0, 0), (2, 101.0, flagged), (3, 3.0, 0), (4, 102.0, 0)):
                message = RangeEstimate(range=distance, range_std=0.002, flags=flags)
                message.header.stamp.sec = second
                sender.publish(message)
            while min(len(poses), len(joints), len(moved)) < 2:
                assert time.monotonic() < end
                time.sleep(0.02)
    finally:
        frames.destroy_node()
        other.destroy_node()
        rclpy.try_shutdown()
    site = SiteGeometry(**SITE)
    expected = [site.position(distance, 0.002) for distance in (100.0, 102.0)]
    assert [(p.header.stamp.sec, p.header.frame_id) for p in poses] == [(1, 'rail'), (4, 'rail')]
    assert [p.pose.pose.position.x for p in poses] == [x for x, _ in expected]
    assert [p.pose.covariance[0] for p in poses] == [s**2 for _, s in expected]
    assert [j.position[0] for j in joints] == [x for x, _ in expected]
    assert [t.transform.translation.x for t in moved] == [x for x, _ in expected]
