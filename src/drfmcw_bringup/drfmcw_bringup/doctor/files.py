"""Parameter files and scenarios: rclpy ignores a parameter whose name it does not know, without a word."""

import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from drfmcw_fusion.crane.frames import FramesSettings
from drfmcw_fusion.crane.geometry import SiteGeometry
from drfmcw_fusion.fusion import PairSettings
from drfmcw_fusion.integrity.settings import IntegritySettings
from drfmcw_fusion.settings import FusionSettings
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.sources.source import Source
from drfmcw_node.station_settings import (
    PairEstimatorSettings,
    PairStationSettings,
    SpectrumSettings,
    StationSettings,
)
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.mode import ModeSettings
from drfmcw_physics.settings import ConfigurationError, Parameter, check_value, declared_parameters, nearest, read_yaml
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.nodes.managed import LifecycleSettings
from drfmcw_sim.scenario import read_scenario
from drfmcw_sim.simulator import SimulatorSettings

from .finding import ERROR, OK, WARN, Finding

_PARAMETERS = 'ros__parameters'
_EVERY_NODE = ('use_sim_time', 'declare_qos_overrides', 'qos_overrides', 'start_type_description_service')
_NODES: dict[str, list[tuple[str, type]]] = {
    'station': [
        *(('', cls) for cls in (StationSettings, EstimatorSettings, SpectrumSettings, LifecycleSettings)),
        *(('', source.settings) for source in Source.registry.values()),
        ('sweep.', SweepSettings),
        ('calibration.', Calibration),
    ],
    'pair_station': [
        *(('', cls) for cls in (PairStationSettings, PairEstimatorSettings, SpectrumSettings, LifecycleSettings))
    ],
    'fusion': [
        *(('', cls) for cls in (PairSettings, FusionSettings, LifecycleSettings)),
        ('integrity.', IntegritySettings),
        ('mode.', ModeSettings),
    ],
    'frames': [('', FramesSettings), ('', SiteGeometry)],
    'simulator': [('', SimulatorSettings)],
}
"""Name of a node, and the settings that are its parameters, each with what stands before their names."""


def check_file(path: Path) -> Iterator[Finding]:
    """Yield what is wrong in a ROS parameter file or a scenario."""
    subject = path.name
    try:
        content = read_yaml(path)
        nodes = dict(_nodes(content, ''))
        if not nodes:
            scenario = read_scenario(path)
            yield Finding(OK, subject, f'a scenario of {", ".join(scenario.stations)}')
            return
    except ConfigurationError as error:
        yield Finding(ERROR, subject, str(error), 'correct it: keys in src/drfmcw_sim/README.md')
        return
    wrong = [found for name, values in nodes.items() for found in _check_node(subject, name, values)]
    yield from wrong
    if not any(found.level == ERROR for found in wrong):
        yield Finding(OK, subject, f'parameters of {", ".join(nodes)}')


def _nodes(content: Mapping[str, Any], name: str) -> Iterator[tuple[str, Any]]:
    """Yield (node, its parameters) of a parameter file, whose keys may be nested namespaces."""
    for key, value in content.items():
        if key == _PARAMETERS:
            yield name or '/**', value
        elif isinstance(value, Mapping):
            yield from _nodes(value, f'{name.rstrip("/")}/{str(key).lstrip("/")}')


def _check_node(subject: str, name: str, values: Any) -> Iterator[Finding]:
    kind = name.rpartition('/')[2]
    if not isinstance(values, Mapping):
        yield Finding(ERROR, subject, f'{name}: {_PARAMETERS} holds no parameters', 'write name: value below it')
        return
    if kind not in _NODES:
        if kind not in ('**', '*'):
            said = f'{name}: not checked, the nodes known here are {", ".join(_NODES)}'
            yield Finding(WARN, subject, said, "check the node's name, as in /master/station")
        return
    known: dict[str, tuple[Any, Parameter]] = {}
    for prefix, cls in _NODES[kind]:
        hints = typing.get_type_hints(cls)
        known |= {prefix + n: (hints[n], declared) for n, (_, declared) in declared_parameters(cls).items()}
    for parameter, value in _flat(values, ''):
        if parameter.split('.')[0] in _EVERY_NODE:
            continue
        if parameter not in known:
            said = f"{name}: no parameter '{parameter}', which ROS ignores without a word"
            yield Finding(ERROR, subject, said, f'remove or rename it{nearest(parameter, list(known))}')
            continue
        try:
            hint, declared = known[parameter]
            check_value(parameter, value, hint, declared, name)
        except ConfigurationError as error:
            yield Finding(ERROR, subject, str(error), 'correct it: the node would refuse to start')


def _flat(values: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f'{prefix}{name}.')
        else:
            yield prefix + str(name), value
