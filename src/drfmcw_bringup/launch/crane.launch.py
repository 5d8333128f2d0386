"""A whole site: one process per station and fusion, with a simulator in place of the hardware or without.

ros2 launch drfmcw_bringup crane.launch.py scenario:=tdma
ros2 launch drfmcw_bringup crane.launch.py simulate:=false parameters:=two_stations.yaml
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from drfmcw_bringup import launching
from drfmcw_ros.commands.config_files import find_config
from drfmcw_sim.scenario import read_scenario
from launch import LaunchDescription

PARAMETERS = 'YAML file with parameters of all nodes, or name in config/hardware'


def generate_launch_description():
    """Declare the arguments; the nodes follow from the scenario or the parameter file."""
    return LaunchDescription(
        [
            DeclareLaunchArgument('scenario', default_value='crane', description='YAML file, or name in config'),
            DeclareLaunchArgument('parameters', default_value='', description=PARAMETERS),
            DeclareLaunchArgument('rate', default_value='1.0', description='scenario seconds per second'),
            DeclareLaunchArgument(
                'simulate',
                default_value='true',
                choices=['true', 'false'],
                description="false: real stations, those of the parameter file's pairs, else of the scenario's",
            ),
            DeclareLaunchArgument(
                'host', default_value='false', choices=['true', 'false'], description="true: serve the host's page"
            ),
            DeclareLaunchArgument(
                'watch', default_value='false', choices=['true', 'false'], description='true: diagnose each pair live'
            ),
            DeclareLaunchArgument(
                'findings', default_value='', description='directory of its findings, which the page shows'
            ),
            OpaqueFunction(function=nodes),
        ]
    )


def nodes(context):
    """Return the nodes of the site's stations and pairs."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ('scenario', 'parameters', 'rate')}
    path, rate = find_config(given['scenario']), launching.positive('rate', given['rate'])
    files = launching.parameter_files(given['parameters'])
    simulated = LaunchConfiguration('simulate').perform(context) == 'true'
    pairs = [] if simulated else launching.pairs_in(given['parameters'])
    pairs = pairs or [f'{pair.first}/{pair.second}' for pair in read_scenario(path).pairs]
    restarted = launching.restarted()
    started = [Node(package='drfmcw_fusion', executable='fusion', parameters=[{'pairs': pairs}, *files], **restarted)]
    if launching.has_node(given['parameters'], 'frames'):
        started.append(Node(package='drfmcw_fusion', executable='frames', parameters=files, **restarted))
    for station in launching.stations_of(pairs):
        own = [{'station': station}, *files]
        started.append(
            Node(package='drfmcw_node', executable='station', namespace=station, parameters=own, **restarted)
        )
    findings = launching.findings_directory(LaunchConfiguration('findings').perform(context))
    if LaunchConfiguration('host').perform(context) == 'true':
        arguments = ['--findings', findings]
        started.append(Node(package='drfmcw_host', executable='host', arguments=arguments, **restarted))
    if LaunchConfiguration('watch').perform(context) == 'true':
        for pair in pairs:
            own = [{'pair': pair, 'findings': findings}, *files]
            started.append(
                Node(package='drfmcw_diagnosis', executable='watch', namespace=pair, parameters=own, **restarted)
            )
    if simulated:
        started.append(
            Node(
                package='drfmcw_sim',
                executable='simulator',
                parameters=[{'scenario': str(path), 'rate': rate}],
                on_exit=scenario_ended,
                output='screen',
            )
        )
    return started


def scenario_ended(event, context):
    """End the launch: as the scenario has, or with a failure where the simulator has not brought it to its end."""
    launching.end_if_unfinished(event, context)
    return [Shutdown(reason='the scenario has ended')]
