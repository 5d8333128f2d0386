"""Work on several items at once, in processes that start with all that this one has in memory."""

import concurrent.futures
import dataclasses
import multiprocessing
import signal
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

T = TypeVar('T')
R = TypeVar('R')

_work_on: Callable[[Any], Any] = repr
_items: Sequence[Any] = ()


@dataclasses.dataclass(frozen=True)
class Workers:
    """Processes for one task at a time; they are forked for it, so that only results travel."""

    count: int = 1

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> list[R]:
        """Return what `function` makes of each item, in order; here where there is nothing to share."""
        count = min(self.count, len(items))
        if count < 2:
            return [function(item) for item in items]
        context = multiprocessing.get_context('fork')
        with concurrent.futures.ProcessPoolExecutor(count, context, _begin, (function, items)) as pool:
            return list(pool.map(_work, range(len(items))))


def _begin(function: Callable[[Any], Any], items: Sequence[Any]) -> None:
    global _work_on, _items  # noqa: PLW0603 of a process that does nothing else
    for number in (signal.SIGINT, signal.SIGTERM):  # whoever started this one may handle them otherwise
        signal.signal(number, signal.SIG_DFL)
    _work_on, _items = function, items


def _work(number: int) -> Any:
    return _work_on(_items[number])
