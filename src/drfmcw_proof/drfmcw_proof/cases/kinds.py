"""What an effect is, how it is made larger, and what effects share."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..generator.model import Scene

Parameters = Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Applied:
    """One effect with its parameters, as a sealed truth states it."""

    effect: str
    station: str | None
    parameters: Parameters

    def as_object(self) -> dict[str, Any]:
        """Return a JSON-ready object."""
        return {'effect': self.effect, 'station': self.station, 'parameters': dict(self.parameters)}


@dataclasses.dataclass(frozen=True)
class Size:
    """How an effect is made larger: value of `parameter` at size s > 0, rising in effect from `lower` to `upper`.

    A list keeps its proportions, as deviations from `neutral`; its largest deviation becomes the size.
    """

    parameter: str
    value: Callable[[float], float | list[float]]
    start: float
    lower: float
    upper: float
    neutral: float = 0.0  # value of a list's members without effect


@dataclasses.dataclass(frozen=True)
class Kind:
    """What an effect is."""

    name: str
    of: str  # 'station', 'path' or 'reference'
    units: Mapping[str, str]
    size: Size
    apply: Callable[[Scene, tuple[int, ...], Parameters], None]
    registered: bool  # named by the interface


KINDS: dict[str, Kind] = {}
"""All effects by name."""


def linear(parameter: str, start: float, upper: float) -> Size:
    """Sizes that are the value of `parameter`."""
    return Size(parameter, lambda s: s, start, start * 1e-6, upper)


def decibel(parameter: str, start: float, lower: float, upper: float) -> Size:
    """Amplitudes in dB: s is their linear value."""
    size = [10.0 ** (x / 20.0) for x in (start, lower, upper)]
    return Size(parameter, lambda s: 20.0 * math.log10(s), *size)


def kind(name: str, of: str, units: Mapping[str, str], size: Size, registered: bool = True) -> Callable[[Any], Any]:
    """Register the decorated function as an effect."""

    def register(function: Callable[[Scene, tuple[int, ...], Parameters], None]) -> Any:
        KINDS[name] = Kind(name, of, units, size, function, registered)
        return function

    return register


def full_scale(scene: Scene, level: float) -> float:
    """Return the amplitude [LSB] of a level [dBFS]."""
    return scene.condition.full_scale * 10.0 ** (level / 20.0)


def deviate(scene: Scene, station: int, ppm: np.ndarray | float) -> None:
    """Change a reference; the ADC runs from it."""
    change = 1e-6 * ppm / scene.alpha[station]
    scene.alpha[station] = scene.alpha[station] * (1.0 + change)
    scene.clock[station] = scene.clock[station] * (1.0 + change)
