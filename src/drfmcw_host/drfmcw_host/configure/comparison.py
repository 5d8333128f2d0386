"""Two calibrations side by side, and what the difference does to ranges. Free of ROS."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

from drfmcw_fusion.combination import PathDelay
from drfmcw_fusion.displacement import displacement, with_line
from drfmcw_fusion.uncertainty import Weather, contributions
from drfmcw_physics.air import MODELS, refractive_index
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import declared_parameters
from drfmcw_physics.sweep import SweepSettings, beat_frequency
from drfmcw_ros.calibration.document import Document

from ..state.store import Store

DISTANCES = (100.0, 1000.0)
"""At which the effect on a range is shown [m]."""

_CLOCKS = ('reference_clock', 'sample_clock')
_ALWAYS = ('value', 'reference')  # other values are left out of a document where they are the default: not stated
_UNITS = {  # of documents: (unit that is shown, factor)
    's': ('ns', 1e9),
    's/K': ('ps/K', 1e12),
    '1/K': ('ppm/K', 1e6),
    '1/K^2': ('ppb/K²', 1e9),
    '1/K^3': ('ppb/K³', 1e9),
    'Hz': ('kHz', 1e-3),
    'degC': ('°C', 1.0),
}
Shown = float | str | tuple[float, ...] | None
"""A value of a document; None where it is not stated."""

_WEATHER = {'/site/temperature': 15.0, '/site/pressure': 101_325.0, '/site/humidity': 0.5}


@dataclasses.dataclass(frozen=True)
class Value:
    """One value of both documents; None where one does not state it."""

    section: str  # '' for what stands outside of sections
    key: str
    unit: str
    before: Shown
    after: Shown

    @property
    def changed(self) -> bool:
        """Whether the documents differ in it."""
        return self.before != self.after


@dataclasses.dataclass(frozen=True)
class Effect:
    """What a calibration does to the range of a pair at one distance."""

    pair: str
    distance: float  # [m]
    shift: float  # of the range [m]
    std_before: float  # that the calibrations of both stations state [m]
    std_after: float


def side_by_side(before: Document, after: Document) -> list[Value]:
    """Return the values that either document states, in the order of the format."""
    old, new = dict(_values(before)), dict(_values(after))
    pairs = ((name, old.get(name), new.get(name)) for name in dict.fromkeys([*old, *new]))
    return [Value(*name, one, other) for name, one, other in pairs if (one, other) != (None, None)]


def _values(document: Document) -> Iterator[tuple[tuple[str, str, str], Shown]]:
    for field in dataclasses.fields(document):
        content = getattr(document, field.name)
        if dataclasses.is_dataclass(content):
            kind: Any = type(content)
            for key, (_, declared) in declared_parameters(kind).items():
                stated = getattr(content, key)
                unit, value = _shown(field.name, key, declared.unit, stated)
                unknown = key not in _ALWAYS and stated == getattr(kind(), key)
                yield (field.name, key, unit), None if unknown else value
        elif field.name in ('instrument', 'note'):
            yield ('', field.name, ''), content or None


def _shown(section: str, key: str, stated: str, value: Any) -> tuple[str, Shown]:
    """Return unit and value as they are shown: clocks in ppm over nominal."""
    unit, factor = _UNITS.get(stated, (stated, 1.0))
    if section in _CLOCKS and key in ('value', 'std'):
        unit, factor = 'ppm', 1e6
        value = value - 1.0 if key == 'value' else value
    if isinstance(value, list):
        return unit, tuple(v * factor for v in value) or None
    if isinstance(value, str):
        return '', value or None
    return unit, None if math.isnan(value) else value * factor


def effects(store: Store, before: Calibration, after: Calibration) -> list[Effect]:
    """Return what replacing a station's calibration does to the ranges of its pairs, as far as they are known.

    With the sweep settings in use, T_off as set, the boards and the air as they are, and the peer's calibration.
    """
    found = []
    with store.lock:
        air = {topic: store.site[topic].value if topic in store.site else value for topic, value in _WEATHER.items()}
        weather = Weather(*air.values())
        for name in sorted(store.pairs):
            first, second = name.split('/')
            sweeps = [store.stations[a].settings.get(b) for a, b in ((first, second), (second, first))]
            if before.station not in (first, second) or first == second or None in sweeps:
                continue
            old = _pair(store, (first, second), before)
            new = _pair(store, (first, second), after)
            for distance in DISTANCES:
                found.append(_effect(name, distance, sweeps, old, new, weather))  # type: ignore[arg-type]
    return found


def _pair(store: Store, names: tuple[str, str], replaced: Calibration) -> list[Calibration]:
    """Return the calibrations of a pair, one of them replaced, as they hold at the temperatures of the boards."""
    calibrations = []
    for name in names:
        station = store.stations[name]
        used = replaced if name == replaced.station else station.calibration or Calibration(name)
        calibrations.append(used.at(station.health.temperature if station.health else math.nan))
    return calibrations


def _effect(
    name: str,
    distance: float,
    sweeps: list[SweepSettings],
    before: list[Calibration],
    after: list[Calibration],
    weather: Weather,
) -> Effect:
    index = float(refractive_index(weather.temperature, weather.pressure, weather.humidity))
    shift, _ = displacement(sweeps, after, before, distance, index)
    stds = [_std(distance * index / SPEED_OF_LIGHT, sweeps, pair, weather) for pair in (before, after)]
    return Effect(name, distance, shift, *stds)


def _std(delay: float, sweeps: list[SweepSettings], pair: list[Calibration], weather: Weather) -> float:
    """Return the standard deviation of a range that the calibrations state; the weather's is left out [m]."""
    first, second = (with_line(s, c, beat_frequency(s, delay, 1.0, 1.0)) for s, c in zip(sweeps, pair, strict=True))
    path = PathDelay(delay, delay, 0.0, math.nan, 0.0, first.sweep.center_frequency, math.nan)
    return contributions(first, second, path, weather, MODELS[0]).total
