"""ROS parameters from declared settings: one declaration, validated in one place."""

import dataclasses
import typing
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from drfmcw_physics.settings import ConfigurationError, Parameter, check_value, declared_parameters

T = TypeVar('T')

_LARGEST_INTEGER = 2**63 - 1


class SettingsParameters(Generic[T]):
    """Declares one ROS parameter per field of a settings dataclass and keeps the current value as that dataclass.

    Setting a parameter to a wrong value is refused with the reason; the dataclass changes as a whole or not at all.
    """

    def __init__(
        self,
        node: Node,
        cls: type[T],
        defaults: T | None = None,
        prefix: str = '',
        on_change: Callable[[T], None] | None = None,
    ) -> None:
        """Declare the parameters.

        Args:
            node: owner.
            cls: frozen dataclass whose fields were made with settings.parameter.
            defaults: instance whose values replace the declared defaults.
            prefix: put before each parameter's name, with a dot.
            on_change: called with the new value after a change was accepted.

        Raises:
            ConfigurationError: a value given at start is wrong.
        """
        self._node = node
        self._on_change = on_change
        self._prefix = f'{prefix}.' if prefix else ''
        hints = typing.get_type_hints(cls)
        self._declared = {name: (hints[name], declared) for name, (_, declared) in declared_parameters(cls).items()}
        values = {}
        for name, (field, declared) in declared_parameters(cls).items():
            default = getattr(defaults, name) if defaults is not None else _default(field)
            descriptor = _descriptor(hints[name], declared)
            given = node.declare_parameter(self._prefix + name, _plain(hints[name], default), descriptor).value
            values[name] = check_value(self._prefix + name, given, hints[name], declared, node.get_name())
        given_defaults: Any = defaults  # a dataclass, which `T` cannot say
        fields = () if defaults is None else dataclasses.fields(given_defaults)
        undeclared = {f.name: getattr(defaults, f.name) for f in fields if f.name not in values}
        self.value: T = cls(**undeclared, **values)
        """The current settings."""
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._accept)

    def _changes(self, parameters: Sequence[RosParameter]) -> dict[str, Any]:
        return {
            name: parameter.value
            for parameter in parameters
            if (name := parameter.name.removeprefix(self._prefix)) in self._declared
            and parameter.name.startswith(self._prefix)
        }

    def _converted(self, parameters: Sequence[RosParameter]) -> T:
        changes = {
            name: check_value(name, value, *self._declared[name]) for name, value in self._changes(parameters).items()
        }
        current: Any = self.value  # a dataclass, which `T` cannot say
        return dataclasses.replace(current, **changes)

    def _validate(self, parameters: Sequence[RosParameter]) -> SetParametersResult:
        try:
            self._converted(parameters)
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _accept(self, parameters: Sequence[RosParameter]) -> None:
        if self._changes(parameters):
            self.value = self._converted(parameters)
            if self._on_change is not None:
                self._on_change(self.value)


def _default(field: dataclasses.Field) -> Any:
    if field.default is not dataclasses.MISSING:
        return field.default
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    raise TypeError(f'{field.name} needs a default to be a ROS parameter')


def _plain(kind: Any, value: Any) -> Any:
    """Return `value` as the exact type rclpy infers the parameter's type from."""
    if typing.get_origin(kind) in (list, tuple):
        item = typing.get_args(kind)[0]
        return [item(v) for v in value] or [item()]
    return kind(value)


def _descriptor(kind: Any, declared: Parameter) -> ParameterDescriptor:
    description = declared.description
    if declared.unit != '1':
        description += f' [{declared.unit}]'
    if declared.choices:
        description += f' ({" | ".join(declared.choices)})'
    if declared.nan_means:
        description += f'; NaN: {declared.nan_means}'
    descriptor = ParameterDescriptor(description=description, read_only=declared.structural)
    low, high = declared.bounds
    if kind is float and not declared.nan_means and high < float('inf'):  # rcl refuses NaN where a range stands
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high), step=0.0)]
    elif kind is int and high < _LARGEST_INTEGER:
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return descriptor
