"""What all command lines share: one line and status 2 for a wrong input, a quiet end on Ctrl-C or a closed pipe."""

import argparse
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from drfmcw_physics.settings import ConfigurationError

from . import interrupts


class Parser(argparse.ArgumentParser):
    """Argument parser that says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        """Print one line and leave with status 2."""
        self.exit(2, f'{self.prog}: {message} (see {self.prog} --help)\n')


def guarded(prog: str, work: Callable[[], int | None]) -> int:
    """Run `work` and return the exit status: its own or 0, 2 with one line for wrong input, 130 after Ctrl-C.

    An error of the operating system counts as wrong input: what it could not open, make or write.
    """
    interrupts.keep()
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # of `begin`, which a Ctrl-C ended at once
    try:
        return work() or 0
    except ConfigurationError as error:
        print(f'{prog}: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # a directory that is a file, a full disk: nothing that a traceback would say better
        print(f'{prog}: {reason(error)}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    finally:
        interrupts.answered()


def reason(error: OSError) -> str:
    """Return what an error of the operating system says, in one line."""
    where = f'{os.fsdecode(error.filename)}: ' if isinstance(error.filename, (str, bytes)) else ''
    return f'{where}{error.strerror or error}'


def split_ros_arguments(argv: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """Return (own arguments, arguments for ROS): everything from --ros-args up to -- goes to ROS."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if '--ros-args' not in arguments:
        return arguments, []
    start = arguments.index('--ros-args')
    end = arguments.index('--', start) + 1 if '--' in arguments[start:] else len(arguments)
    return arguments[:start] + arguments[end:], arguments[start:end]


def write_atomically(path: Path | str, content: str | bytes, private: bool = False) -> None:
    """Write a file under a temporary name and rename it, so that a half-written one never appears under its name.

    Args:
        path: of the file.
        content: text or bytes.
        private: only its owner can read it.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f'.{path.name}.')
        try:
            with os.fdopen(handle, 'wb') as file:
                file.write(data)
            os.chmod(name, 0o600 if private else 0o666 & ~_umask())
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise ConfigurationError(f'{path}: {error.strerror or error}') from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
