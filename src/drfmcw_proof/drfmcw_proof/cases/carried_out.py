"""Carries out the measurements that a diagnosis recommends: by how much do they really part the truth from a rival?

Recognised by the sentence that recommends them. Instruments read clocks and distances of the scene; repeated sweeps are
compared as `sizes.separation` does, without fitting the rival again.
"""

import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..generator.condition import Condition
from ..generator.model import Scene, nominal
from .concealing import KINDS, Applied, conceal
from .sizes import separation

Effects = Sequence[Applied]
Carried = Callable[[Effects, Effects], float]
"""Returns, for two sets of effects, how far the measurement separates them, in standard deviations."""

_WEATHER = ('air_temperature', 'air_pressure', 'air_humidity')
_OF_CRANE = ('slant_geometry', 'sway', 'target_motion')


def carried_out(sentence: str, condition: Condition) -> Carried | None:
    """Return a recommended measurement, None where the generator cannot make it.

    Args:
        sentence: that recommends it.
        condition: of the recording before it.
    """
    for pattern, make in _KNOWN:
        match = re.match(pattern, sentence)
        if match:
            return make(condition, match)
    return None


def _scene(condition: Condition, effects: Effects) -> Scene:
    return conceal(nominal(condition), effects)


def _counter(condition: Condition, match: re.Match[str]) -> Carried:
    """Read every clock in the middle of the recording; where two readings are asked for, their difference too."""
    clock = 'alpha' if match['clock'] == 'reference oscillator' else 'clock'
    accuracy = 1e-6 * float(match['ppm'])
    middle = len(condition.distances) // 2
    twice = condition
    if match['warmer'] or match['minutes']:
        weather: dict[str, Any] = {n: (getattr(condition, n)[middle],) * 2 for n in _WEATHER}
        warmer = float(match['warmer'] or 0.0)
        boards = tuple((b[middle], b[middle] + warmer) for b in condition.board_temperature)
        pause = 60.0 * float(match['minutes'] or 1.0)
        distances = (condition.distances[middle],) * 2
        twice = dataclasses.replace(
            condition, distances=distances, board_temperature=(boards[0], boards[1]), pause=pause, sweeps=1, **weather
        )

    def apart(one: Effects, other: Effects) -> float:
        def read(effects: Effects) -> np.ndarray:
            values = getattr(_scene(twice, effects), clock)
            if twice is condition:
                return values[:, values.shape[1] // 2]
            return np.concatenate([values[:, 0], values[:, 1] - values[:, 0]])

        return float(np.linalg.norm(read(one) - read(other))) / accuracy

    return apart


def _second_instrument(condition: Condition, match: re.Match[str]) -> Carried:
    """Measure the shortest and the longest distance, the reference read as often as in the recording."""
    quiet = dataclasses.replace(condition, reference_std=0.0)
    ends = [int(np.argmin(condition.distances)), int(np.argmax(condition.distances))]
    own = 1e-3 * float(match['mm']) * (1.0 + 1e-3 * np.array(condition.distances)[ends])
    std = np.hypot(own, condition.reference_std / math.sqrt(condition.sweeps))

    def apart(one: Effects, other: Effects) -> float:
        def error(effects: Effects) -> np.ndarray:
            scene = _scene(quiet, effects)
            rows = np.arange(len(scene))
            excess = scene.reference() - scene.range_at(rows, scene.time)
            return np.array([excess[scene.setting == s].mean() for s in ends])

        return float(np.linalg.norm((error(one) - error(other)) / std))

    return apart


def _baseline(condition: Condition, match: re.Match[str]) -> Carried:
    """Measure a length known by tape, without crane and reference instrument."""

    def first(values: tuple[float, ...]) -> tuple[float, ...]:
        return (values[0],)

    weather: dict[str, Any] = {n: first(getattr(condition, n)) for n in _WEATHER}
    alone = dataclasses.replace(
        condition,
        distances=(float(match['length']),),
        board_temperature=(first(condition.board_temperature[0]), first(condition.board_temperature[1])),
        **weather,
        # the same tape holds for all sweeps
        reference_std=1e-3 * float(match['mm']) * math.sqrt(condition.sweeps),
    )

    def there(effects: Effects) -> list[Applied]:
        return [e for e in effects if e.effect not in _OF_CRANE and KINDS[e.effect].of != 'reference']

    return lambda one, other: separation(alone, there(one), there(other))


def _repeated(condition: Condition, match: re.Match[str]) -> Carried:
    """Make the same sweeps again, with something changed."""
    how = match['how']
    kelvin = float(found[1]) if (found := re.search(r'(\d+) K', how)) else 0.0
    station = found[1] if (found := re.search(r'board of (\w+) heated', how)) else None
    warm = tuple(
        tuple(b + kelvin * (station in (None, name)) for b in boards)
        for name, boards in zip(condition.names, condition.board_temperature, strict=True)
    )
    changes: dict[str, Any] = {'board_temperature': warm}
    if 'air and boards' in how:
        changes['air_temperature'] = tuple(t + kelvin for t in condition.air_temperature)
    if attenuators := re.search(r'attenuators of (\d+) dB', how):
        changes['rx_antenna_gain'] = condition.rx_antenna_gain - float(attenuators[1])
    again = dataclasses.replace(condition, **changes)

    def there(effects: Effects) -> list[Applied]:
        left = [e for e in effects if 'braked' not in how or e.effect not in ('sway', 'target_motion')]
        return [_later(e, 3600.0) for e in left] if 'an hour later' in how else left

    return lambda one, other: separation(again, there(one), there(other))


def _later(effect: Applied, passed: float) -> Applied:
    """Return a drift as it is some time later; other effects know no time."""
    if effect.effect != 'reference_clock_drift':
        return effect
    p = dict(effect.parameters)
    if 'warmup' in p:
        return dataclasses.replace(
            effect, parameters={**p, 'warmup': p['warmup'] * math.exp(-passed / p['time_constant'])}
        )
    return Applied('reference_clock_offset', effect.station, {'deviation': p['rate'] * passed / 3600.0})


def _exchanged(condition: Condition, match: re.Match[str]) -> Carried:
    """Make the same sweeps with another, calibrated station in place of one."""
    gone = match['station']
    (stays,) = (n for n in condition.names if n != gone)

    def there(effects: Effects) -> list[Applied]:
        left = [e for e in effects if e.station != gone]
        return [
            dataclasses.replace(e, station=stays) if KINDS[e.effect].of == 'station' and e.station is None else e
            for e in left
        ]

    return lambda one, other: separation(condition, there(one), there(other))


def _more(condition: Condition, match: re.Match[str]) -> Carried:
    more = math.sqrt(float(match['times']) - 1.0)
    return lambda one, other: more * separation(condition, one, other)


_KNOWN: tuple[tuple[str, Callable[[Condition, re.Match[str]], Carried]], ...] = (
    (r'Read the (?P<clock>.+?) of each station with a frequency counter, to (?P<ppm>[\d.e-]+) ppm'
     r'(?:, at two board temperatures (?P<warmer>[\d.]+) K apart)?'
     r'(?:, at the start and at the end of (?P<minutes>[\d.]+) minutes)?', _counter),
    (r'Measure the shortest and the longest distance .* of (?P<mm>[\d.]+) mm', _second_instrument),
    (r'Measure a known baseline of (?P<length>[\d.]+) m .* to (?P<mm>[\d.]+) mm', _baseline),
    (r'Repeat the sweeps with another calibrated station in the place of (?P<station>\w+)', _exchanged),
    (r'Repeat the sweeps (?P<how>when air and boards.*|with the board of.*|an hour later.*|with attenuators.*'
     r'|with the crane braked.*)', _repeated),
    (r'Record (?P<times>\d+) times as many sweeps', _more),
)  # fmt: skip
