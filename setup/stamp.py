"""The stamps that say a set-up is complete, and what makes one out of date.

This module also runs under Pythons too old for drfmcw itself: nothing newer than Python 3.4 here.
"""

import hashlib
import json
import os

VENV = ".venv"
WHEELS_STAMP = os.path.join(VENV, "drfmcw_wheels.json")
BUILD_STAMP = os.path.join("install", "drfmcw_build.json")
# To be raised when the set-up does something else with the same inputs.
RECIPE = 1


def is_system_ros(environ):
    """Whether a ROS 2 installation is sourced, so that it is used instead of the wheels."""
    return bool(environ.get("ROS_DISTRO")) and bool(environ.get("AMENT_PREFIX_PATH"))


def expected_wheels(root, environ):
    """What the stamp of the installed wheels has to say."""
    system = is_system_ros(environ)
    return {
        "recipe": RECIPE,
        # A virtual environment and a CMake build cannot be moved.
        "path": root,
        "requirements": _digest(root, _requirement_files(root)),
        "ros": environ["ROS_DISTRO"] + " " + environ["AMENT_PREFIX_PATH"].split(os.pathsep)[-1] if system else "wheels",
        # After an upgrade of the distribution the same link leads to another Python.
        "interpreter": os.path.realpath(os.path.join(root, VENV, "bin", "python")),
    }


def expected_build(root, environ):
    """What the stamp of the built workspace has to say."""
    inputs = _build_inputs(packages(root, environ))
    return {"wheels": expected_wheels(root, environ), "sources": _digest(root, inputs, _share_names(root))}


def is_ready(root, environ):
    """Whether the set-up is complete and up to date."""
    return (
        read(root, WHEELS_STAMP) == expected_wheels(root, environ)
        and read(root, BUILD_STAMP) == expected_build(root, environ)
    )


def read(root, name):
    """The content of a stamp, None where there is none."""
    try:
        with open(os.path.join(root, name)) as file:
            return json.load(file)
    except (OSError, ValueError):
        return None


def write(root, name, content):
    """Write a stamp so that it is there whole, and after everything it vouches for, or not at all."""
    os.sync()
    path = os.path.join(root, name)
    with open(path + ".new", "w") as file:
        json.dump(content, file, indent=1, sort_keys=True)
        file.flush()
        os.fsync(file.fileno())
    os.rename(path + ".new", path)


def remove(root, name):
    """Remove a stamp, whether or not it is there."""
    try:
        os.remove(os.path.join(root, name))
    except OSError:
        if os.path.exists(os.path.join(root, name)):
            raise


def _requirement_files(root):
    folder = os.path.join(root, "setup")
    return [os.path.join(folder, name) for name in os.listdir(folder) if name.startswith("requirements")]


def packages(root, environ):
    """Folders of the packages that are built."""
    return _list(os.path.join(root, "src")) + lacking(root, environ)


def lacking(root, environ):
    """Folders of the packages of ROS 2 that its wheels lack, none beside an installation of it."""
    return [] if is_system_ros(environ) else [os.path.join(root, "setup", "tf2_msgs")]


def _build_inputs(folders):
    """Files whose content reaches install/ by being built; Python modules are used from src/ as they are."""
    files = []
    for package in folders:
        files += [os.path.join(package, name) for name in ("package.xml", "setup.py", "setup.cfg", "CMakeLists.txt")]
        files += _list(os.path.join(package, "msg")) + _list(os.path.join(package, "srv"))
    return [file for file in files if os.path.isfile(file)]


def _share_names(root):
    """Names of the files that install/ links to: their content is always the current one."""
    bringup = os.path.join(root, "src", "drfmcw_bringup")
    return [os.path.relpath(file, root) for name in ("launch", "config") for file in _list(os.path.join(bringup, name))]


def _list(folder):
    try:
        return [os.path.join(folder, name) for name in sorted(os.listdir(folder)) if not name.startswith((".", "_"))]
    except OSError:
        return []


def _digest(root, files, names=()):
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update((os.path.relpath(path, root) + "\0").encode())
        with open(path, "rb") as file:
            digest.update(hashlib.sha256(file.read()).digest())
    digest.update("\0".join(sorted(names)).encode())
    return digest.hexdigest()
