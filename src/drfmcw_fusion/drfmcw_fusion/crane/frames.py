"""Frames node: the range of a pair in, the crane's pose, joint state and frames out (REP 105)."""

import dataclasses
import sys
from collections.abc import Sequence
from typing import Any

from drfmcw_msgs.msg import RangeEstimate
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, Vector3
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from drfmcw_node.station_settings import antenna_frame
from drfmcw_physics.settings import parameter
from drfmcw_ros.commands.cli import Parser, guarded, split_ros_arguments
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import stamp_ns
from drfmcw_ros.nodes.diagnostics import WARN, Diagnostics, Status
from drfmcw_ros.nodes.parameters import SettingsParameters
from drfmcw_ros.nodes.runner import run

from ..pipeline import USELESS
from .geometry import SiteGeometry

JOINT = 'crane_position'
"""Name of the prismatic joint between rail and crane, in urdf/crane.urdf.xacro too."""

_TF = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""As tf2_ros publishes /tf."""


@dataclasses.dataclass(frozen=True)
class FramesSettings:
    """What the node publishes."""

    publish_tf: bool = parameter(
        True, structural=True, description='publish /tf and /tf_static; false where robot_state_publisher does'
    )
    interval: float = parameter(
        0.05, unit='s', bounds=(0.0, 60.0), description='shortest time between two poses; 0: one for each range'
    )


class FramesNode(Node):
    """Thin shell around `SiteGeometry`. Topics and parameters: README.md of this package."""

    def __init__(self, **kwargs: Any) -> None:
        """Create the node and publish what stands still; `kwargs` go to rclpy's Node.

        Raises:
            ConfigurationError: a value given at start is wrong.
        """
        super().__init__('frames', **kwargs)
        self._settings = SettingsParameters(self, FramesSettings)
        self._site = SettingsParameters(self, SiteGeometry).value
        pair = self._site.pair
        self._pose = qos.publisher(self, PoseWithCovarianceStamped, f'/{pair}/pose', qos.RELIABLE)
        self._joint = qos.publisher(self, JointState, '/joint_states', qos.RELIABLE)
        self._tf: Any = None
        if self._settings.value.publish_tf:
            self._tf = qos.publisher(self, TFMessage, '/tf', _TF)
            self._static = qos.publisher(self, TFMessage, '/tf_static', qos.LATCHED)
            self._static.publish(TFMessage(transforms=self._antennas()))
        self._last = 0  # stamp of the newest pose [ns]
        self._new = self._refused = 0  # ranges since the last diagnostics
        qos.subscription(self, RangeEstimate, f'/{pair}/range', self._take, qos.RELIABLE)
        Diagnostics(self, pair).add('Pose', self._diagnose)

    def _antennas(self) -> list[TransformStamped]:
        """Return the frames that stand still: each antenna in the frame of what carries it."""
        site, now = self._site, self.get_clock().now().to_msg()
        fixed, moving = site.pair.split('/')
        carried = ((site.rail_frame, fixed, site.fixed_antenna), (site.crane_frame, moving, site.crane_antenna))
        return [_transform(now, parent, antenna_frame(name), *place) for parent, name, place in carried]

    def _take(self, message: RangeEstimate) -> None:
        stamp = stamp_ns(message.header.stamp)
        if 0 <= stamp - self._last < self._settings.value.interval * 1e9:
            return
        found = None if message.flags & USELESS else self._site.position(message.range, message.range_std)
        if found is None:
            self._refused += 1
            return
        self._last = stamp
        self._new += 1
        position, std = found
        at = message.header.stamp
        pose = PoseWithCovarianceStamped()
        pose.header.stamp, pose.header.frame_id = at, self._site.rail_frame
        pose.pose.pose.position.x = position
        pose.pose.pose.orientation.w = 1.0
        pose.pose.covariance[0] = std**2
        self._pose.publish(pose)
        joint = JointState(name=[JOINT], position=[position], velocity=[])
        joint.header.stamp = at
        self._joint.publish(joint)
        if self._tf is not None:
            moved = _transform(at, self._site.rail_frame, self._site.crane_frame, position, 0.0, 0.0)
            self._tf.publish(TFMessage(transforms=[moved]))

    def _diagnose(self, status: Status) -> None:
        if self._refused:
            status.report(WARN, f'{self._refused} ranges from which no position follows')
        elif not self._new:
            status.report(WARN, 'no range')
        status.value('poses per second', self._new)
        self._new = self._refused = 0


def _transform(stamp: Any, parent: str, child: str, x: float, y: float, z: float) -> TransformStamped:
    made = TransformStamped(child_frame_id=child)
    made.header.stamp, made.header.frame_id = stamp, parent
    made.transform.translation = Vector3(x=x, y=y, z=z)
    made.transform.rotation.w = 1.0
    return made


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; return the exit status."""
    own, ros = split_ros_arguments(argv)
    parser = Parser(
        prog='drfmcw frames',
        description=__doc__,
        epilog='All parameters: src/drfmcw_fusion/README.md, such as --ros-args -p fixed_z:=12.5 -p crane_z:=10.0',
    )
    parser.parse_args(own)
    return guarded(parser.prog, lambda: run(FramesNode, ros))


if __name__ == '__main__':
    sys.exit(main())
