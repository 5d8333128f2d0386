"""A Ctrl-C that Python swallows is raised again, and one that was answered is over.

Python raises the exception of a signal wherever it is just then. In a destructor, or in the callback of a weak
reference, it says 'Exception ignored' and goes on; importing a module runs such callbacks, and so does a collection of
garbage. The Ctrl-C would be lost, and a process go on for ever. An object of rclpy whose making it breaks off lacks
what its destructor asks for: that is no news.

CPython marks a process to die of SIGINT at its end where a Ctrl-C breaks off code that was given as text, as that of
message classes is, whoever answers the exception. Other code that is given as text takes the mark away.
"""

import os
import signal
import sys
import threading
from typing import Any

_PAUSE = 0.05  # before it is raised again: what swallowed it is over by then [s]


def keep() -> None:
    """From here on let no Ctrl-C, and no signal that raises KeyboardInterrupt, be lost in this process."""
    before = sys.unraisablehook
    if getattr(before, '__module__', '') == __name__:
        return

    def hook(unraisable: Any) -> None:
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            if not _broken_off(unraisable):
                before(unraisable)
            return
        again = threading.Timer(_PAUSE, os.kill, (os.getpid(), signal.SIGINT))
        again.daemon = True
        again.start()

    sys.unraisablehook = hook


def answered() -> None:
    """Let this process end with its own exit status, although a Ctrl-C came before."""
    exec('')  # takes CPython's mark away


def _broken_off(unraisable: Any) -> bool:
    """Return whether a destructor of rclpy met an object that was never complete."""
    destructor = unraisable.object
    of_rclpy = getattr(destructor, '__module__', '').partition('.')[0] == 'rclpy'
    return of_rclpy and getattr(destructor, '__name__', '') == '__del__' and unraisable.exc_type is AttributeError
