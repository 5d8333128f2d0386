"""Worker processes: how they start, what they do with signals, how their results and their end are reported.

Three ways to use them: `Workers.map` for a list of items, from processes that share this one's memory; `unordered` for
results in the order in which they come; `Worker` for a stream of results, and `Background` for one that nobody waits
for. All of them leave Ctrl-C, which reaches every process of a terminal, to the process that started them. No worker
outlives that process. Free of ROS.
"""

import contextlib
import dataclasses
import functools
import multiprocessing
import os
import pickle
import queue
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, Literal, TypeVar

A = TypeVar('A')
R = TypeVar('R')

Start = Literal['fork', 'forkserver', 'spawn']
"""How a process begins.

- 'fork': with all that this one has in memory, so that only results travel. Only while this one has no threads.
- 'forkserver': forked from a server that has imported some modules and nothing else; quick.
- 'spawn': with a new interpreter, which imports what it needs; takes about a second.
"""


class WorkFailed(RuntimeError):
    """Work that gave no result; the message says how, such as 'killed by SIGKILL' or 'nothing came for 900 s'."""


class Worker(Generic[A, R]):
    """A process that works on one argument after another; a context that ends it."""

    def __init__(
        self,
        work: Callable[[A], Iterable[R]],
        *,
        start: Start = 'spawn',
        preload: Sequence[str] = (),
        ahead: int = 0,
        niceness: int = 0,
    ) -> None:
        """Start the process.

        Args:
            work: yields results of an argument. Unless forked, a function of an importable module.
            start: how the process begins.
            preload: modules that the fork server imports when it starts, at the first use in this process.
            ahead: results that may wait to be taken while the process works on. With 0 it sends each one itself.
            niceness: added to that of this process.
        """
        context: Any = multiprocessing.get_context(start)
        if start == 'forkserver':
            context.set_forkserver_preload(list(preload))
        if start != 'fork':
            resource_tracker.ensure_running()  # its start would unblock the signal below
        self._connection: Connection
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, work, ahead, niceness), daemon=True)
        # The child inherits this thread's mask, so that Ctrl-C cannot reach it before it ignores the signal.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process.start()
        except BaseException:
            self._connection.close()
            raise
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            other.close()

    def __enter__(self) -> 'Worker[A, R]':
        return self

    def __exit__(self, *exception: object) -> None:
        """End the process."""
        self.close()

    @property
    def connection(self) -> Connection:
        """What becomes readable when a result has come or the process has died."""
        return self._connection

    def give(self, argument: A) -> None:
        """Hand over an argument, to be worked on after those given before.

        Raises:
            WorkFailed: the process has died.
        """
        self.give_packed(_packed(argument))

    def give_packed(self, packed: bytes) -> None:
        """Hand over a pickled argument; see `give`."""
        try:
            self._connection.send_bytes(packed)
        except OSError:
            raise self._death() from None

    def results(self, patience: float | None = None) -> Iterator[R]:
        """Yield the results of the first argument whose results have not been taken.

        Args:
            patience: longest wait for one result [s]; None waits for ever.

        Raises:
            WorkFailed: the process died or called `sys.exit`, or a result took too long.
            Exception: whatever the work raised.
        """
        while True:
            kind, content = pickle.loads(self._receive(patience))
            if kind == 'error':
                raise content
            if kind == 'end':
                return
            yield content

    def kill(self) -> None:
        """End the process at once, from any thread; whoever waits for its results gets `WorkFailed`."""
        self._process.kill()

    def close(self) -> None:
        """End the process at once, and wait for that."""
        self._process.kill()
        self._process.join()
        self._connection.close()

    def _receive(self, patience: float | None) -> bytes:
        try:
            if self._connection.poll(patience):
                return self._connection.recv_bytes()
        except (EOFError, OSError):
            raise self._death() from None
        self._process.kill()
        raise WorkFailed(f'nothing came for {patience:g} s')

    def _death(self) -> WorkFailed:
        self._process.join()
        code = self._process.exitcode
        return WorkFailed(f'killed by {signal.Signals(-code).name}' if code < 0 else f'exit status {code}')


def unordered(
    function: Callable[[A], R],
    items: Sequence[A],
    count: int,
    *,
    waiting: int = 0,
    start: Start = 'spawn',
    preload: Sequence[str] = (),
) -> Generator[tuple[int, R], None, None]:
    """Yield (index of the item, what `function` makes of it) as results come; ends the processes when closed.

    Args:
        function: of an item. Unless forked, a function of an importable module.
        items: in the order in which they are begun.
        count: processes.
        waiting: items that each process has at hand beside the one it works on; none balances the load best.
        start: how the processes begin.
        preload: modules that the fork server imports.

    Raises:
        WorkFailed: a process died.
        Exception: whatever the function raised.
    """
    left = iter(enumerate(items))
    with contextlib.ExitStack() as stack:
        doing: dict[Worker[A, R], deque[int]] = {}
        for _ in range(min(count, len(items))):
            worker = Worker(functools.partial(_single, function), start=start, preload=preload, ahead=waiting)
            doing[stack.enter_context(worker)] = deque()

        def hand_out(worker: Worker[A, R]) -> None:
            for number, item in left:
                worker.give(item)
                doing[worker].append(number)
                return

        for _ in range(1 + waiting):
            for worker in doing:
                hand_out(worker)
        while busy := {worker.connection: worker for worker in doing if doing[worker]}:
            ready = wait(busy)
            for worker in (busy[connection] for connection in busy if connection in ready):
                number = doing[worker].popleft()
                [result] = worker.results()
                hand_out(worker)
                yield number, result


@dataclasses.dataclass(frozen=True)
class Workers:
    """Forked processes for one list of items at a time."""

    count: int = 1

    def map(self, function: Callable[[A], R], items: Sequence[A]) -> list[R]:
        """Return what `function` makes of each item, in order.

        One process, one item, or a process that is a worker itself does the work here.

        Args:
            function: of an item; it and the items stay in memory, only results are pickled.
            items: of which those in front are begun first.

        Raises:
            WorkFailed: a process died.
            Exception: whatever the function raised.
        """
        if min(self.count, len(items)) < 2 or multiprocessing.current_process().daemon:
            return [function(item) for item in items]
        numbers = range(len(items))
        found = dict(unordered(lambda number: function(items[number]), numbers, self.count, start='fork'))
        return [found[number] for number in numbers]


class Background(Generic[A, R]):
    """Work on one argument at a time whose results are taken when they are there, for whoever must not wait.

    Each argument gets a new process, which takes its memory with it.
    """

    def __init__(self, work: Callable[[A], Iterable[R]], niceness: int = 10, patience: float = 900.0) -> None:
        """Start nothing yet.

        Args:
            work: yields results; a function of an importable module.
            niceness: added to that of this process.
            patience: longest wait for one result [s].
        """
        self._work, self._niceness, self._patience = work, niceness, patience
        self._results: queue.SimpleQueue[R | WorkFailed] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._worker: Worker[A, R] | None = None
        self._closed = False

    @property
    def busy(self) -> bool:
        """True while work is under way or its results have not been taken."""
        return self._thread is not None and (self._thread.is_alive() or not self._results.empty())

    def start(self, argument: A) -> None:
        """Begin to work on an argument, which may change afterwards.

        Raises:
            RuntimeError: busy.
        """
        if self.busy:
            raise RuntimeError('one piece of work at a time')
        self._thread = threading.Thread(target=self._attend, args=(_packed(argument),), daemon=True)
        self._thread.start()

    def results(self) -> Iterator[R]:
        """Yield what has come since the last call.

        Raises:
            WorkFailed: the work failed, its process died, or a result took too long.
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
        if self._worker is not None:
            self._worker.kill()
        if self._thread is not None:
            self._thread.join()

    def _attend(self, packed: bytes) -> None:
        """Start the process, and pass on what it sends until it ends; in a thread of its own."""
        try:
            with Worker(self._work, niceness=self._niceness) as worker:
                self._worker = worker
                if self._closed:  # before there was a worker to kill
                    return
                worker.give_packed(packed)
                for result in worker.results(self._patience):
                    self._results.put(result)
        except Exception as error:
            if not self._closed:
                if not isinstance(error, WorkFailed):
                    error = WorkFailed(f'{type(error).__name__}: {error}')
                self._results.put(error)


# --- in the worker ---


def _serve(connection: Connection, work: Callable[[Any], Iterable[Any]], ahead: int, niceness: int) -> None:
    """Work on what comes; the whole life of a worker process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a forked process inherits handlers
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.nice(niceness)
    send = _Sender(connection, ahead) if ahead else connection.send_bytes
    with contextlib.suppress(EOFError, OSError):  # of the connection: nobody wants the results any more
        while True:
            for message in _messages(work, connection.recv_bytes()):
                send(message)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


class _Sender:
    """Sends messages from a thread of its own; at most `ahead` wait for it."""

    def __init__(self, connection: Connection, ahead: int) -> None:
        self._connection = connection
        self._waiting: queue.Queue[bytes] = queue.Queue(ahead)
        threading.Thread(target=self._send, daemon=True).start()

    def __call__(self, message: bytes) -> None:
        self._waiting.put(message)

    def _send(self) -> None:
        try:
            while True:
                self._connection.send_bytes(self._waiting.get())
        except OSError:  # nobody wants the results any more
            os._exit(1)


def _messages(work: Callable[[Any], Iterable[Any]], packed: bytes) -> Iterator[bytes]:
    """Yield the results of an argument, each as ('result', it), then ('end', None) or ('error', an exception)."""
    try:
        for result in work(pickle.loads(packed)):
            yield _packed(('result', result))
        yield _packed(('end', None))
    except SystemExit as error:
        yield _packed(('error', WorkFailed(f'exit status {error.code}')))
    except Exception as error:
        error.add_note(f'In a worker process:\n{traceback.format_exc()}')
        try:
            message = _packed(('error', error))
            pickle.loads(message)
        except Exception:  # an exception that cannot travel
            message = _packed(('error', WorkFailed(f'{type(error).__name__}: {error}')))
        yield message


def _packed(content: Any) -> bytes:
    return pickle.dumps(content, protocol=pickle.HIGHEST_PROTOCOL)


def _single(function: Callable[[A], R], item: A) -> Iterator[R]:
    yield function(item)
