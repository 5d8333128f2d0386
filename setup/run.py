"""Starts a module in the finished environment.

This module also runs under Pythons too old for drfmcw itself: nothing newer than Python 3.4 here.
"""

import glob
import os
import signal

from setup import stamp

_MOST_WORKERS = 6  # of the tests: many of them start processes of their own
_KEPT = 256 * 2 ** 20  # bytes that a process keeps after it freed them, at most


def execute(root, module, arguments):
    """Replace this process by `python -m module arguments` in the environment; does not return.

    A SIGINT waits until `drfmcw_ros.commands.begin` takes it: none ends in a traceback of the interpreter's start.
    """
    python = os.path.join(root, stamp.VENV, "bin", "python")
    target = [os.path.join(root, module)] if module.endswith("/") else ["-m", module]
    if module.startswith("drfmcw_"):
        target = ["-m", "drfmcw_ros.commands.begin", module]
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    environ = variables(root, os.environ)
    if module == "pytest":
        environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
        environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        if not arguments:
            # All tests: each file in one process, so that its tests share what they set up. Those of graphs mostly
            # wait, so there is a worker more for every two cores.
            cores = os.cpu_count() or 1
            arguments = ["-n", str(min(cores + (cores + 1) // 2, _MOST_WORKERS)), "--dist", "loadfile"]
        # Without a path pytest looks for pyproject.toml in the current directory.
        arguments = ["--rootdir", root, "-c", os.path.join(root, "pyproject.toml")] + arguments
        os.chdir(root)
    os.execve(python, [python] + target + arguments, environ)


def variables(root, environ):
    """The environment variables that a process of the project needs."""
    result = dict(environ)
    result.pop("PYTHONHOME", None)
    venv = os.path.join(root, stamp.VENV)
    install = os.path.join(root, "install")
    # src/ before install/: a change of a Python module must take effect without another build.
    setups = glob.glob(os.path.join(glob.escape(root), "src", "*", "setup.py"))
    packages = sorted(os.path.dirname(path) for path in setups)
    built = glob.glob(os.path.join(glob.escape(install), "lib", "python3*", "site-packages"))
    prepend(result, "PYTHONPATH", packages + built)
    libraries = [os.path.join(install, "lib")]
    if stamp.is_system_ros(environ):
        prepend(result, "AMENT_PREFIX_PATH", [install])
    else:
        libraries += wheel_libraries(venv)
        result["AMENT_PREFIX_PATH"] = os.pathsep.join([install, venv])
        result["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"  # the only one that the wheels bring
        # Keeps the wheels from starting Python a second time to set LD_LIBRARY_PATH, which is set here.
        result["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
    prepend(result, "LD_LIBRARY_PATH", libraries)
    prepend(result, "PATH", [os.path.join(venv, "bin")])
    # Not shared memory: a process that was killed and started again may hear nothing through it.
    result.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    # The arrays are small and the processes many: threads inside NumPy only get into each other's way.
    result.setdefault("OPENBLAS_NUM_THREADS", "1")
    result.setdefault("OMP_NUM_THREADS", "1")
    # Arrays of some megabytes come and go all the time: malloc keeps their memory instead of returning it each time,
    # and NumPy asks for no huge pages, of which the kernel clears more than an array needs.
    for name in ("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"):
        result.setdefault(name, str(_KEPT))
    result.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")
    return result


def wheel_libraries(venv):
    """Folders with the shared libraries of the ROS wheels."""
    bundled = glob.glob(os.path.join(glob.escape(venv), "lib", "python3*", "site-packages", "ros_*.libs"))
    return [os.path.join(venv, "lib")] + sorted(bundled)


def prepend(environ, name, paths):
    """Put paths at the front of a variable such as PATH."""
    old = [path for path in environ.get(name, "").split(os.pathsep) if path and path not in paths]
    environ[name] = os.pathsep.join(paths + old)
