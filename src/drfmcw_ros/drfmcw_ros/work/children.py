"""Modules of drfmcw that run as children of this process: they end with it, and may be stopped while they start."""

import ctypes
import signal
import sys

_PR_SET_PDEATHSIG = 1  # of prctl(2)
_LIBRARY = ctypes.CDLL(None)


def command(module: str, *arguments: str) -> list[str]:
    """Return the command line of a module."""
    return [sys.executable, '-m', 'drfmcw_ros.commands.begin', module, *arguments]


def prepare() -> None:
    """In the new process: let SIGINT wait for `commands.begin`, and get one when the parent dies, even by kill -9."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    _LIBRARY.prctl(_PR_SET_PDEATHSIG, signal.SIGINT)
