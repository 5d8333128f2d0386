"""Work for other processes in tests: a module of its own, so that they need not import a test's own modules."""

import os
import time
from collections.abc import Iterator


def count_up(limit: int) -> Iterator[int]:
    """Give numbers."""
    yield from range(limit)


def fail(reason: str) -> Iterator[str]:
    """Give one result, then leave with a status or raise an error."""
    yield 'begun'
    if reason == 'exit':
        os._exit(3)
    raise ValueError(reason)


def sleep_long(_: object) -> Iterator[str]:
    """Give one result and no other for very long."""
    yield 'begun'
    time.sleep(1000.0)
