"""Work in a process of its own, one piece at a time, so that whoever gives it loses no message meanwhile."""

import contextlib
import multiprocessing
import os
import pickle
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any

_NICENESS = 10  # the graph comes first
_PATIENCE = 900.0  # for one result [s]


class WorkFailed(RuntimeError):
    """A piece of work whose process died or failed; the message says how."""


class Background:
    """Runs a generator function on one argument after another, each in a new process that takes its memory with it."""

    def __init__(self, work: Callable[[Any], Iterator[Any]]) -> None:
        """Take a function of an importable module; nothing is started yet."""
        self._work = work
        self._context = multiprocessing.get_context('spawn')  # a fork would copy the middleware's threads half
        self._results: queue.SimpleQueue = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._process: Any = None
        self._closed = False
        resource_tracker.ensure_running()  # its start would undo the mask below

    @property
    def busy(self) -> bool:
        """True while a piece of work is under way or its results have not been taken."""
        return self._thread is not None and (self._thread.is_alive() or not self._results.empty())

    def start(self, argument: Any) -> None:
        """Begin a piece of work; `argument` may change afterwards.

        Raises:
            RuntimeError: busy.
        """
        if self.busy:
            raise RuntimeError('one piece of work at a time')
        packed = pickle.dumps(argument, protocol=pickle.HIGHEST_PROTOCOL)
        self._thread = threading.Thread(target=self._attend, args=(packed,), daemon=True)
        self._thread.start()

    def results(self) -> Iterator[Any]:
        """Yield what has come since the last call.

        Raises:
            WorkFailed: the process died or failed.
        """
        with contextlib.suppress(queue.Empty):
            while True:
                result = self._results.get_nowait()
                if isinstance(result, WorkFailed):
                    raise result
                yield result

    def close(self) -> None:
        """End the work that is under way."""
        self._closed = True
        if self._process is not None:
            self._process.kill()
        if self._thread is not None:
            self._thread.join()

    def _attend(self, packed: bytes) -> None:
        """Start the process, and pass on what it sends until it ends."""
        # Ctrl-C reaches every process of the terminal; only the one that gives the work is to answer it
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        own, other = self._context.Pipe(duplex=False)
        process = self._context.Process(target=_serve, args=(other, self._work, packed), daemon=True)
        process.start()
        self._process = process
        other.close()
        if self._closed:
            process.kill()
        ended = ''
        with contextlib.suppress(EOFError, OSError):
            while own.poll(_PATIENCE):
                kind, content = own.recv()
                if kind == 'failed':
                    ended = content
                else:
                    self._results.put(content)
            ended = f'nothing came for {_PATIENCE:g} s'
            process.kill()
        own.close()
        process.join()
        if not ended and process.exitcode:
            code = process.exitcode
            ended = f'killed by {signal.Signals(-code).name}' if code < 0 else f'exit status {code}'
        if ended and not self._closed:
            self._results.put(WorkFailed(ended))


def _serve(connection: Connection, work: Callable[[Any], Iterator[Any]], packed: bytes) -> None:
    """Do a piece of work; in its process."""
    os.nice(_NICENESS)
    with contextlib.suppress(BrokenPipeError):
        try:
            for result in work(pickle.loads(packed)):
                connection.send(('result', result))
        except BrokenPipeError:
            raise
        except Exception as error:
            connection.send(('failed', f'{type(error).__name__}: {error}'))
