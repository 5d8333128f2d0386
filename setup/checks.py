"""What the machine must bring, checked before a minute is spent on installing."""

import importlib.util
import os
import shutil
import sys
import sysconfig

from setup.interpreter import SetupError

# Wheels, workspace and byte code take 1.0 GB; pip unpacks beside them.
NEEDED_SPACE = 1_500_000_000


def check_machine(root, system_ros):
    """Raise SetupError for the first thing that is missing."""
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    distribution = sys.executable.startswith("/usr/bin/")
    if any(importlib.util.find_spec(name) is None for name in ("venv", "ensurepip")):
        raise SetupError(f"Python {version} has no venv module: sudo apt install python{version}-venv")
    if not _compiler("CXX", "c++", "g++", "clang++") or not _compiler("CC", "cc", "gcc", "clang"):
        raise SetupError("no C++ compiler, which building the messages needs: sudo apt install g++")
    if not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")):
        mend = f"sudo apt install python{version}-dev" if distribution else "install its development files"
        raise SetupError(f"Python {version}'s headers are missing, which building the messages needs: {mend}")
    free = shutil.disk_usage(root).free
    if not system_ros and free < NEEDED_SPACE:
        raise SetupError(f"{free / 1e9:.1f} GB left on the disk of {root}, {NEEDED_SPACE / 1e9:.1f} needed: free some")


def check_writable(root):
    """Raise SetupError when nothing can be written into the checkout."""
    if not os.access(root, os.W_OK):
        raise SetupError(
            f"{root} is read-only and the set-up goes there: git clone {root} ~/drfmcw && ~/drfmcw/drfmcw --help"
        )


def _compiler(variable, *names):
    given = os.environ.get(variable, "").split()
    return any(shutil.which(name) for name in (given[:1] or names))
