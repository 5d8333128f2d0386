"""Installs the pinned wheels into .venv."""

import os
import re
import subprocess
import sys
import sysconfig

from setup import stamp
from setup.interpreter import SetupError

REQUIREMENTS = ("setup/requirements.txt", "setup/requirements-test.txt")
FIRST = "setup/requirements-first.txt"
HASHES = "setup/hashes.txt"
LOG = os.path.join("log", "setup.log")
# What is installed where a system installation of Jazzy lacks it: module, distribution.
SYSTEM_EXTRAS = {
    "numpy": "numpy", "scipy": "scipy", "matplotlib": "matplotlib", "yaml": "pyyaml", "rich": "rich",
    "rosbags": "rosbags", "soundfile": "soundfile", "dask": "dask", "distributed": "distributed",
    "nicegui": "nicegui", "argon2": "argon2-cffi", "asyncua": "asyncua", "pymodbus": "pymodbus",
    "foxglove": "foxglove-sdk",
    "pyvisa": "pyvisa", "pyvisa_py": "pyvisa-py", "pytest": "pytest", "pytest_timeout": "pytest-timeout",
    "xdist": "pytest-xdist", "hypothesis": "hypothesis", "playwright": "playwright",
}  # fmt: skip
COLCON = ("colcon-core", "colcon-ros", "colcon-cmake", "colcon-python-setup-py", "colcon-recursive-crawl",
          "colcon-output", "colcon-package-selection", "colcon-parallel-executor", "colcon-bash",
          "colcon-metadata", "colcon-library-path")  # fmt: skip
WITH_LIBRARY = ("soundfile",)  # its wheels bring a library, but for a file that relies on the system's
_NO_NETWORK = re.compile(
    "Failed to establish a new connection|Temporary failure in name resolution|Name or service not known|"
    "ConnectTimeout|ReadTimeout|ConnectionError|NewConnectionError|ProxyError|Connection refused|"
    "Network is unreachable|Connection reset|Read timed out|timed out"
)


def install(root, progress, lock, system_ros):
    """Make .venv and install everything into it, from nothing."""
    venv = os.path.join(root, stamp.VENV)
    log = os.path.join(root, LOG)
    os.makedirs(os.path.dirname(log), exist_ok=True)
    open(os.path.join(root, "log", "COLCON_IGNORE"), "a").close()
    progress.show("virtual environment", 0)
    with open(log, "w") as output:
        options = ["--system-site-packages"] if system_ros else []
        _run([sys.executable, "-m", "venv", *options, venv], output, lock, "cannot make a virtual environment")
        progress.show("virtual environment", 0.8)
        if system_ros:
            _install_extras(root, venv, output, lock, progress)
        else:
            _install_all(root, venv, output, lock, progress)
            progress.show("byte code", 0)
            _run([_python(venv), "-m", "compileall", "-q", "-j", "0", os.path.join(venv, "lib")], output, lock, None)
            repair(venv)
        progress.show("byte code", 1)


def read_requirements(root, names):
    """The pinned requirements of files, comments left out."""
    pins = []
    for name in names:
        with open(os.path.join(root, name)) as file:
            pins += [line.strip() for line in file if line.strip() and not line.startswith("#")]
    return pins


def repair(venv):
    """Replace the two paths of the wheels' build machine that their CMake files export by the ones here."""
    python_include = sysconfig.get_path("include")
    packages = os.path.join(venv, "lib", f"python{sys.version_info[0]}.{sys.version_info[1]}", "site-packages")
    # Before NumPy 2 its headers lie in core.
    cores = [os.path.join(packages, "numpy", core, "include") for core in ("_core", "core")]
    numpy_include = next((path for path in cores if os.path.isdir(path)), cores[0])
    # Of any other environment: a cache of wheels may hold files that an earlier set-up has changed.
    wrong_numpy = re.compile(r'/[^;"<>\s]*/site-packages/numpy/_?core/include')
    wrong_python = re.compile(r'/opt/python/[^/;">]+/include/python3\.\d+')
    for folder in ("share", os.path.join("lib", "cmake")):
        for where, _, files in os.walk(os.path.join(venv, folder)):
            for path in (os.path.join(where, name) for name in files if name.endswith(".cmake")):
                with open(path, encoding="utf-8") as file:
                    old = file.read()
                new = wrong_python.sub(lambda _: python_include, wrong_numpy.sub(lambda _: numpy_include, old))
                if new != old:
                    with open(path + ".new", "w", encoding="utf-8") as file:
                        file.write(new)
                    os.replace(path + ".new", path)  # uv links files to its cache, which must keep its own


def _install_all(root, venv, output, lock, progress):
    # One by one: empy is built with setuptools. The first small call finds out at once that there is no network.
    for pin in read_requirements(root, [FIRST]):
        failure = None if pin.startswith("uv==") else f"cannot install {pin}"  # uv has no wheel for every machine
        wanted = _asked(root, venv, [pin])
        _run([*_pip(venv), "--no-build-isolation", "--only-binary", "uv", *wanted], output, lock, failure)
    pins = read_requirements(root, REQUIREMENTS)
    wanted = _asked(root, venv, pins)
    progress.show("wheels", 0.3, f"{len(pins)} wheels")
    uv = os.path.join(venv, "bin", "uv")
    if os.path.exists(uv):  # takes a sixth of the time of four pips; what it cannot get is left to pip
        command = [uv, "pip", "install", "--python", _python(venv), "--no-deps", "--only-binary", ":all:", *wanted]
        _run(command, output, lock, None, _uv_environment(venv))
        _install_libraries(root, venv, pins, output, lock)
    progress.show("wheels", 0.9, f"{len(pins)} wheels")
    _run([*_pip(venv), "--only-binary", ":all:", *wanted], output, lock, "cannot install the wheels")


def _install_libraries(root, venv, pins, output, lock):
    """Install again what came without the library that it loads.

    Of one version's files uv takes those of the first index that has any; pip takes the best of all indexes.
    """
    bare = [pin for pin in pins if pin.split("==")[0] in WITH_LIBRARY and not _loads(venv, pin.split("==")[0])]
    if bare:
        command = [*_pip(venv), "--only-binary", ":all:", "--force-reinstall", *_asked(root, venv, bare)]
        _run(command, output, lock, f"cannot install {bare[0]}")


def _loads(venv, module):
    """Whether a module can be imported."""
    done = subprocess.run([_python(venv), "-c", f"import {module}"], stdout=subprocess.DEVNULL,
                          stderr=subprocess.DEVNULL, env=_pip_environment(), check=False)  # fmt: skip
    return done.returncode == 0


def _only_listed():
    """Whether no file may be installed but those whose hashes are listed."""
    return os.environ.get("DRFMCW_HASHES") == "1"


def _asked(root, venv, pins):
    """What to ask of pip or uv for pins."""
    return with_hashes(root, venv, pins) if _only_listed() else pins


def with_hashes(root, venv, pins):
    """What to ask of pip or uv instead of pins, so that it takes no file of them but those listed."""
    lines = {line.split()[0]: line for line in read_requirements(root, [HASHES])}
    missing = [pin for pin in pins if pin not in lines]
    if missing:
        raise SetupError(f"{HASHES} lists no file of {missing[0]}; python3 setup/hashes.py renews it")
    path = os.path.join(venv, "hashes.txt")
    with open(path, "w") as file:
        file.writelines(lines[pin] + "\n" for pin in pins)
    return ["--require-hashes", "-r", path]


def _uv_environment(venv):
    """Return an environment in which uv uses the indexes and certificates that pip is configured to use."""
    listed = subprocess.run([_python(venv), "-m", "pip", "config", "list"], stdout=subprocess.PIPE, text=True,
                            env=_pip_environment(), check=False)  # fmt: skip
    names = {"index-url": "UV_DEFAULT_INDEX", "extra-index-url": "UV_INDEX", "find-links": "UV_FIND_LINKS",
             "no-index": "UV_NO_INDEX", "cert": "SSL_CERT_FILE", "proxy": "ALL_PROXY"}  # fmt: skip
    found = {"UV_INDEX_STRATEGY": "unsafe-best-match"}  # as pip chooses
    for line in listed.stdout.splitlines():
        name, _, value = line.partition("=")
        value = " ".join(value.strip("'\"").split())
        uv_name = names.get(name.rpartition(".")[2])
        if uv_name:  # the environment comes last in pip's list, and decides
            found[uv_name] = value.replace(" ", ",") if uv_name == "UV_FIND_LINKS" else value
    return {**_pip_environment(), **found}


def _install_extras(root, venv, output, lock, progress):
    """Install what a system installation of Jazzy lacks, leaving alone what it has."""
    if _only_listed():
        raise SetupError("DRFMCW_HASHES=1 needs the pinned wheels: call it where no ROS is sourced")
    progress.show("wheels", 0)
    probe = "import importlib.util, sys; print(*[n for n in sys.argv[1:] if importlib.util.find_spec(n) is None])"
    command = [_python(venv), "-c", probe, *SYSTEM_EXTRAS, "colcon_core", "em"]
    missing = subprocess.check_output(command, text=True, pass_fds=[lock]).split()
    pins = {pin.split("==")[0]: pin for pin in read_requirements(root, [FIRST, *REQUIREMENTS])}
    wanted = [pins[SYSTEM_EXTRAS[name]] for name in missing if name in SYSTEM_EXTRAS]
    if "em" in missing:
        wanted += [pins["setuptools"], pins["empy"]]
    if "colcon_core" in missing:
        wanted += [pins[name] for name in COLCON]
    if wanted:
        # With dependencies, as what the system already has differs: pip keeps a version that will do.
        command = [*_pip(venv), *wanted]
        command.remove("--no-deps")
        _run(command, output, lock, "cannot install the wheels that the system lacks")


def _pip(venv):
    return [_python(venv), "-m", "pip", "install", "--no-deps", "--no-compile", "--no-input", "--retries", "2",
            "--disable-pip-version-check", "--no-warn-script-location", "--progress-bar", "off"]  # fmt: skip


def _pip_environment():
    # LC_ALL: what pip says is read here. A target or a user install asked for elsewhere is not meant for .venv.
    unwanted = ("PIP_USER", "PIP_TARGET", "PIP_PREFIX", "PIP_REQUIRE_HASHES", "PIP_QUIET", "PYTHONPATH", "PYTHONHOME")
    environ = {name: value for name, value in os.environ.items() if name not in unwanted}
    if stamp.is_system_ros(os.environ) and "PYTHONPATH" in os.environ:
        environ["PYTHONPATH"] = os.environ["PYTHONPATH"]
    environ.update(PYTHONUNBUFFERED="1", LC_ALL="C.UTF-8", PIP_ROOT_USER_ACTION="ignore",
                   _ROS_WHEELS_BOOTSTRAP_COMPLETE="1")  # fmt: skip
    return environ


def _run(command, output, lock, failure, environ=None):
    """Run a command into the log; `failure` None: what it says does not matter."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, pass_fds=[lock],
                          env=environ or _pip_environment(), check=False)  # fmt: skip
    output.write(done.stdout)
    output.flush()
    if done.returncode and failure:
        raise SetupError(_pip_failure(done.stdout, os.path.dirname(os.path.dirname(output.name)), failure))


def _pip_failure(text, root, failure="pip cannot install the wheels"):
    if "No space left on device" in text:
        return "the disk is full: free about 1.5 GB and call again"
    if "DO NOT MATCH THE HASHES" in text:
        named = re.search(r"^\s+(\S+==\S+) ", text, re.MULTILINE)
        pin = named.group(1) if named else "a wheel"
        return f"{pin} is another file than {HASHES} lists (see {os.path.join(root, LOG)})"
    if _NO_NETWORK.search(text):
        return "no network: pip cannot reach the package index; check the connection (pip download rich) and call again"
    errors = [line for line in text.splitlines() if "error:" in line.lower()] or text.splitlines()[-1:]
    return f"{failure}: {' '.join(errors[:1])} (see {os.path.join(root, LOG)})"


def _python(venv):
    return os.path.join(venv, "bin", "python")
