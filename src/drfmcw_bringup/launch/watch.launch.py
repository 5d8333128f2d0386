"""Live diagnosis of one pair of stations, beside a running graph.

ros2 launch drfmcw_bringup watch.launch.py pair:=master/slave findings:=findings
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from drfmcw_bringup import launching
from launch import LaunchDescription


def generate_launch_description():
    """Declare the arguments and the node, in the pair's namespace: there may be one for each pair."""
    names = {
        'pair': ('master/slave', 'pair of stations to watch'),
        'findings': ('', 'directory in which each finding is kept'),
    }
    arguments = [DeclareLaunchArgument(n, default_value=d, description=text) for n, (d, text) in names.items()]
    node = Node(
        package='drfmcw_diagnosis',
        executable='watch',
        namespace=LaunchConfiguration('pair'),
        parameters=[{name: ParameterValue(LaunchConfiguration(name), value_type=str) for name in names}],
        **launching.restarted(),
    )
    return LaunchDescription([*arguments, node])
