"""What all sources of sweeps share: a thread that hands over lists of what it got, in order.

A source delivers frames, or sweeps with their settings.
"""

import threading
from collections.abc import Callable, Sequence
from typing import Any

from .feed import Request

POLL = 0.2
"""How often a source's thread looks whether it shall end [s]."""

BATCH = 64
"""Sweeps handed over at once."""


class Source:
    """A thread that delivers; subclasses fill in `_run`."""

    def __init__(self, deliver: Callable[[Sequence[Any]], None], failed: Callable[[Exception], None]) -> None:
        """Set up without starting.

        Args:
            deliver: called in the source's thread with each list of what came.
            failed: called once with an exception that ended the thread.
        """
        self._deliver, self._failed = deliver, failed
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._guarded, name=type(self).__name__, daemon=True)
        self.connected = False
        """True while data can come."""

    def start(self) -> None:
        """Begin to deliver."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._ended.set()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(timeout=5.0)

    def counts(self) -> dict[str, int]:
        """Return what went wrong so far, for diagnostics."""
        return {}

    def request(self, request: Request) -> bool:
        """Pass a settings request to the hardware; return False where there is no way to."""
        return False

    def _guarded(self) -> None:
        try:
            self._run()
        except Exception as error:  # the node decides what an end of its source means
            self._failed(error)
        finally:
            self.connected = False

    def _run(self) -> None:
        raise NotImplementedError
