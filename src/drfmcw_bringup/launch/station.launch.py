"""One station: its source, port, peer and estimator as arguments or from a parameter file.

ros2 launch drfmcw_bringup station.launch.py station:=master source:=tcp ip_port:=9000 peer:=slave estimator:=ml
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from drfmcw_bringup import launching
from launch import LaunchDescription

STATION = 'name of the station, and its namespace'
PARAMETERS = 'YAML file with parameters of the node, or name in config/hardware; the arguments take precedence'


def generate_launch_description():
    """Declare the arguments; an empty one leaves the parameter file's value, or the default."""
    optional = launching.station_arguments()
    return LaunchDescription(
        [
            DeclareLaunchArgument('station', description=STATION),
            DeclareLaunchArgument('parameters', default_value='', description=PARAMETERS),
            *(DeclareLaunchArgument(name, default_value='', **about) for name, about in optional.items()),
            OpaqueFunction(function=node),
        ]
    )


def node(context):
    """Return the station's node."""
    given = {name: LaunchConfiguration(name).perform(context) for name in launching.station_arguments()}
    station = LaunchConfiguration('station').perform(context)
    files = launching.parameter_files(LaunchConfiguration('parameters').perform(context))
    return [
        Node(
            package='drfmcw_node',
            executable='station',
            namespace=station,
            parameters=[*files, {'station': station} | launching.station_parameters(given)],
            **launching.restarted(),
        )
    ]
