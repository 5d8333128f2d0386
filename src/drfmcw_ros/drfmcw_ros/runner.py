"""Running a node as a process: start, spin, and a clean end on Ctrl-C, SIGTERM or a wrong configuration."""

import gc
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from drfmcw_physics.settings import ConfigurationError


class Finished(Exception):
    """Raised inside a callback by a node that has done its work: the process ends with status 0."""


def run(node_class: Callable[..., Node], argv: Sequence[str] | None = None, **kwargs: Any) -> int:
    """Run one node until it finishes or a signal stops it; return the exit status.

    Args:
        node_class: node class or function returning a node; called with `kwargs`.
        argv: command line without program name, ``--ros-args`` included; None takes sys.argv.
        kwargs: passed on.

    Returns:
        0 after a clean end, 2 after a wrong configuration (one line on stderr names it).
    """
    rclpy.init(args=None if argv is None else [sys.argv[0], *argv], signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGINT, _stop)
    signal.signal(signal.SIGTERM, _stop)
    node = None
    try:
        node = node_class(**kwargs)
        executor = SingleThreadedExecutor()  # rclpy 7.1's EventsExecutor keeps a core busy without serving
        executor.add_node(node)
        gc.freeze()  # what was made so far stays: not to be looked through again between sweeps
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException, Finished):
        pass
    except (ConfigurationError, InvalidParameterValueException, InvalidParameterTypeException) as error:
        print(f'drfmcw: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    finally:
        # a second signal while cleaning up must not end in a traceback
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _stop(signum: int, frame: Any) -> None:
    raise KeyboardInterrupt
