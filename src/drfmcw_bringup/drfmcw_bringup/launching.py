"""What the launch files decide: stations, pairs, parameter files, the end after a wrong configuration. Needs no launch.

A ConfigurationError ends a launch with its text and status 1, the only one that `ros2 launch` has for a failure.
"""

import os
import signal
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.sources.sockets import SocketSettings
from drfmcw_node.station_settings import StationSettings
from drfmcw_physics.settings import ConfigurationError, Parameter, check_value, declared_parameters, read_yaml
from drfmcw_ros.calibration.store import state_directory
from drfmcw_ros.commands.config_files import find_config

from .graph import OVER_UDP, WRONG_CONFIGURATION

RESPAWN_DELAY = 2.0
"""Before a process that died is started again [s]."""

_STATION_ARGUMENTS = ('source', 'ip_address', 'ip_port', 'peer', 'estimator', 'frame_id')
_FUSION_KEYS = ('/fusion', 'fusion', '/**')  # of a parameter file, by which fusion's parameters are found


def parameter_files(path: str) -> list[str]:
    """Return the ROS parameter file at `path`, or of that name in config/hardware, as a list; empty for an empty path.

    launch_ros only warns of a file that is not there and starts the nodes without it.

    Raises:
        ConfigurationError: it cannot be found or read, or holds no parameters.
    """
    if not path:
        return []
    _nodes_in(path)
    return [str(_found(path))]


def pairs_in(path: str) -> list[str]:
    """Return the pairs ('first/second') that a ROS parameter file gives to fusion, empty where it gives none.

    Raises:
        ConfigurationError: the file cannot be read, or the pairs are none.
    """
    nodes = _nodes_in(path) if path else {}
    for key in _FUSION_KEYS:
        given = nodes.get(key, {}).get('ros__parameters')
        pairs = given.get('pairs', []) if isinstance(given, dict) else []
        if not isinstance(pairs, list) or not all(isinstance(pair, str) and pair.count('/') == 1 for pair in pairs):
            raise ConfigurationError(f"{path}: {key}: pairs = {pairs} is no list of 'first/second'")
        if pairs:
            return pairs
    return []


def findings_directory(given: str) -> str:
    """Return where live diagnosis and host keep findings: as given, else where the host has them by default."""
    return given or str(state_directory(os.environ) / 'findings')


def has_node(path: str, name: str) -> bool:
    """Return whether a ROS parameter file has an entry for the node of that name in the root namespace.

    Raises:
        ConfigurationError: the file cannot be read.
    """
    nodes = _nodes_in(path) if path else {}
    return name in nodes or f'/{name}' in nodes


def stations_of(pairs: Sequence[str]) -> list[str]:
    """Return the stations of pairs, each once, in the order in which they are named."""
    return list(dict.fromkeys(name for pair in pairs for name in pair.split('/')))


def station_arguments() -> dict[str, dict[str, Any]]:
    """Return the optional launch arguments of a station: name and what `DeclareLaunchArgument` takes about it."""
    return {name: _about(declared) for name, (_, declared) in _station_declarations().items()}


def station_parameters(given: Mapping[str, str]) -> dict[str, str | int]:
    """Return the ROS parameters that launch arguments give, leaving out empty ones.

    Raises:
        ConfigurationError: a value is wrong.
    """
    values: dict[str, str | int] = {}
    for name, (kind, declared) in _station_declarations().items():
        if text := given.get(name, ''):
            value: str | int = int(text) if kind is int and text.isdecimal() else text
            values[name] = check_value(name, value, kind, declared, 'launch')
    return values


def _station_declarations() -> dict[str, tuple[type, Parameter]]:
    """Return type and declaration of each parameter of a station that is a launch argument."""
    found: dict[str, tuple[type, Parameter]] = {}
    for cls in (StationSettings, SocketSettings, EstimatorSettings):
        hints = typing.get_type_hints(cls)
        found |= {n: (hints[n], d) for n, (_, d) in declared_parameters(cls).items() if n in _STATION_ARGUMENTS}
    return found


def _about(declared: Parameter) -> dict[str, Any]:
    choices = {'choices': ['', *declared.choices]} if declared.choices else {}
    return {'description': declared.description} | choices


def positive(name: str, text: str) -> float:
    """Return the number that a launch argument gives.

    Raises:
        ConfigurationError: it is no number above zero.
    """
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float('inf'):
        raise ConfigurationError(f'{name}:={text}: give a number above zero, such as 1.0 or 2.5')
    return value


def restarted() -> dict[str, Any]:
    """Return the arguments of a node that is started again when it dies.

    It then hears the others, unless the environment chooses another transport of Fast DDS.
    """
    return {
        'respawn': True,
        'respawn_delay': RESPAWN_DELAY,
        'on_exit': end_if_misconfigured,
        'output': 'screen',
        'additional_env': {name: value for name, value in OVER_UDP.items() if name not in os.environ},
    }


def end_if_misconfigured(event: Any, context: Any) -> None:
    """End the launch, with a failure, where a node refused its configuration: starting it again would change nothing.

    Raises:
        ConfigurationError: the process ended with status 2.
    """
    if event.returncode == WRONG_CONFIGURATION:
        raise ConfigurationError(f'{event.process_name}: wrong configuration (status 2), see its last line above')


def end_if_unfinished(event: Any, context: Any) -> None:
    """End the launch, with a failure, where the simulator died: without it there are no sweeps, nor will there be.

    Raises:
        ConfigurationError: the process ended with another status than 0, and nobody stopped the launch.
    """
    end_if_misconfigured(event, context)
    if event.returncode != 0 and not context.is_shutdown:
        status = event.returncode
        how = f'killed by {signal.Signals(-status).name}' if status < 0 else f'status {status}'
        raise ConfigurationError(f'{event.process_name}: ended before the scenario ({how})')


def _found(path: str) -> Path:
    return find_config(path, 'hardware')


def _nodes_in(path: str) -> dict[str, Any]:
    """Return the nodes of a ROS parameter file and what each gets."""
    content = read_yaml(_found(path))
    if not all(isinstance(value, dict) for value in content.values()):
        raise ConfigurationError(f'{path}: no ROS parameter file: give node: ros__parameters: name: value')
    return content
