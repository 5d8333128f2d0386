"""Points of a Monte Carlo study: a scenario with some of its settings, or the evaluation's, varied over a grid.

A point is a JSON-ready mapping with the keys `varied` (key: value as given), `scenario`, `estimator` and `fusion`
(what their YAML would hold), and `seed`, which replaces the scenario's. Free of ROS.
"""

import copy
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drfmcw_fusion.settings import FusionSettings
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.rules.mode import choose_mode
from drfmcw_physics.settings import ConfigurationError, from_mapping
from drfmcw_physics.sweep import Mode
from drfmcw_sim.scenario import Scenario, override, scenario_from_mapping
from drfmcw_sim.trajectory import Drive

from .measurement import Trials, measure
from .trials.study import point_seed

_EVALUATION = {'estimator': EstimatorSettings, 'fusion': FusionSettings}
_LARGEST_GRID = 1_000_000
_STATION_NAMES = ('first', 'second')
_STATION_FIELDS = ('flags', 'frequency', 'frequency_std', 'phase', 'power', 'snr')


def values_of(text: str) -> tuple[str, list[str]]:
    """Return (key, values) of ``KEY=a:b:step`` (both ends included) or ``KEY=v1,v2,v3``.

    Raises:
        ConfigurationError: neither of both, or a step that does not lead from a to b.
    """
    key, equals, given = text.partition('=')
    if not equals or not key or not given:
        raise ConfigurationError(f"--vary '{text}': expected KEY=first:last:step or KEY=value,value,...")
    if ':' not in given:
        return key, given.split(',')
    try:
        first, last, step = (float(part) for part in given.split(':'))
        count = math.floor((last - first) / step + 1e-6) + 1
    except (ValueError, ZeroDivisionError, OverflowError):
        raise ConfigurationError(f"--vary '{text}': expected three numbers, KEY=first:last:step") from None
    if not 1 <= count <= _LARGEST_GRID:
        raise ConfigurationError(f"--vary '{text}': the step does not lead from {first:g} to {last:g}")
    return key, [f'{first + i * step:.12g}' for i in range(count)]


def grid(
    mapping: Mapping[str, Any], varied: Sequence[tuple[str, Sequence[str]]], assignments: Sequence[str], seed: int
) -> list[dict[str, Any]]:
    """Return the points of the full grid, the last key varying fastest.

    Equal scenarios get equal random numbers, so that estimators and settings of the fusion are compared on the same
    samples; different scenarios get independent ones.

    Args:
        mapping: a scenario as read from YAML.
        varied: (key, values). A key is one of the scenario (`section.key`, list items by number), `distance` of the
            first pair, `estimator.KEY` or `fusion.KEY`. Without `distance`, a pair that stands at several distances
            is tried at each of them.
        assignments: ``KEY=VALUE`` for all points.
        seed: of the study.

    Raises:
        ConfigurationError: a key given twice or unknown, or a value that is not valid.
    """
    keys = [key for key, _ in varied]
    _check_keys(keys)
    base: dict[str, Any] = {'varied': {}, 'scenario': copy.deepcopy(dict(mapping)), 'estimator': {}, 'fusion': {}}
    for assignment in assignments:
        _assign(base, assignment)
    varied = list(varied)
    if 'distance' not in keys:
        distances = _pair(base).get('standing', {}).get('distances', [])
        if isinstance(distances, list) and len(distances) > 1:
            varied.insert(0, ('distance', [str(d) for d in distances]))
    if math.prod(len(values) for _, values in varied) > _LARGEST_GRID:
        raise ConfigurationError(f'--vary: more than {_LARGEST_GRID} points')
    points = []
    for chosen in itertools.product(*(values for _, values in varied)):
        point = copy.deepcopy(base)
        for (key, _), value in zip(varied, chosen, strict=True):
            _assign(point, f'{key}={value}')
            point['varied'][key] = value
        for key in ('seed', 'description'):
            point['scenario'].pop(key, None)
        point['seed'] = point_seed(seed, point['scenario'])
        settings(point)  # refuses what is not valid before anything is tried
        points.append(point)
    return points


def _check_keys(keys: Sequence[str]) -> None:
    for key in keys:
        if keys.count(key) > 1:
            raise ConfigurationError(f"--vary: '{key}' is given twice")
        if key == 'seed':
            raise ConfigurationError("--vary: 'seed' is that of the whole study: --seed")


def _assign(point: dict[str, Any], assignment: str) -> None:
    """Apply one KEY=VALUE to a point, in place."""
    key, _, value = assignment.partition('=')
    if key == 'distance':
        pair = _pair(point)
        pair.pop('drive', None)
        pair.pop('standing', None)
        override(point['scenario'], f'pairs.0.standing.distances=[{value}]')
    elif key.partition('.')[0] in _EVALUATION:
        override(point, assignment)
    else:
        override(point['scenario'], assignment)


def _pair(point: Mapping[str, Any]) -> dict[str, Any]:
    """Return the mapping of the scenario's first pair, empty where there is none (which is refused later)."""
    pairs = point['scenario'].get('pairs')
    return pairs[0] if isinstance(pairs, list) and pairs and isinstance(pairs[0], dict) else {}


def settings(point: Mapping[str, Any]) -> tuple[Scenario, EstimatorSettings, FusionSettings]:
    """Return a point's settings.

    Raises:
        ConfigurationError: unknown key or wrong value; names the point.
    """
    where = ', '.join(f'{key}={value}' for key, value in point['varied'].items()) or 'scenario'
    scenario = scenario_from_mapping({**point['scenario'], 'seed': point['seed']}, where)
    estimator, fusion = (from_mapping(cls, point[key], f'{where}: {key}') for key, cls in _EVALUATION.items())
    return scenario, estimator, fusion


def distance_and_mode(scenario: Scenario) -> tuple[float, Mode]:
    """Return where the crane of the first pair stands [m] (a drive: where it begins), and the mode used there."""
    trajectory = scenario.pairs[0].trajectory
    distance = (trajectory.waypoints if isinstance(trajectory, Drive) else trajectory.distances)[0]
    return distance, choose_mode(None, distance, scenario.mode)


def try_point(point: Mapping[str, Any], sweeps: range) -> dict[str, np.ndarray]:
    """Return the trials with these sweep numbers: the task of `drfmcw_study.trials`."""
    scenario, estimator, fusion = settings(point)
    _, mode = distance_and_mode(scenario)
    return as_arrays(measure(scenario, sweeps, mode=mode, estimator=estimator, fusion=fusion))


def as_arrays(trials: Trials) -> dict[str, np.ndarray]:
    """Return what is stored of trials: the fields of `Trials`, and those of both stations as `first_*`, `second_*`."""
    arrays = {
        name: getattr(trials, name)
        for name in ('sweep_id', 'true_range', 'range', 'range_std', 'flags', 'carrier_phase')
    }
    for station, estimates in zip(_STATION_NAMES, trials.stations, strict=False):
        arrays |= {f'{station}_{name}': getattr(estimates, name) for name in _STATION_FIELDS}
    return arrays
