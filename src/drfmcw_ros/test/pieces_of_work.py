"""Work for other processes in tests: a module of its own, so that they need not import a test's own modules."""

import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path


def count_up(limit: int) -> Iterator[int]:
    """Give numbers."""
    yield from range(limit)


def process_and_niceness(_: object) -> Iterator[int]:
    """Give the process's number, then its niceness."""
    yield os.getpid()
    yield os.nice(0)


class Untransferable(Exception):
    """Cannot be unpickled: its constructor wants more than its message."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first + second)


def fail(reason: str) -> Iterator[str]:
    """Give one result, then end or raise an error."""
    yield 'begun'
    match reason:
        case 'exit':
            os._exit(3)
        case 'sys.exit':
            sys.exit(4)
        case 'kill':
            os.kill(os.getpid(), signal.SIGKILL)
        case 'untransferable':
            raise Untransferable('two', ' parts')
        case _:
            raise ValueError(reason)


def sleep_long(_: object) -> Iterator[str]:
    """Give one result and no other for very long."""
    yield 'begun'
    time.sleep(1000.0)


def note_each(folder: str) -> Iterator[int]:
    """Give numbers without end; each leaves a file before it is given."""
    number = 0
    while True:
        (Path(folder) / str(number)).touch()
        yield number
        number += 1


def power_of_two(number: int) -> int:
    """Return a power of two; 13 is refused, 14 kills the process."""
    if number == 13:
        raise ValueError('not 13')
    if number == 14:
        os.kill(os.getpid(), signal.SIGKILL)
    return 2**number
