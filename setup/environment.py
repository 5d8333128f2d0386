"""Makes .venv and the workspace ready; safe to be interrupted at any moment and to be called twice at once."""

import contextlib
import errno
import fcntl
import os
import shutil
import sys

from setup import checks, stamp, wheels, workspace
from setup.interpreter import SetupError
from setup.progress import Progress

LOCK = ".venv.lock"


def make_ready(root):
    """Bring the set-up up to date, or exit with status 2 and one line saying why not."""
    progress = Progress({"virtual environment": 3, "wheels": 15, "byte code": 6, "messages and packages": 25})
    try:
        checks.check_writable(root)
        with _lock(root) as lock:
            if not stamp.is_ready(root, os.environ):  # another set-up may have finished meanwhile
                _update(root, progress, lock)
    except KeyboardInterrupt:
        progress.clear()
        sys.stderr.write("drfmcw: set-up interrupted; the next call takes it up again\n")
        sys.exit(130)
    except (SetupError, OSError) as error:
        progress.clear()
        sys.stderr.write(f"drfmcw: {_explain(error)}\n")
        sys.exit(2)


def _update(root, progress, lock):
    system_ros = stamp.is_system_ros(os.environ)
    checks.check_machine(root, system_ros)
    if _wheels_complete(root):
        sys.stderr.write("drfmcw: messages or packages changed; building again\n")
    else:
        source = f"ROS 2 Jazzy of {os.environ['AMENT_PREFIX_PATH'].split(os.pathsep)[-1]}" if system_ros else "wheels"
        sys.stderr.write(f"drfmcw: setting up {os.path.join(root, stamp.VENV)} with {source}, about two minutes\n")
        # Every stamp goes before what it vouches for, and comes back after it.
        stamp.remove(root, stamp.BUILD_STAMP)
        stamp.remove(root, stamp.WHEELS_STAMP)
        for name in (stamp.VENV, "build", "install"):
            _remove_tree(os.path.join(root, name))
        wheels.install(root, progress, lock, system_ros)
        stamp.write(root, stamp.WHEELS_STAMP, stamp.expected_wheels(root, os.environ))
    if stamp.read(root, stamp.BUILD_STAMP) is None:
        # A build that was cut off may have left files that look newer than their sources but are not whole.
        for name in ("build", "install"):
            _remove_tree(os.path.join(root, name))
    expected = stamp.expected_build(root, os.environ)  # before the build: a file changed during it is built next time
    stamp.remove(root, stamp.BUILD_STAMP)
    workspace.build(root, progress, lock)
    stamp.write(root, stamp.BUILD_STAMP, expected)
    progress.finish()


def _wheels_complete(root):
    return stamp.read(root, stamp.WHEELS_STAMP) == stamp.expected_wheels(root, os.environ)


@contextlib.contextmanager
def _lock(root):
    """Hold the lock of the set-up; yields its file descriptor.

    Child processes inherit it: when this process is killed, the next set-up waits until they have ended too.
    """
    descriptor = os.open(os.path.join(root, LOCK), os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            sys.stderr.write("drfmcw: waiting for another set-up of this directory to end\n")
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield descriptor
    finally:
        os.close(descriptor)


def _remove_tree(path):
    if os.path.islink(path):
        os.unlink(path)
    elif os.path.exists(path):
        shutil.rmtree(path)


def _explain(error):
    if isinstance(error, OSError):
        where = f" ({error.filename})" if error.filename else ""
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return f"the disk is full{where}: free about 1.5 GB and call again"
        if error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
            return f"cannot write the set-up{where}: use a checkout that you may write to"
        return f"set-up failed: {error}; call again"
    return str(error)
