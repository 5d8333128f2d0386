"""Runs what is missing of a study: in this process, in several, or on a Dask cluster."""

import contextlib
import functools
from collections.abc import Callable, Generator, Mapping, Sequence

import numpy as np

from drfmcw_ros.work.cluster import on_cluster
from drfmcw_ros.work.processes import WorkFailed, unordered

from .batch import attempt, order, result
from .results import ResultDirectory
from .study import Job, Study, StudyStopped, Task


def run(
    results: ResultDirectory,
    task: Task,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
    note: Callable[[str], None] = lambda text: None,
) -> None:
    """Do what is missing of a study.

    Args:
        results: of the study, entered.
        task: makes the trials; a function of an importable module.
        jobs: processes on this machine; 1 works in this one.
        scheduler: address of a Dask scheduler, whose workers then do the work.
        progress: called with the number of trials done.
        note: called with a line that the user should see.

    Raises:
        ConfigurationError: the task refuses a point, or the scheduler does not answer.
        StudyStopped: a worker died, or the task failed.
        KeyboardInterrupt: on Ctrl-C, workers ended.
    """
    missing = results.missing()
    done = results.study.total - sum(len(job.sweeps) for job in missing)
    progress(done)
    if not missing:
        return
    if scheduler is not None:
        work = _on_cluster(results.study, task, missing, scheduler, note)
    elif jobs > 1:
        work = _in_processes(results.study, task, missing, min(jobs, len(missing)))
    else:
        work = _here(results.study, task, missing)
    with contextlib.closing(work):  # ends the workers, whatever happens
        for job, arrays in work:
            results.store(job, arrays)
            done += len(job.sweeps)
            progress(done)


_Finished = Generator[tuple[Job, Mapping[str, np.ndarray]], None, None]


def _here(study: Study, task: Task, jobs: Sequence[Job]) -> _Finished:
    for job in jobs:
        yield job, result(attempt(task, order(study, job)))


def _in_processes(study: Study, task: Task, jobs: Sequence[Job], count: int) -> _Finished:
    """Yield what `count` processes finish, as it comes; each has one batch to do and one waiting."""
    orders = [order(study, job) for job in jobs]
    try:
        for number, outcome in unordered(functools.partial(attempt, task), orders, count, waiting=1):
            yield jobs[number], result(outcome)
    except WorkFailed as error:
        raise StudyStopped(f'a worker process died ({error})') from None


def _on_cluster(study: Study, task: Task, jobs: Sequence[Job], address: str, note: Callable[[str], None]) -> _Finished:
    """Yield what the workers of a Dask cluster finish, as it comes."""
    orders = [order(study, job) for job in jobs]
    try:
        for number, outcome in on_cluster(functools.partial(attempt, task), orders, address, note):
            yield jobs[number], result(outcome)
    except WorkFailed as error:
        raise StudyStopped(str(error)) from None
