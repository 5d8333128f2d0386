"""Work on several items at once, in processes that start with all that this one has in memory."""

import dataclasses
import multiprocessing
import signal
from collections.abc import Callable, Sequence
from typing import TypeVar

T = TypeVar('T')
R = TypeVar('R')

_function: Callable | None = None
_items: Sequence = ()


@dataclasses.dataclass(frozen=True)
class Workers:
    """Processes for one task at a time; they are forked for it, so that only results travel."""

    count: int = 1

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> list[R]:
        """Return what `function` makes of each item, in order; here where there is nothing to share."""
        count = min(self.count, len(items))
        if count < 2:
            return [function(item) for item in items]
        with multiprocessing.get_context('fork').Pool(count, _begin, (function, items)) as pool:
            return pool.map(_work, range(len(items)), chunksize=1)


def _begin(function: Callable, items: Sequence) -> None:
    global _function, _items  # noqa: PLW0603 of a process that does nothing else
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that shares out the work
    _function, _items = function, items


def _work(number: int):
    return _function(_items[number])
