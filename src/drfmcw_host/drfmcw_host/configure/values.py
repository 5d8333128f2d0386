"""Parameters as a person reads and types them, free of ROS."""

import dataclasses
import math
import re
from typing import Any

from drfmcw_physics.settings import ConfigurationError

from ..words.numbers import general, localised

KINDS = {1: bool, 2: int, 3: float, 4: str, 6: list[bool], 7: list[int], 8: list[float], 9: list[str]}
"""Python type of rcl_interfaces/ParameterType values."""

_HIDDEN = ('qos_overrides.', 'use_sim_time', 'start_type_description_service')
_UNIT = re.compile(r'\s*\[([^\[\]]+)\]')
_CHOICES = re.compile(r'\(([^()|]+(?: \| [^()|]+)+)\)')
_TRUE, _FALSE = ('true', 'yes', 'on', '1'), ('false', 'no', 'off', '0')


@dataclasses.dataclass(frozen=True)
class Described:
    """One parameter of one node as the node declares it."""

    node: str  # full name
    name: str
    kind: Any  # Python type
    value: Any
    description: str  # without its unit
    unit: str
    low: float  # -inf for none
    high: float
    read_only: bool

    @property
    def choices(self) -> list[str]:
        """Return the values to choose from that the description lists, as in '(a | b)'; empty for none."""
        found = _CHOICES.search(self.description) if self.kind is str else None
        return found[1].split(' | ') if found else []

    def bounds(self, language: str) -> str:
        """Return the range as text, '' for none."""
        if math.isinf(self.low) and math.isinf(self.high):
            return ''
        return f'{general(self.low, 6, language)} … {general(self.high, 6, language)}'


def is_shown(name: str) -> bool:
    """Return whether a parameter is the node's own, not one that ROS adds to every node."""
    return not name.startswith(_HIDDEN)


def split_unit(description: str) -> tuple[str, str]:
    """Return (description without its unit, unit) of a text like 'speed of air [m/s]'."""
    found = list(_UNIT.finditer(description))
    if not found:
        return description, ''
    last = found[-1]
    return (description[: last.start()] + description[last.end() :]).strip(), last[1]


def shown(value: Any, language: str = 'en') -> str:
    """Return a value as it can be typed again; a language with decimal commas separates numbers by semicolons."""
    if isinstance(value, bool):
        return 'true' if value else 'false'
    if isinstance(value, float):
        return localised(repr(value), language)
    if isinstance(value, list | tuple):
        return f'{_separator(language)} '.join(shown(v, language) for v in value)
    return str(value)


def as_number(text: str, language: str) -> str:
    """Return a text of `shown` in another language where it is one number, else as it is."""
    try:
        float(text)
    except ValueError:
        return text
    return localised(text, language)


def _separator(language: str) -> str:
    return ';' if localised('.', language) == ',' else ','


def typed(text: str, kind: Any, language: str = 'en') -> Any:
    """Return what a text means as a value of `kind`; where decimal signs are commas, points are taken as well.

    Raises:
        ConfigurationError: it means none.
    """
    text = text.strip()
    if kind is bool:
        if text.lower() in _TRUE + _FALSE:
            return text.lower() in _TRUE
        raise ConfigurationError(f"'{text}' is neither true nor false")
    if kind in (int, float):
        try:
            return kind(text.replace(localised('.', language), '.'))
        except ValueError:
            raise ConfigurationError(f"'{text}' is no {'whole ' if kind is int else ''}number") from None
    if kind is str:
        return text
    (item,) = kind.__args__
    return [typed(part, item, language) for part in text.split(_separator(language))]
