"""The parameter services of the running nodes: describe, set. Thin: ROS messages in and out of `values`."""

import asyncio
import math
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterDescriptor, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import parameter_value_to_python

from .calls import Remote
from .values import KINDS, Described, is_shown, split_unit

CONFIGURED = ('station', 'pair_station', 'fusion', 'watch')
"""Last names of the nodes whose parameters the page shows."""

_FIELDS = {
    1: 'bool_value',
    2: 'integer_value',
    3: 'double_value',
    4: 'string_value',
    6: 'bool_array_value',
    7: 'integer_array_value',
    8: 'double_array_value',
    9: 'string_array_value',
}
_TYPES = {kind: number for number, kind in KINDS.items()}


class RemoteParameters(Remote):
    """Calls the parameter services."""

    def nodes(self) -> list[str]:
        """Return the full names of the nodes that can be configured."""
        return [name for name in self._node.nodes if name.rpartition('/')[2] in CONFIGURED]

    async def describe(self, node: str) -> list[Described]:
        """Return a node's own parameters in the order of their names.

        Raises:
            Unreachable: it does not answer.
        """
        listed = await self._call(ListParameters, f'{node}/list_parameters', ListParameters.Request())
        names = sorted(name for name in listed.result.names if is_shown(name))
        described, values = await asyncio.gather(
            self._call(DescribeParameters, f'{node}/describe_parameters', DescribeParameters.Request(names=names)),
            self._call(GetParameters, f'{node}/get_parameters', GetParameters.Request(names=names)),
        )
        return [
            _described(node, descriptor, value)
            for descriptor, value in zip(described.descriptors, values.values, strict=True)
            if descriptor.type in KINDS
        ]

    async def set(self, parameter: Described, value: Any) -> tuple[bool, str]:
        """Set a parameter; return (taken, the node's reason against it).

        Raises:
            Unreachable: the node does not answer.
        """
        kind = _TYPES[parameter.kind]
        given = ParameterValue(type=kind, **{_FIELDS[kind]: value})
        request = SetParameters.Request(parameters=[Parameter(name=parameter.name, value=given)])
        (result,) = (await self._call(SetParameters, f'{parameter.node}/set_parameters', request)).results
        return result.successful, result.reason


def _described(node: str, descriptor: ParameterDescriptor, value: ParameterValue) -> Described:
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    low, high = (ranges[0].from_value, ranges[0].to_value) if ranges else (-math.inf, math.inf)
    description, unit = split_unit(descriptor.description)
    current = parameter_value_to_python(value)
    plain = list(current) if descriptor.type >= 5 and current is not None else current
    kind = KINDS[descriptor.type]
    return Described(node, descriptor.name, kind, plain, description, unit, low, high, descriptor.read_only)
