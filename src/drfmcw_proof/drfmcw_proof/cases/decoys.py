"""What leads astray: conditions that look like a cause and are none, and causes with innocent companions."""

import dataclasses
from collections.abc import Callable

import numpy as np

from ..generator.condition import Condition
from .draws import Extent, both_stations, floats, random_condition


def _decoy_hot_null(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """Boards that follow the distance, and nothing else."""
    condition = random_condition(random, extent)
    hot = floats(20.0 + 0.02 * np.array(condition.distances))
    return dataclasses.replace(condition, board_temperature=(hot, hot)), ()


def _decoy_large_alphas(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """References 40 ppm apart, calibrated."""
    condition = random_condition(random, extent)
    first, second = condition.stations
    first = dataclasses.replace(first, alpha=1.0 + 20e-6, sample_clock_alpha=1.0 + 21e-6)
    second = dataclasses.replace(second, alpha=1.0 - 20e-6, sample_clock_alpha=1.0 - 18e-6)
    return dataclasses.replace(condition, stations=(first, second)), ()


def _decoy_sultry(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """Weather as humid as it gets, measured."""
    n = extent.settings
    weather = {
        'air_temperature': floats(random.uniform(30, 38, n)),
        'air_humidity': floats(random.uniform(0.8, 1, n)),
    }
    return random_condition(random, extent, **weather), ()


def _decoy_noisy(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """Strong noise of both kinds, reported as it is."""
    condition = random_condition(random, extent)
    return both_stations(condition, noise_floor=-130.0, phase_noise_level=-82.0, phase_noise_corner=200e3), ()


def _decoy_long_cables(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """Delays of 300 ns, calibrated."""
    condition = both_stations(random_condition(random, extent), delay=300e-9)
    return dataclasses.replace(condition, short_start_delay=4.0e-6), ()


def _decoy_covariate(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """The true cause's temperature and its innocent companions move together, but not quite."""
    condition = random_condition(random, extent)
    air = np.array(condition.air_temperature)
    boards = [floats(air + 10.0 + random.normal(0.0, 2.5, len(air))) for _ in range(2)]
    return dataclasses.replace(condition, board_temperature=(boards[0], boards[1])), ('reference_clock_temperature',)


def _decoy_delay_covariate(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """As before, with a delay that follows one board."""
    return _decoy_covariate(random, extent)[0], ('delay_temperature',)


def _decoy_cover(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """A ripple under references far apart, which are calibrated."""
    return _decoy_large_alphas(random, extent)[0], ('sweep_ripple',)


DECOYS: dict[str, Callable[[np.random.Generator, Extent], tuple[Condition, tuple[str, ...]]]] = {
    'boards follow distance': _decoy_hot_null,
    'calibrated alphas far apart': _decoy_large_alphas,
    'sultry weather': _decoy_sultry,
    'reported strong noise': _decoy_noisy,
    'calibrated long delays': _decoy_long_cables,
    'clock follows one of two boards': _decoy_covariate,
    'delay follows one of two boards': _decoy_delay_covariate,
    'ripple beside calibrated alphas': _decoy_cover,
}
"""What leads astray, by name: condition, and the effects that are truly there."""
