"""Builds src/, and what the wheels lack of ROS 2, into install/ with colcon."""

import os
import re
import subprocess

from setup import run, stamp
from setup.interpreter import SetupError

LOG = os.path.join("log", "build.log")
# Ninja's "[3/57]" and make's "[ 12%]".
_STEP = re.compile(r"\[\s*(\d+)(?:/(\d+)|%)\]")


def build(root, progress, lock):
    """Build all packages; raises SetupError when that fails."""
    os.makedirs(os.path.join(root, "log"), exist_ok=True)
    packages = len(stamp.packages(root, os.environ))
    finished, share, last = 0, 0.0, []
    with open(os.path.join(root, LOG), "w") as log, subprocess.Popen(
        command(root), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", cwd=root,
        env=variables(root), pass_fds=[lock],
    ) as process:  # fmt: skip
        for line in process.stdout or ():
            log.write(line)
            last.append(line)
            finished += line.startswith("Finished <<<")
            step = _STEP.match(line)
            if step:
                share = max(share, int(step[1]) / int(step[2] or 100))
            # The messages take most of the time.
            progress.show("messages and packages", 0.8 * share + 0.2 * finished / packages, f"{finished} of {packages}")
    if process.returncode:
        text = "".join(last)
        if "No space left on device" in text:
            raise SetupError("the disk is full: free about 0.5 GB and call again")
        raise SetupError(f"colcon build failed: {_cause(last)} (see {os.path.join(root, LOG)})")


def command(root):
    """The call of colcon."""
    python = os.path.join(root, stamp.VENV, "bin", "python")
    cmake = ["-DBUILD_TESTING=OFF", "-DCMAKE_BUILD_TYPE=Release", f"-DPython3_EXECUTABLE={python}"]
    if not stamp.is_system_ros(os.environ):
        cmake += ["-G", "Ninja"]  # comes with the wheels; g++ alone does not bring make
    colcon = [python, "-c", "import sys; from colcon_core.command import main; sys.exit(main())"]
    paths = [os.path.join(root, "src"), *stamp.lacking(root, os.environ)]
    return [*colcon, "--log-base", os.path.join(root, "log"), "build", "--base-paths", *paths,
            "--build-base", os.path.join(root, "build"), "--install-base", os.path.join(root, "install"),
            "--merge-install", "--symlink-install", "--event-handlers", "console_direct+", "console_cohesion-",
            "--cmake-args", *cmake]  # fmt: skip


def variables(root):
    """The environment of the build: what another workspace has left in the shell stays out."""
    venv = os.path.join(root, stamp.VENV)
    environ = dict(os.environ)
    if not stamp.is_system_ros(os.environ):
        for name in ("PYTHONPATH", "PYTHONHOME", "COLCON_PREFIX_PATH"):
            environ.pop(name, None)
        environ["AMENT_PREFIX_PATH"] = environ["CMAKE_PREFIX_PATH"] = venv
        environ["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
        run.prepend(environ, "LD_LIBRARY_PATH", run.wheel_libraries(venv))
    environ["COLCON_HOME"] = os.path.join(venv, "colcon")  # not the user's colcon defaults
    environ["PYTHONWARNINGS"] = "ignore"  # setuptools' advice about setup.py
    environ["PYTHONUNBUFFERED"] = "1"
    run.prepend(environ, "PATH", [os.path.join(venv, "bin")])
    return environ


def _cause(lines):
    """The line of a build's output that most likely says what is wrong."""
    lines = [line for line in lines if line.strip()]
    for pattern in ("CMake Error", "error:", "Error"):  # after an error of CMake, Ninja reports one that says less
        for number, line in enumerate(lines):
            if pattern in line:
                return " ".join(part.strip() for part in lines[number : number + 4])
    return lines[-1].strip() if lines else "no output"
