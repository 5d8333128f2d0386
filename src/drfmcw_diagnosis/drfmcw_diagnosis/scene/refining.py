"""The simulator's configuration with the effects of a scene."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.cli import write_atomically

from ..finding.refined import scenario_mapping
from ..finding.result import FoundEffect
from ..recording.dataset import Dataset
from .evidence import shown_by
from .ramps.ramp import Ramp


def write_refined(path: Path, data: Dataset, effects: Sequence[FoundEffect], bent: Ramp | None) -> str | None:
    """Write the scenario with the effects found; return its path, None where no scenario can express the recording.

    A learnt ramp is simulated as long as nominal, since `sweep_shape` covers the nominal ramp; the distance is the one
    that gives the line its phase on it.
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
