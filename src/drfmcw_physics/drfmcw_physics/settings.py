"""Declared settings: one declaration gives the YAML key, the ROS parameter and the documentation.

A settings class is a frozen dataclass whose fields are made with :func:`parameter`. :func:`from_mapping` builds one
from a mapping read from YAML and names the wrong key or value, where it stands, and the nearest valid key.
"""

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

_METADATA = 'drfmcw_parameter'


class ConfigurationError(ValueError):
    """Wrong configuration; the message is one line that names what is wrong and where."""


@dataclasses.dataclass(frozen=True)
class Parameter:
    """What is declared about one setting besides its type and default."""

    unit: str
    description: str
    bounds: tuple[float, float] = (-math.inf, math.inf)
    choices: Collection[str] = ()
    nan_means: str = ''  # what NaN stands for ('' = NaN is refused)
    structural: bool = False  # cannot be changed while a node runs


def parameter(
    default: Any = dataclasses.MISSING,
    *,
    unit: str = '1',
    description: str,
    bounds: tuple[float, float] = (-math.inf, math.inf),
    choices: Collection[str] = (),
    nan_means: str = '',
    structural: bool = False,
) -> Any:
    """Declare one field of a settings dataclass.

    Args:
        default: value where the configuration gives none; left out, the field is required.
        unit: SI unit or the unit of the field, '1' for none.
        description: one sentence, shown in documentation and by ``ros2 param describe``.
        bounds: smallest and largest valid value, both valid.
        choices: the valid strings, where the field is a string. The keys of a mapping (a registry) stay live: what is
            registered later is valid too.
        nan_means: what NaN stands for; left empty, NaN is refused.
        structural: True where a running node cannot change it.
    """
    valid = choices if isinstance(choices, Mapping) else tuple(choices)
    declared = Parameter(unit, description, bounds, valid, nan_means, structural)
    metadata = {_METADATA: declared}
    if isinstance(default, (list, dict)):
        return dataclasses.field(default_factory=lambda: type(default)(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def declared_parameters(cls: type) -> dict[str, tuple[dataclasses.Field, Parameter]]:
    """Return {name: (field, declaration)} of the fields of `cls` that were made with `parameter`."""
    return {f.name: (f, f.metadata[_METADATA]) for f in dataclasses.fields(cls) if _METADATA in f.metadata}


def nearest(word: str, valid: Collection[str]) -> str:
    """Return ' (did you mean ...?)' with the valid word nearest to `word`, or a list of all where none is near."""
    close = difflib.get_close_matches(str(word), [str(v) for v in valid], n=1, cutoff=0.6)
    return f"; did you mean '{close[0]}'?" if close else f'; valid: {", ".join(map(str, valid))}'


def check_value(name: str, value: Any, kind: Any, declared: Parameter, where: str = '') -> Any:
    """Return `value` converted to `kind`: float, int, bool, str, a list or tuple of these, or None where allowed.

    Args:
        name: of the setting, for the message.
        value: as read.
        kind: the field's type.
        declared: bounds, choices, and whether NaN is valid.
        where: file and section, for the message.

    Raises:
        ConfigurationError: wrong type, outside the bounds, not among the choices, NaN or infinite.
    """
    label = f'{where}: {name}' if where else name
    origin = typing.get_origin(kind)
    if origin in (list, tuple):
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise ConfigurationError(f'{label} must be a list, not {value!r}')
        item_kind = typing.get_args(kind)[0]
        return origin(check_value(f'{name}[{i}]', v, item_kind, declared, where) for i, v in enumerate(value))
    if origin in (typing.Union, types.UnionType):
        if value is None:
            return None
        kind = next(k for k in typing.get_args(kind) if k is not type(None))
    check = _CHECKS.get(kind)
    return value if check is None else check(label, value, declared)


def _boolean(label: str, value: Any, declared: Parameter) -> bool:
    if not isinstance(value, bool):
        raise ConfigurationError(f'{label} must be true or false, not {value!r}')
    return value


def _string(label: str, value: Any, declared: Parameter) -> str:
    if not isinstance(value, str):
        raise ConfigurationError(f'{label} must be a string, not {value!r}')
    if declared.choices and value not in declared.choices:
        raise ConfigurationError(f"{label}: '{value}' is not valid{nearest(value, declared.choices)}")
    return value


def _number(label: str, value: Any, declared: Parameter) -> float:
    """Return an int or a float; as it is, because a large int would lose digits as a float."""
    if isinstance(value, str):  # YAML 1.1 reads 5725e6 as a string
        try:
            value = float(value)
        except ValueError:
            raise ConfigurationError(f'{label} must be a number, not {value!r}') from None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigurationError(f'{label} must be a number, not {value!r}')
    if math.isnan(value):
        if declared.nan_means:
            return value
        raise ConfigurationError(f'{label} must be a number, not NaN')
    low, high = declared.bounds
    unit = '' if declared.unit == '1' else f' {declared.unit}'
    if not (low <= value <= high) or math.isinf(value):
        raise ConfigurationError(f'{label} = {value:g}{unit} is outside {low:g} ... {high:g}{unit}')
    return value


def _float(label: str, value: Any, declared: Parameter) -> float:
    return float(_number(label, value, declared))


def _integer(label: str, value: Any, declared: Parameter) -> float:
    number = _number(label, value, declared)
    if math.isnan(number):
        return number
    if number != int(number):
        raise ConfigurationError(f'{label} must be a whole number, not {number!r}')
    return int(number)


_CHECKS: dict[Any, Callable[[str, Any, Parameter], Any]] = {
    bool: _boolean,
    str: _string,
    float: _float,
    int: _integer,
}


def from_mapping(cls: type, mapping: Mapping[str, Any] | None, where: str) -> Any:
    """Build the settings dataclass `cls` from a mapping; nested settings classes are built from nested mappings.

    Args:
        cls: frozen dataclass whose fields were made with `parameter`.
        mapping: as read from YAML; None counts as empty.
        where: file (and section) the mapping stands in, for messages.

    Raises:
        ConfigurationError: unknown key (with the nearest valid one), missing key, wrong value.
    """
    mapping = {} if mapping is None else mapping
    if not isinstance(mapping, Mapping):
        raise ConfigurationError(f'{where}: expected a mapping of settings, not {mapping!r}')
    fields = {f.name: f for f in dataclasses.fields(cls) if f.init}
    for key in mapping:
        if key not in fields:
            raise ConfigurationError(f"{where}: unknown key '{key}'{nearest(key, list(fields))}")
    hints = typing.get_type_hints(cls)
    values = {}
    for name, field in fields.items():
        if name not in mapping:
            if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
                raise ConfigurationError(f"{where}: key '{name}' is missing")
            continue
        value, kind = mapping[name], hints[name]
        if isinstance(kind, type) and dataclasses.is_dataclass(kind):
            values[name] = from_mapping(kind, value, f'{where}: {name}')
        else:
            values[name] = check_value(name, value, kind, field.metadata.get(_METADATA, Parameter('1', '')), where)
    try:
        return cls(**values)
    except ConfigurationError as error:
        raise ConfigurationError(f'{where}: {error}') from None


def read_text(path: Path | str) -> str:
    """Return the text of a file in UTF-8, without a byte order mark.

    Raises:
        ConfigurationError: missing or unreadable file, or no text.
    """
    try:
        return Path(path).read_text(encoding='utf-8-sig')
    except OSError as error:
        raise ConfigurationError(f'{path}: {error.strerror}') from None
    except UnicodeDecodeError:
        raise ConfigurationError(f'{path}: not a text file') from None


def read_yaml(path: Path | str) -> dict[str, Any]:
    """Read a YAML file that holds one mapping.

    Raises:
        ConfigurationError: missing or unreadable file, YAML syntax error (with line), no mapping, key given twice.
    """
    return parse_yaml(read_text(path), str(path))


def parse_yaml(text: str, where: str) -> dict[str, Any]:
    """Return the one mapping that a YAML text holds; errors as `read_yaml`, with `where` instead of the file."""
    try:
        content = yaml.load(text, Loader=_UniqueKeyLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        line = f' line {mark.line + 1}' if mark else ''
        raise ConfigurationError(f'{where}{line}: {getattr(error, "problem", None) or error}') from None
    if not isinstance(content, dict):
        raise ConfigurationError(f'{where}: expected a mapping of settings')
    return content


class _UniqueKeyLoader(yaml.SafeLoader):
    """Safe loader that refuses a key given twice, which YAML parsers silently let the last one win."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(None, None, 'a key is no plain text', key_node.start_mark)
            key = self.construct_object(key_node, deep=deep)
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key '{key}' is given twice", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)
