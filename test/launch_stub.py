"""A small stand-in for `launch` and `launch_ros`: it evaluates what our launch files describe, and starts nothing.

It has what they use, with the names, the refusals and the order of evaluation of the originals. No wheel has these; the
tests in which a process is started, killed and started again run where they are installed.
"""

import contextlib
import dataclasses
import runpy
import sys
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import yaml


@dataclasses.dataclass
class Context:
    """What is known while a launch file is evaluated, and while the launch runs."""

    launch_configurations: dict[str, str] = dataclasses.field(default_factory=dict)
    is_shutdown: bool = False


@dataclasses.dataclass(frozen=True)
class LaunchConfiguration:
    """Stands for the value of a launch argument."""

    name: str

    def perform(self, context: Context) -> str:
        return context.launch_configurations[self.name]


@dataclasses.dataclass(frozen=True)
class DeclareLaunchArgument:
    """One argument of a launch file."""

    name: str
    default_value: str | None = None
    description: str = ''
    choices: Sequence[str] | None = None

    def execute(self, context: Context) -> None:
        given = context.launch_configurations
        if self.name not in given:
            if self.default_value is None:
                raise RuntimeError(f'Required launch argument "{self.name}" was not provided.')
            given[self.name] = self.default_value
        if self.choices is not None and given[self.name] not in self.choices:
            raise RuntimeError(
                f'Argument "{self.name}" provided value "{given[self.name]}" is not valid. '
                f'Valid options are: {self.choices}'
            )


@dataclasses.dataclass(frozen=True)
class OpaqueFunction:
    """Actions that a function returns when the arguments are known."""

    function: Callable[[Context], list[Any] | None]

    def execute(self, context: Context) -> list[Any] | None:
        return self.function(context)


@dataclasses.dataclass(frozen=True)
class Shutdown:
    """The end of the launch."""

    reason: str = ''


@dataclasses.dataclass(frozen=True)
class ParameterValue:
    """A parameter whose type does not follow from its text."""

    value: Any
    value_type: type | None = None


@dataclasses.dataclass
class Node:
    """One process; its substitutions are performed when it is executed."""

    package: str
    executable: str
    namespace: Any = ''
    parameters: Sequence[Any] = ()
    arguments: Sequence[str] = ()
    respawn: bool = False
    respawn_delay: float | None = None
    on_exit: Callable[[Any, Context], Any] | None = None
    output: str = 'log'
    additional_env: Mapping[str, str] | None = None

    def execute(self, context: Context) -> None:
        def performed(value: Any) -> Any:
            if isinstance(value, ParameterValue):
                return (value.value_type or str)(performed(value.value))
            return value.perform(context) if isinstance(value, LaunchConfiguration) else value

        self.namespace = performed(self.namespace)
        self.parameters = [
            {name: performed(value) for name, value in given.items()} if isinstance(given, Mapping) else str(given)
            for given in self.parameters
        ]

    def command_line(self, directory: Path) -> list[str]:
        """The command line after the executable; parameter files are written into a directory."""
        given = [*self.arguments, '--ros-args', *(('-r', f'__ns:=/{self.namespace}') if self.namespace else ())]
        for number, content in enumerate(self.parameters):
            path = content
            if isinstance(content, Mapping):
                path = directory / f'{self.executable}_{self.namespace.replace("/", "_")}_{number}.yaml'
                path.write_text(yaml.safe_dump({'/**': {'ros__parameters': dict(content)}}), encoding='utf-8')
            given += ['--params-file', str(path)]
        return given


@dataclasses.dataclass(frozen=True)
class LaunchDescription:
    """What a launch file describes."""

    entities: Sequence[Any]


_MODULES = {
    'launch': (LaunchDescription,),
    'launch.actions': (DeclareLaunchArgument, OpaqueFunction, Shutdown),
    'launch.substitutions': (LaunchConfiguration,),
    'launch_ros': (),
    'launch_ros.actions': (Node,),
    'launch_ros.parameter_descriptions': (ParameterValue,),
}


@contextlib.contextmanager
def _installed() -> Iterator[None]:
    """Stand in for the originals, where they are installed too."""
    modules = {name: types.ModuleType(name) for name in _MODULES}
    for name, classes in _MODULES.items():
        vars(modules[name]).update({cls.__name__: cls for cls in classes})
    with mock.patch.dict(sys.modules, modules):
        yield


def nodes(path: Path, *arguments: str) -> list[Node]:
    """Return the nodes that `ros2 launch` starts of a launch file with arguments 'name:=value', in their order.

    Raises:
        RuntimeError, ConfigurationError: what ends the launch before anything starts.
    """
    context = Context(dict(argument.split(':=', 1) for argument in arguments))
    found: list[Node] = []
    with _installed():
        waiting = list(runpy.run_path(str(path))['generate_launch_description']().entities)
        while waiting:
            action = waiting.pop(0)
            waiting = [*(action.execute(context) or ()), *waiting]
            found += [action] if isinstance(action, Node) else []
    return found
