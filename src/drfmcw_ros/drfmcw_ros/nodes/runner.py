"""Running a node as a process: start, spin, and a clean end on Ctrl-C, SIGTERM or a wrong configuration."""

import contextlib
import gc
import os
import signal
import sys
import threading
import time
import traceback
import weakref
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from drfmcw_physics.settings import ConfigurationError

from ..commands import interrupts
from ..commands.cli import reason
from ..graph import streams
from ..operation.security import refuse_pretence
from ..operation.watchdog import Watchdog

RCLError: type[Exception] = rclpy_implementation.RCLError
_TURN = 0.05  # of a node's streams while messages flow, and at most then of everything else [s]
_LOG_INTERVAL = 10.0  # between two lines about failing callbacks [s]
_JOIN_LIMIT = 2.0  # for a callback that runs while its thread is to end [s]


class Finished(Exception):
    """Raised inside a callback by a node that has done its work: the process ends with status 0."""


def run(node_class: Callable[..., Node], argv: Sequence[str] | None = None, **kwargs: Any) -> int:
    """Run one node until it finishes or a signal stops it; return the exit status.

    Args:
        node_class: node class or function returning a node; called with `kwargs`.
        argv: command line without program name, ``--ros-args`` included; None takes sys.argv.
        kwargs: passed on.

    An exception in a callback ends the callback, not the process: `spin` counts it and the diagnostics report it.

    Returns:
        0 after a clean end, 2 after a wrong configuration, 1 after an error of the operating system (one line on
        stderr names either).
    """
    try:
        refuse_pretence(os.environ)
    except ConfigurationError as error:
        print(f'drfmcw: {error}', file=sys.stderr)
        return 2
    watchdog = Watchdog(os.environ)
    interrupts.keep()
    _SIGNALS.clear()
    signal.signal(signal.SIGINT, _stop)
    signal.signal(signal.SIGTERM, _stop)
    node = None
    try:
        rclpy.init(args=None if argv is None else [sys.argv[0], *argv], signal_handler_options=SignalHandlerOptions.NO)
        node = node_class(**kwargs)
        executor = Executor()
        executor.add_node(node)
        watchdog.attach(node)
        gc.freeze()  # what was made so far stays: not to be looked through again between sweeps
        spin(executor, node)
    except (KeyboardInterrupt, ExternalShutdownException, Finished):
        pass
    except (ConfigurationError, InvalidParameterValueException, InvalidParameterTypeException) as error:
        print(f'drfmcw: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    except RCLError as error:  # of starting: arguments, parameter file, ROS_DOMAIN_ID
        if node is not None:
            raise
        print(f'drfmcw: {" ".join(str(error).split()).partition(", at /")[0]}', file=sys.stderr)
        return 2
    except BrokenPipeError:
        raise
    except OSError as error:  # a device that is not there yet: whoever supervises the node may try again
        print(f'drfmcw: {reason(error)}', file=sys.stderr)
        return 1
    finally:
        # a second signal while cleaning up must not end in a traceback
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        watchdog.stopping()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        interrupts.answered()
    return 0


class Failures:
    """Exceptions that callbacks of a node raised."""

    def __init__(self) -> None:
        """Start with none."""
        self.count = 0
        self.last = ''  # its text and where it was raised
        self._logged = -_LOG_INTERVAL

    def add(self, error: BaseException) -> None:
        """Count an exception and keep its text and location."""
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if 'drfmcw' in frame.filename] or frames
        where = f'{own[-1].filename.rpartition("/")[2]}:{own[-1].lineno} in {own[-1].name}' if own else 'unknown'
        text = ' '.join(str(error).split())[:200]
        self.count += 1
        self.last = f'{type(error).__name__}: {text} ({where})'

    def report(self, node: Node, error: BaseException) -> None:
        """Count an exception, and log it unless another one was logged just before."""
        self.add(error)
        if time.monotonic() - self._logged >= _LOG_INTERVAL:
            self._logged = time.monotonic()
            node.get_logger().error(f'a callback failed, {self.count} so far: {self.last}')


_FAILURES: weakref.WeakKeyDictionary[Node, Failures] = weakref.WeakKeyDictionary()


def failures(node: Node) -> Failures:
    """Return the failures of a node's callbacks, one object per node."""
    return _FAILURES.setdefault(node, Failures())


class Executor(SingleThreadedExecutor):
    """rclpy's, which can run what is ready and no more; its EventsExecutor 7.1 keeps a core busy without serving."""

    newest: Any = None
    """What the last callback was of: a subscription, a timer, ..."""

    _found = 0  # callbacks that were ready so far
    _sigint_gc: Any = None  # rclpy's destructor asks for it also where a Ctrl-C ended the constructor

    def wait_for_ready_callbacks(self, *args: Any, **kwargs: Any) -> Any:
        """Return the next callback that is ready, as rclpy has it."""
        found: Any = super().wait_for_ready_callbacks(*args, **kwargs)
        self._found, self.newest = self._found + 1, found[1]
        return found

    def spin_ready(self, seconds: float) -> None:
        """Run callbacks that are ready until none is, or for so long."""
        end, before = time.monotonic() + seconds, -1
        while self._found != before and time.monotonic() < end:
            before = self._found
            self.spin_once(timeout_sec=0.0)


def spin(executor: Executor, node: Node) -> None:
    """Run callbacks until shutdown; count, log and survive what one of them raises.

    Raises:
        KeyboardInterrupt: a signal.
        Finished: the node has done its work.
        ExternalShutdownException: the context was shut down.
    """
    flowing = False
    while rclpy.ok() and not _SIGNALS:
        try:
            if flowing:
                executor.spin_ready(_TURN)
            else:
                executor.spin_once()
                flowing = streams.has(node, executor.newest)
            flowing = flowing and streams.serve(node, _TURN)
        except (Finished, ExternalShutdownException):
            raise
        except Exception as error:
            if _SIGNALS:
                break
            failures(node).report(node, error)


@contextlib.contextmanager
def spinning(node: Node, *others: Node) -> Iterator[None]:
    """Run callbacks in a thread beside what the process does; count, log and survive what one of them raises.

    Ends with the context's shutdown, too.

    Args:
        node: whose callbacks run, and which logs failures.
        others: of the same context, whose callbacks run too.
    """
    executor = Executor(context=node.context)
    for each in (node, *others):
        executor.add_node(each)

    def turn() -> None:
        while True:
            try:
                executor.spin()
                return
            except ExternalShutdownException:
                return
            except Exception as error:
                failures(node).report(node, error)

    thread = threading.Thread(target=turn, daemon=True)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join(_JOIN_LIMIT)


_SIGNALS: list[int] = []
"""Those that `_stop` heard. Where a signal meets rclpy as it makes a message, C++ raises a RuntimeError instead."""


def _stop(signum: int, frame: Any) -> None:
    _SIGNALS.append(signum)
    raise KeyboardInterrupt
