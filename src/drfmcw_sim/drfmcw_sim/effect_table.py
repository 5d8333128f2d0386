"""The catalogue of effects in the documentation, from their declarations (see drfmcw_ros.nodes.parameter_tables).

What an effect of typical size does to the range is simulated as the catalogue is made.
"""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml

from drfmcw_physics.bounds import LineNoise, coloured_bound
from drfmcw_physics.settings import declared_parameters
from drfmcw_physics.sweep import Mode
from drfmcw_ros.nodes.parameter_tables import parameter_table

from .effects import Effect, Of
from .effects.motion import slowness
from .measurements import Measurements
from .scenario import Scenario, scenario_from_mapping
from .synthesis.signal_model import synthesise
from .timeline import Slots, Timeline

_DISTANCES = (200.0, 1000.0)  # [m], short- and long-distance mode
_SWEEPS = 64
_STATIONS = ('master', 'slave')
_SAMPLE_RATE = 2.048e6
_SEARCH = 50e3  # largest shift of a line that is looked for [Hz]
_PASSING = 0.5  # speed at which the crane passes a reference that is late [m/s]


def effect_table() -> str:
    """Return a Markdown table of all registered effects."""
    lines = ['| effect | of | parameters | what it is |', '|---|---|---|---|']
    for name, cls in sorted(Effect.registry.items()):
        parameters = ', '.join(
            f'`{parameter}` [{declared.unit}] {declared.description}'
            for parameter, (_, declared) in declared_parameters(cls).items()
        )
        lines.append(f'| [`{name}`](../../docs/effects.md#{name}) | {cls.of} | {parameters} | {_description(cls)} |')
    return '\n'.join(lines)


def effect_catalogue() -> str:
    """Return a Markdown section for each registered effect, in the order of their names."""
    return '\n\n'.join(_section(name, cls) for name, cls in sorted(Effect.registry.items()))


def _description(cls: type[Effect]) -> str:
    return ' '.join(str(cls.__doc__).split())


def _section(name: str, cls: type[Effect]) -> str:
    example = yaml.safe_dump(example_of(cls), default_flow_style=True, sort_keys=False, width=1000).strip()
    return '\n'.join(
        [
            f'## {name}',
            '',
            _description(cls),
            '',
            f'- Of: {cls.of}. Acts on: {cls.acts_on.words}.',
            f'- `{cls.formula}`',
            f'- The size below gives: {_range_error(cls)}.',
            '',
            parameter_table(cls, at_run_time=False),
            '',
            '```yaml',
            f'effects: [{example}]',
            '```',
        ]
    )


def example_of(cls: type[Effect]) -> dict[str, Any]:
    """Return the entry of a scenario's `effects` that switches an effect of typical size on."""
    return {'effect': cls.name} | ({'station': _STATIONS[1]} if cls.of is Of.STATION else {}) | cls.example


def _scenario(effect: Mapping[str, Any] | None) -> Scenario:
    """Return the catalogue's site: Table 1 with quadrature receivers, boards 10 K above calibration."""
    board = {'board_temperature': 35.0}
    return scenario_from_mapping(
        {
            'stations': {name: board for name in _STATIONS},
            'pairs': [
                {'first': 'master', 'second': 'slave', 'standing': {'distances': list(_DISTANCES), 'sweeps': _SWEEPS}}
            ],
            'waveform': {'iq': True, 'sample_rate': _SAMPLE_RATE},
            'timing': {'start_delay_jitter': 0.0, 'amplitude_scatter': 0.0, 'sweep_interval': 0.05},
            'reference': {'range_std': 0.0},
            'effects': [effect] if effect else [],
        },
        'catalogue',
    )


@dataclasses.dataclass(frozen=True)
class _Standing:
    """One distance of the catalogue's site, all effects applied."""

    measurements: Measurements
    signals: tuple[np.ndarray, ...]  # noise-free IF of both stations, complex [n, samples]
    reference: np.ndarray  # readings [n] [m]


def _simulated(entry: Mapping[str, Any] | None) -> list[_Standing]:
    scenario = _scenario(entry)
    timeline = Timeline(scenario)
    result = []
    for _ in _DISTANCES:
        if not len(timeline.slots(1)):
            timeline.due_mode_changes()
        slots = timeline.slots(_SWEEPS)
        m = timeline.measurements(slots, 0)
        signals = tuple(
            s[..., 0] + 1j * s[..., 1] for s in synthesise(m, 1, scenario.effects, noise=False, quantised=False)
        )
        whole = m.rows(slice(0, _SWEEPS))
        for e in sorted(scenario.effects, key=lambda e: e.stage):
            e.prepare(whole)
        readings = slots.distance.copy()
        for effect in scenario.effects:
            readings += effect.reference_error(slots.time, slots.distance, functools.partial(_passing, slots))
        result.append(_Standing(whole, signals, readings))
        timeline.advance(len(slots))
    return result


def _passing(slots: Slots, time: np.ndarray | float) -> np.ndarray | float:
    """Return the distance at `time` [s] of a crane that passes each slot's distance at even speed [m]."""
    return slots.distance + _PASSING * (time - slots.time)


@functools.cache
def _nominal() -> list[_Standing]:
    return _simulated(None)


def _range_error(cls: type[Effect]) -> str:
    """Say what the typical size does to range minus reference, to its standard deviation and to the levels."""
    said = []
    for nominal, changed in zip(_nominal(), _simulated(example_of(cls)), strict=True):
        sweep = nominal.measurements.stations[0].sweep
        per_frequency = 1.0 / (slowness(nominal.measurements) * 2.0 * sweep.chirp_rate)
        shifts, ratios = zip(*map(_line_change, nominal.signals, changed.signals), strict=True)
        error = 1e3 * (sum(shifts) * per_frequency - changed.reference + nominal.reference)
        levels = [20.0 * np.log10(np.mean(ratio)) for ratio in ratios]
        before, after = (_bound(s) * per_frequency[0] * 1e3 for s in (nominal, changed))
        words = f'{np.mean(error):+.2f} mm'
        words += f' ± {np.std(error):.2f} mm from sweep to sweep' if np.std(error) > 0.005 else ''
        words += f', std at best {before:.2f} → {after:.2f} mm' if abs(after / before - 1.0) > 0.001 else ''
        words += f', levels {levels[0]:+.2f} and {levels[1]:+.2f} dB' if np.max(np.abs(levels)) > 0.005 else ''
        words = words.replace('-0.00', '+0.00')
        said.append(f'{nominal.measurements.range[0]:g} m ({Mode(sweep.mode).short_name}): {words}')
    return '; '.join(said)


def _line_change(nominal: np.ndarray, changed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much the peak of the line's Hann spectrum moves [Hz], and its height's ratio [1], both [n].

    Args:
        nominal: noise-free IF of one station, complex [n, samples].
        changed: the same with an effect.
    """
    if np.array_equal(nominal, changed):
        return np.zeros(len(nominal)), np.ones(len(nominal))
    count = 2000  # samples in the middle of the record, where both chirps are on
    rows = slice(24, 24 + count)
    window = np.hanning(count)
    mixed = changed[:, rows] * np.conj(nominal[:, rows]) * window
    padded = 1 << 12
    frequency = np.fft.fftfreq(padded, 1.0 / _SAMPLE_RATE)
    spectrum = np.abs(np.fft.fft(mixed, padded, axis=1))
    spectrum[:, np.abs(frequency) > _SEARCH] = 0.0
    peak = frequency[np.argmax(spectrum, axis=1)]
    time = (np.arange(count) - (count - 1) / 2) / _SAMPLE_RATE
    for _ in range(3):  # Newton on the logarithm of the magnitude
        turned = mixed * np.exp(-2j * np.pi * peak[:, None] * time)
        s0, s1, s2 = (np.sum(turned * time**power, axis=1) for power in range(3))
        slope = np.imag(s1 / s0)
        curvature = np.real(s2 / s0) - np.real((s1 / s0) ** 2)
        peak = peak + slope / curvature / (2.0 * np.pi)
    return peak, np.abs(s0) / (np.abs(nominal[:, rows]) ** 2 @ window)


def _bound(standing: _Standing) -> float:
    """Return the smallest standard deviation of both stations' sum of beat frequencies [Hz]."""
    m = standing.measurements
    delay = float(m.paths[0].delay[0])
    lines = tuple(
        LineNoise(
            10.0 ** ((s.received_power[0] - s.noise_density[0]) / 10.0),
            s.sweep.chirp_rate * (delay + sign * m.start_delay[0]),
            s.sweep.sample_rate,
            s.iq,
        )
        for s, sign in zip(m.stations, (1.0, -1.0), strict=True)
    )
    noises = tuple(s.phase_noise for s in m.stations)
    return coloured_bound(lines, noises, m.stations[0].sweep.ramp_duration, delay).frequency
