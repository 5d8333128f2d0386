"""Speed on one core, of ours and of what it is compared with, in turns: what slows the machine meets both.

Seconds are those of CPU time: other processes on the core do not count.
"""

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Mapping

from rich.console import Console
from rich.progress import track

_SLICE = 0.2  # length of one measurement [s]
_REPEATS = 3, 9  # at least, at most


@contextlib.contextmanager
def one_core() -> Iterator[None]:
    """Keep this process on one core."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def rates(jobs: Mapping[str, Callable[[], int]], seconds: float, console: Console, title: str) -> dict[str, float]:
    """Return what each job gets done per second on one core, the best of several measurements taken in turns.

    Args:
        jobs: by name; each call does a part and returns how many.
        seconds: for all of them, roughly.
        console: for the progress bar.
        title: of the bar.
    """
    least, most = _REPEATS
    repeats = min(max(round(seconds / (_SLICE * len(jobs))), least), most)
    best = dict.fromkeys(jobs, 0.0)
    with one_core():
        for job in jobs.values():  # the first call fills caches and loads modules
            job()
        for _ in track(range(repeats), description=title, console=console, transient=True):
            for name, job in jobs.items():
                done, start = 0, time.process_time()
                while (elapsed := time.process_time() - start) < _SLICE:
                    done += job()
                best[name] = max(best[name], done / elapsed)
    return best
