"""Diagnoses recordings one beside the other, in processes or on a Dask cluster; a bad one does not cost the others."""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import TypeVar

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.bag.files import SKIP_DAMAGED
from drfmcw_ros.work.cluster import on_cluster
from drfmcw_ros.work.processes import WorkFailed, unordered

from ..engine import diagnose_dataset
from ..finding.result import Diagnosis
from ..recording.dataset import read_dataset
from .ramps import OneShape, known_ramps

A = TypeVar('A')
R = TypeVar('R')


@dataclasses.dataclass(frozen=True)
class Order:
    """One recording to be diagnosed, and how."""

    path: str
    out: str | None  # directory of its refined configuration
    pair: str | None
    false_alarm_rate: float
    without: tuple[str, ...]
    command: str
    together: tuple[str, ...] = ()  # all recordings, of which those of one radar share the shape of its ramp


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of one recording."""

    path: str
    diagnosis: Diagnosis | None
    error: str = ''  # one line, where there is no diagnosis
    shape: OneShape | None = None  # of a station that hears itself, whose ramp bends


@dataclasses.dataclass(frozen=True)
class Place:
    """Where the work is done."""

    jobs: int = 1  # processes on this machine
    scheduler: str | None = None  # address of a Dask scheduler, whose workers see the same files


def diagnosed(order: Order) -> Outcome:
    """Return the diagnosis of one recording, or why there is none; runs in the worker."""
    out = Path(order.out) if order.out else None
    rate, words = order.false_alarm_rate, order.command
    try:
        data = read_dataset(order.path, order.pair)
        ramps = known_ramps(order.together, order.pair) if data.topology.hears_itself else {}
        known = ramps.get(order.path)
        found = diagnose_dataset(
            data, rate, out, None, words, order.without, covariances=True, shared=known.ramp if known else None
        )
        return Outcome(order.path, found, shape=known.shape if known else None)
    except ConfigurationError as error:
        return Outcome(order.path, None, ' '.join(str(error).split()))
    except Exception as error:
        return Outcome(order.path, None, f'{order.path}: {type(error).__name__}: {" ".join(str(error).split())}')


def diagnose_each(
    orders: Sequence[Order], place: Place, done: Callable[[int], None], note: Callable[[str], None]
) -> list[Outcome]:
    """Return what became of each recording, in order.

    Args:
        orders: the recordings.
        place: where the work is done.
        done: called with the number of recordings done.
        note: called with a line that the user should see.

    Raises:
        ConfigurationError: the Dask scheduler does not answer.
    """
    found = each(diagnosed, orders, place, done, note)
    return [
        outcome if outcome is not None else Outcome(order.path, None, f'{order.path}: its worker process died')
        for order, outcome in zip(orders, found, strict=True)
    ]


def each(
    function: Callable[[A], R],
    items: Sequence[A],
    place: Place,
    done: Callable[[int], None],
    note: Callable[[str], None],
) -> list[R | None]:
    """Return what `function` makes of each item, None of an item that kills its process.

    Where a process dies, the items that are left go on one by one, which shows the bad one.

    Raises:
        ConfigurationError: the Dask scheduler does not answer.
    """
    found: dict[int, R] = {}
    function = functools.partial(_reading, function, SKIP_DAMAGED.get())

    def take(work: Generator[tuple[int, R], None, None], numbers: Sequence[int]) -> None:
        with contextlib.closing(work):
            for number, result in work:
                found[numbers[number]] = result
                done(len(found))

    everything = range(len(items))
    try:
        if place.scheduler is not None:
            take(on_cluster(function, items, place.scheduler, note), everything)
        else:
            take(_in_processes(function, items, place.jobs), everything)
    except WorkFailed as error:
        note(f'{error}; going on with one recording at a time, here')
        for number in sorted(set(everything) - set(found)):
            with contextlib.suppress(WorkFailed):
                take(_in_processes(function, [items[number]], 1), [number])
    return [found.get(number) for number in everything]


def _in_processes(function: Callable[[A], R], items: Sequence[A], count: int) -> Generator[tuple[int, R], None, None]:
    return unordered(functools.partial(function), items, count)


def _reading(function: Callable[[A], R], skip_damaged: bool, item: A) -> R:
    """Return what `function` makes of an item, with `--skip-damaged` as it is here, which no other process knows."""
    before = SKIP_DAMAGED.set(skip_damaged)
    try:
        return function(item)
    finally:
        SKIP_DAMAGED.reset(before)
