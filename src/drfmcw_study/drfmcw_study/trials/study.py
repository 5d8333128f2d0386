"""What is to be tried: points, trials at each, batches; free of ROS and of what is tried."""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError

Task = Callable[[Mapping[str, Any], range], Mapping[str, np.ndarray]]
"""Makes the trials with given sweep numbers at a point: arrays with one row per trial. Is pickled by its name."""


class StudyStopped(Exception):
    """The study ended before it was finished; the message is one line that says why. Batches done are kept."""


@dataclasses.dataclass(frozen=True)
class Study:
    """What is to be tried. Everything here, and nothing else, decides the results."""

    points: tuple[Mapping[str, Any], ...]  # JSON-ready, handed to the task
    trials: int  # at each point
    batch: int  # trials stored, merged and sent to a worker together
    packages: tuple[str, ...] = ()  # whose code makes the results: a result of other code is not mixed with this one's

    def __post_init__(self) -> None:
        """Refuse an empty study."""
        for name in ('trials', 'batch'):
            if getattr(self, name) < 1:
                raise ConfigurationError(f'{name} = {getattr(self, name)} must be at least 1')
        if not self.points:
            raise ConfigurationError('no points to try')

    @property
    def total(self) -> int:
        """Trials at all points together."""
        return self.trials * len(self.points)

    def jobs(self, point: int) -> list['Job']:
        """Return the batches of a point, in the order in which they are merged."""
        starts = range(0, self.trials, self.batch)
        return [Job(point, i, range(start, min(start + self.batch, self.trials))) for i, start in enumerate(starts)]


@dataclasses.dataclass(frozen=True)
class Job:
    """One batch."""

    point: int  # index into the study's points
    number: int  # of the batch at its point
    sweeps: range

    def file(self, directory: Path) -> Path:
        """Return where its results are."""
        return directory / f'point_{self.point:05d}' / f'batch_{self.number:07d}.npz'


def point_seed(seed: int, conditions: Any) -> int:
    """Return the seed of a point's random numbers: the same for the same conditions, independent for others.

    Args:
        seed: of the study.
        conditions: JSON-ready; what the trials are made of.
    """
    digest = hashlib.sha256(json.dumps(conditions, sort_keys=True, default=str).encode()).digest()
    words = np.frombuffer(digest, '<u4').tolist()
    return int(np.random.SeedSequence([seed, *words]).generate_state(1, np.uint64)[0] >> np.uint64(1))
