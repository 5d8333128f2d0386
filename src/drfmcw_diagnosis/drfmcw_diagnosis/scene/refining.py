"""The simulator's configuration with the effects of a scene."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import write_atomically
from drfmcw_sim.synthesis.measured import MeasuredModel, Term

from ..finding.measured import MODEL
from ..finding.refined import scenario_mapping
from ..finding.result import BeforeAfter, FoundEffect, MeasuredCurve, MeasuredRemainder
from ..recording.dataset import Dataset
from .background import Background
from .evidence import shown_by
from .limits import BACKGROUND
from .material import Material
from .ramps.ramp import Ramp


def measured(data: Dataset, m: Material, repeated: Background, effects: Sequence[FoundEffect]) -> MeasuredModel | None:
    """Return what repeats with the ramp, and the patterns that vary with it, as a model that the simulator plays.

    It holds the lines of the scene as well. A constant that an effect makes is left out of it.
    """
    setting = int(np.bincount(data.setting).argmax())
    time = data.time[np.flatnonzero(data.setting == setting)[: len(m.signal)]]
    most = max(BACKGROUND.values // m.signal.shape[1], 2)
    rows = np.unique(np.round(np.linspace(0, len(time) - 1, min(len(time), most))).astype(int))
    rows = rows[np.concatenate([[True], np.diff(time[rows]) > 0.0])]
    rest = m.signal[rows] - repeated.mean
    values = repeated.mean + (rest @ repeated.patterns.conj().T) @ repeated.patterns
    levels = [e.parameters['level'].value for e in effects if e.effect == shown_by('leakage')]
    values = (values - sum(m.full_scale * 10.0 ** (level / 20.0) for level in levels)) / m.full_scale
    parts = {'background': values.real} | ({'background_q': values.imag} if m.iq else {})
    at, grid = time[rows].astype(float), np.arange(m.signal.shape[1]) / m.rate
    terms = tuple(Term(name, m.station, 'time', '', at, grid, part.copy()) for name, part in parts.items())
    return MeasuredModel((m.station,), data.path, terms)


def described_remainder(repeated: Background, m: Material) -> MeasuredRemainder:
    """Return what is said of that model."""
    scale = m.floor.mean
    before, after = (x**2 / scale for x in (repeated.constant, repeated.varying))
    curves = (MeasuredCurve(f'IF samples, {m.station}', ('background',), 'time', None, None, None),)
    share = float(np.clip((before - after) / max(before - 1.0, 1e-9), 0.0, 1.0))
    outside = BeforeAfter(before, after)
    return MeasuredRemainder(curves, share, outside, outside, (), ())


def write_refined(
    path: Path, data: Dataset, effects: Sequence[FoundEffect], bent: Ramp | None, remainder: Material | None = None
) -> str | None:
    """Write the scenario with the effects found; return its path, None where no scenario can express the recording.

    A learnt ramp is simulated as long as nominal, since `sweep_shape` covers the nominal ramp; the distance is the one
    that gives the line its phase on it. `remainder` is the material of a measured remainder, whose file lies beside it.
    """
    entries = [(e.effect, e.station, _values(e)) for e in effects]
    try:
        mapping = scenario_mapping(data, entries)
    except ConfigurationError:
        return None
    if bent is not None and bent.bends:
        longer = bent.over_nominal()[2]
        delay = float(bent.shape.delay[0]) * longer - sum(c.delay for c in data.calibration)
        distance = max(delay * SPEED_OF_LIGHT / float(data.refractive_index[0]), 0.0)
        stop = mapping['pairs'][0]['recorded']
        stop['distances'] = [distance] * len(stop['distances'])
        stop['steps'] = [0.0] * len(stop['steps'])
        m = bent.material
        station = mapping['stations'][m.station]
        slope = next((e.parameters['slope'].value for e in effects if e.effect == shown_by('slope')), 0.0)
        fading = np.mean(10.0 ** (-slope / 10.0 * np.linspace(0.0, 1.0, 100)))  # of the power, from the ramp's start
        full_scale = station['full_scale_power']
        station['rx_antenna_gain'] = float(m.decibels(bent.amplitude / math.sqrt(fading)) + full_scale)
        # a bent line spreads over the bins among which the chain measures noise
        density = m.decibels(math.sqrt(2.0) * m.white) + full_scale - 10.0 * math.log10(0.5 * m.rate)
        station['noise_floor'] = float(density + (10.0 * math.log10(0.5) if m.iq else 0.0))
    if remainder is not None:  # the measured remainder beside this file holds all lines
        station = mapping['stations'][remainder.station]
        full_scale = station['full_scale_power']
        station['tx_eirp'] = station['rx_antenna_gain'] = BACKGROUND.silent
        density = remainder.decibels(math.sqrt(2.0) * remainder.white) + full_scale
        station['noise_floor'] = float(density - 10.0 * math.log10((1.0 if remainder.iq else 0.5) * remainder.rate))
        mapping['measured'] = MODEL
    write_atomically(path, yaml.safe_dump(mapping, sort_keys=False, default_flow_style=None, width=120))
    return str(path)


def _values(effect: FoundEffect) -> dict[str, float | list[float]]:
    """Return parameters with their lists put together again."""
    values: dict[str, float | list[float]] = {}
    for name, estimate in effect.parameters.items():
        base, bracket, _ = name.partition('[')
        if bracket:
            listed = values.setdefault(base, [])
            assert isinstance(listed, list)
            listed.append(estimate.value)
        else:
            values[base] = estimate.value
    return values
