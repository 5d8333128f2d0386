"""One batch as a worker gets it and gives it back, in another process or on another machine."""

import functools
import platform
import traceback
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.versions import versions

from .results import difference
from .study import Job, Study, StudyStopped, Task

Outcome = tuple[Literal['done', 'refused', 'failed'], Any]
"""Arrays of a batch that is done, or one line that says why it is not."""

_versions = functools.cache(versions)  # of the code that this process has loaded


class Order(NamedTuple):
    """What a worker has to know of a batch."""

    point: Mapping[str, Any]
    sweeps: range
    packages: tuple[str, ...]
    versions: Mapping[str, str]  # that the worker must have too


def order(study: Study, job: Job) -> Order:
    """Return the order for a batch."""
    return Order(study.points[job.point], job.sweeps, study.packages, _versions(study.packages))


def attempt(task: Task, order: Order) -> Outcome:
    """Return the outcome of a batch; runs in the worker."""
    try:
        change = difference(dict(order.versions), _versions(order.packages))
        if change:
            return 'failed', f'other versions on {platform.node()} (here): {change}'
        return 'done', task(order.point, order.sweeps)
    except ConfigurationError as error:
        return 'refused', str(error)
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return 'failed', f'{type(error).__name__}: {error} ({last.filename}:{last.lineno})'


def result(outcome: Outcome) -> Mapping[str, np.ndarray]:
    """Return the arrays of a batch.

    Raises:
        ConfigurationError: the task refuses the point.
        StudyStopped: the task failed.
    """
    verdict, content = outcome
    if verdict == 'refused':
        raise ConfigurationError(content)
    if verdict == 'failed':
        raise StudyStopped(f'a batch failed: {content}')
    return content
