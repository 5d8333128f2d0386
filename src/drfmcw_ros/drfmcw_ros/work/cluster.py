"""Work on a Dask cluster: its results as they come, and a notice when its workers or its scheduler are gone."""

import contextlib
import importlib
import logging
import queue
import time
from collections.abc import Callable, Generator, Sequence
from typing import Any, TypeVar

from drfmcw_physics.settings import ConfigurationError

from .processes import WorkFailed

A = TypeVar('A')
R = TypeVar('R')

_CONNECT_LIMIT = 15.0  # how long a Dask scheduler may take to answer [s]
_WORKER_LIMIT = 30.0  # how long a Dask cluster may be without any worker [s]
_LOOK_INTERVAL = 1.0  # between two looks at a Dask cluster [s]


def on_cluster(
    function: Callable[[A], R], items: Sequence[A], address: str, note: Callable[[str], None]
) -> Generator[tuple[int, R], None, None]:
    """Yield (index of the item, what `function` makes of it) as the workers of a Dask cluster finish.

    Dask gives the items of a worker that dies to others, up to its limit for items that kill their workers.

    Args:
        function: of an importable module.
        items: in the order in which they are begun.
        address: of the scheduler, tcp://host:port.
        note: called with a line that the user should see.

    Raises:
        ConfigurationError: no scheduler answers at that address.
        WorkFailed: the scheduler or all workers are gone, or the function raised.
    """
    if not address.rpartition(':')[2].isdigit():
        raise ConfigurationError(f'--scheduler {address}: expected an address like tcp://host:8786')
    distributed: Any = importlib.import_module('distributed')  # takes half a second; needed here alone

    for name in list(logging.root.manager.loggerDict):
        if name.partition('.')[0] == 'distributed':  # we report what matters in one line
            logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        distributed.comm.resolve_address(address)  # a client made for a wrong one does not end quietly
        client = distributed.Client(address, timeout=_CONNECT_LIMIT, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigurationError(f'--scheduler {address}: no Dask scheduler answers: {error}') from None
    finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
    left = list(reversed(range(len(items))))
    doing: dict[str, tuple[int, Any]] = {}
    try:
        cluster = _Cluster(client, address, note)
        while left or doing:
            while left and len(doing) < 2 * cluster.threads + 2:
                number = left.pop()
                future = client.submit(function, items[number], pure=False)
                doing[future.key] = (number, future)
                future.add_done_callback(finished.put)
            with contextlib.suppress(queue.Empty):
                future = finished.get(timeout=_LOOK_INTERVAL)
                number, _ = doing.pop(future.key)
                if future.status != 'finished':
                    raise cluster.failure(future)
                yield number, future.result()
            cluster.look()
    except (OSError, TimeoutError):  # of the connection
        raise WorkFailed(f'the Dask scheduler at {address} is gone') from None
    finally:
        with contextlib.suppress(Exception):  # a scheduler that is gone has nothing left to cancel
            client.cancel([future for _, future in doing.values()])
        client.close(timeout=2)


class _Cluster:
    """Watches a Dask cluster, so that nobody waits for workers that are gone."""

    def __init__(self, client: Any, address: str, note: Callable[[str], None]) -> None:
        self.threads = 0  # of all workers
        self._client, self._address, self._note = client, address, note
        self._workers: set[str] = set()
        self._looked = self._worked = time.monotonic()
        self._look()

    def look(self) -> None:
        """Notice what has changed, at most once a second.

        Raises:
            WorkFailed: the scheduler is gone, or there has been no worker for long.
        """
        if time.monotonic() - self._looked > _LOOK_INTERVAL:
            self._look()

    def _look(self) -> None:
        try:
            threads = self._client.nthreads()
        except Exception:  # whatever it is that Dask raises: the scheduler does not answer
            raise WorkFailed(f'the Dask scheduler at {self._address} is gone') from None
        self._looked = time.monotonic()
        for worker in sorted(self._workers - set(threads)):
            self._note(f'worker {worker} is gone; others do its work')
        if not threads and (self._workers or not self.threads):
            self._note(f'{self._address} has no workers; waiting {_WORKER_LIMIT:g} s for one')
        self._workers, self.threads = set(threads), sum(threads.values()) or 1
        if threads:
            self._worked = self._looked
        elif self._looked - self._worked > _WORKER_LIMIT:
            raise WorkFailed(f'the Dask scheduler at {self._address} has no workers')

    def failure(self, future: Any) -> WorkFailed:
        """Return why an item did not come back."""
        if future.status == 'error':
            error = future.exception()
            return WorkFailed(f'work on the cluster failed: {type(error).__name__}: {error}')
        return WorkFailed(f'the Dask scheduler at {self._address} is gone')
