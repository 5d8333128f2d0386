"""Chooses the Python that the set-up is made with.

This module also runs under Pythons too old for drfmcw itself: nothing newer than Python 3.4 here.
"""

import os
import shutil
import subprocess
import sys

from setup import stamp

SUPPORTED = ((3, 13), (3, 12), (3, 11))
_PROBE = "import sys; print('%d.%d' % sys.version_info[:2]); print(sys.executable)"
_PROBE_ROS = "import rclpy; " + _PROBE


class SetupError(Exception):
    """Why the set-up cannot be made, in one line that says what mends it."""


def ensure_supported(script, arguments):
    """Return if the running Python can make the set-up; else start `script` again with one that can, or exit."""
    try:
        python = _choose(os.environ)
    except SetupError as error:
        sys.stderr.write("drfmcw: {}\n".format(error))
        sys.exit(2)
    if python != sys.executable:
        os.environ["DRFMCW_PYTHON"] = python
        os.execv(python, [python, os.path.abspath(script)] + arguments)


def _choose(environ):
    """Path of the Python to use; raises SetupError when there is none."""
    system = stamp.is_system_ros(environ)
    if system and environ["ROS_DISTRO"] != "jazzy":
        raise SetupError(
            "ROS 2 {} is sourced, but drfmcw needs Jazzy: source /opt/ros/jazzy/setup.bash in a new shell, or none "
            "to use the wheels".format(environ["ROS_DISTRO"].capitalize())
        )
    candidates = [environ["DRFMCW_PYTHON"]] if environ.get("DRFMCW_PYTHON") else _on_path()
    if sys.executable in candidates and not system and sys.version_info[:2] in SUPPORTED:
        return sys.executable  # most common, and saves starting it to ask for its version
    for python in candidates:
        version, executable = _ask(python, _PROBE_ROS if system else _PROBE)
        if version in SUPPORTED:
            return executable
    if system:
        raise SetupError(
            "Jazzy is sourced, but no Python on PATH can import rclpy: use the Python that Jazzy was built for "
            "(sudo apt install ros-jazzy-rclpy python3, and no other python3 before it on PATH)"
        )
    if environ.get("DRFMCW_PYTHON"):
        found = "DRFMCW_PYTHON={}".format(environ["DRFMCW_PYTHON"])
    else:
        found = "this is Python {}.{}".format(*sys.version_info[:2])
    raise SetupError(
        "needs Python 3.11, 3.12 or 3.13 ({} is not, and none is on PATH): sudo apt install python3 python3-venv "
        "python3-dev".format(found)
    )


def _on_path():
    """The running Python first, then those on PATH, the newest first."""
    names = ["python{}.{}".format(*version) for version in SUPPORTED] + ["python3"]
    found = [shutil.which(name) for name in names]
    usual = [path for path in ("/usr/bin/python3",) if os.path.exists(path)]
    return [sys.executable] + [path for path in found if path] + usual


def _ask(python, probe):
    """Version and true path of an interpreter; None twice when it does not start (a pyenv shim, say)."""
    try:
        output = subprocess.check_output([python, "-c", probe], stderr=subprocess.DEVNULL, universal_newlines=True)
        version, executable = output.splitlines()[-2:]
        return tuple(int(part) for part in version.split(".")), executable
    except (OSError, ValueError, subprocess.CalledProcessError):
        return None, None
