"""What of a long recording is compared: enough for every effect, and no more than the model is good for."""

import dataclasses

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError

from .dataset import Dataset
from .limits import THINNING


def representative(group: np.ndarray) -> np.ndarray:
    """Return the sweeps to compare, spread evenly over all groups and over each of them (m,), in order.

    Args:
        group: number of each sweep's group (n,), see `Dataset.group`.
    """
    numbers = np.unique(group)
    kept = numbers[_spread(len(numbers), THINNING.groups)]
    rows = (np.flatnonzero(group == number) for number in kept)
    return np.concatenate([r[_spread(len(r), THINNING.sweeps)] for r in rows])


def shortened(data: Dataset) -> Dataset:
    """Return the sweeps of a station that hears itself without what is too long to be compared, others as they are.

    Args:
        data: sweeps; the first samples of each are kept, and what is left out is said in `missing`.

    Raises:
        ConfigurationError: the echo of the line would come after the end of the sweep.
    """
    if not data.topology.hears_itself:
        return data
    delay = float(np.median(data.distance * data.refractive_index)) / SPEED_OF_LIGHT + data.calibration[0].delay
    lasts = min(min(s.ramp_duration, s.record_duration) for (s,) in data.sweeps)
    if delay >= lasts:
        raise ConfigurationError(
            f'{data.path}: the line would be an echo after {delay * 1e6:.4g} us, but a sweep lasts {lasts * 1e6:.4g} '
            'us: bandwidth, ramp_duration or sample_rate of its settings is wrong'
        )
    rate = max(s.sample_rate for (s,) in data.sweeps)
    parts = data.topology.parts
    count = data.samples_of(0).shape[1] // parts
    most = max(THINNING.samples, round(THINNING.delays * delay * rate))
    if count <= most:
        return data
    sweeps = tuple(tuple(dataclasses.replace(s, sample_count=most) for s in each) for each in data.sweeps)
    said = f'Compared: the first {most} of {count} samples of each sweep; what happens later in it is not tested.'
    return dataclasses.replace(
        data, samples=(data.samples_of(0)[:, : parts * most],), sweeps=sweeps, missing=(*data.missing, said)
    )


def _spread(count: int, most: int) -> np.ndarray:
    """Return at most so many of `count` numbers, evenly spaced."""
    return np.unique(np.round(np.linspace(0, count - 1, min(count, most))).astype(int))
