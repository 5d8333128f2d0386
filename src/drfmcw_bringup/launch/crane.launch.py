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
            DeclareLaunchArgument('parameters', default_value='', description='YAML file with parameters of all nodes'),
            DeclareLaunchArgument('rate', default_value='1.0', description='scenario seconds per second'),
            DeclareLaunchArgument(
                'simulate', default_value='true', choices=['true', 'false'], description='false: with real stations'
            ),
            DeclareLaunchArgument(
                'host', default_value='false', choices=['true', 'false'], description="true: serve the host's page"
            ),
            OpaqueFunction(function=nodes),
        ]
    )


def nodes(context):
    """Return the nodes of the scenario's stations and pairs."""
    path = find_config(LaunchConfiguration('scenario').perform(context))
    scenario = read_scenario(path)
    pairs = [f'{pair.first}/{pair.second}' for pair in scenario.pairs]
    file = LaunchConfiguration('parameters').perform(context)
    extra = [file] if file else []
    restarted = {'respawn': True, 'respawn_delay': 2.0, 'on_exit': end_if_misconfigured, 'output': 'screen'}
    started = [Node(package='drfmcw_fusion', executable='fusion', parameters=[{'pairs': pairs}, *extra], **restarted)]
    for station in scenario.stations:
        started.append(
            Node(
                package='drfmcw_node',
                executable='station',
                namespace=station,
                parameters=[{'station': station}, *extra],
                **restarted,
            )
        )
    if LaunchConfiguration('host').perform(context) == 'true':
        started.append(Node(package='drfmcw_host', executable='host', **restarted))
    if LaunchConfiguration('simulate').perform(context) == 'true':
        started.append(
            Node(
                package='drfmcw_sim',
                executable='simulator',
                parameters=[{'scenario': str(path), 'rate': rate(context)}],
                on_exit=Shutdown(reason='the scenario has ended'),
                output='screen',
            )
        )
    return started


def rate(context):
    """Return the argument of that name."""
    given = LaunchConfiguration('rate').perform(context)
    try:
        value = float(given)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float('inf'):
        raise RuntimeError(f'rate:={given}: give a number above zero, such as 1.0 or 2.5')
    return value


def end_if_misconfigured(event, context):
    """End the launch where a node refused its configuration (status 2): starting it again would change nothing."""
    return [Shutdown(reason=f'{event.process_name}: wrong configuration')] if event.returncode == 2 else None
