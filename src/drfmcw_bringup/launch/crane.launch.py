"""A whole simulated site: simulator, one process per station, fusion.

ros2 launch drfmcw_bringup crane.launch.py scenario:=tdma
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from drfmcw_ros.config_files import find_config
from drfmcw_sim.scenario import read_scenario
from launch import LaunchDescription


def generate_launch_description():
    """Declare the arguments; the nodes follow from the scenario."""
    return LaunchDescription(
        [
            DeclareLaunchArgument('scenario', default_value='crane', description='YAML file, or name in config'),
            DeclareLaunchArgument('rate', default_value='1.0', description='scenario seconds per second'),
            DeclareLaunchArgument('simulate', default_value='true', description='false: with real stations'),
            OpaqueFunction(function=nodes),
        ]
    )


def nodes(context):
    """Return the nodes of the scenario's stations and pairs."""
    path = find_config(LaunchConfiguration('scenario').perform(context))
    scenario = read_scenario(path)
    pairs = [f'{pair.first}/{pair.second}' for pair in scenario.pairs]
    started = [Node(package='drfmcw_fusion', executable='fusion', parameters=[{'pairs': pairs}], output='screen')]
    for station in scenario.stations:
        started.append(
            Node(
                package='drfmcw_node',
                executable='station',
                namespace=station,
                parameters=[{'station': station}],
                respawn=True,
                output='screen',
            )
        )
    if LaunchConfiguration('simulate').perform(context).lower() in ('true', '1'):
        rate = float(LaunchConfiguration('rate').perform(context))
        started.append(
            Node(
                package='drfmcw_sim',
                executable='simulator',
                parameters=[{'scenario': str(path), 'rate': rate}],
                on_exit=Shutdown(reason='the scenario has ended'),
                output='screen',
            )
        )
    return started
