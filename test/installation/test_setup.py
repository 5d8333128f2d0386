"""The launcher's promises: the real launcher, in copies of the checkout and with doctored surroundings."""

import fcntl
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from checkout import ROOT
from setup.interpreter import SetupError

from setup import wheels

PYTHON = os.path.realpath(sys.executable)
SUBCOMMANDS = (
    'demo test run station fusion gateway foxglove doctor frames simulate record replay info repair import export view '
    'bench keystore montecarlo campaign survey soak reproduce pair diagnose prove calibrate host watch'
).split()


def launch(root, *arguments, path=os.environ['PATH'], python=PYTHON, timeout=60, **variables):
    """Run the launcher as a shell without anything of ROS would."""
    kept = {name: os.environ[name] for name in ('HOME', 'LANG') if name in os.environ}
    command = [python, str(root / 'drfmcw'), *arguments]
    environ = {**kept, 'PATH': path, **variables}
    return subprocess.run(command, env=environ, cwd=root, capture_output=True, text=True, timeout=timeout)


def one_line(done, status=2):
    """The one line on standard error of a call that had to fail."""
    assert done.returncode == status, done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert done.stdout == ''
    return lines[0]


@pytest.fixture
def checkout(tmp_path):
    """A copy of the checkout in which nothing is set up."""
    ignored = shutil.ignore_patterns('__pycache__')
    shutil.copytree(ROOT / 'setup', tmp_path / 'setup', ignore=ignored)
    for package in sorted((ROOT / 'src').iterdir()):
        shutil.copytree(package, tmp_path / 'src' / package.name, ignore=ignored, symlinks=True)
    shutil.copy2(ROOT / 'drfmcw', tmp_path)
    return tmp_path


@pytest.fixture
def bare_path(tmp_path_factory):
    """A PATH with nothing but a Python on it."""
    folder = tmp_path_factory.mktemp('bin')
    (folder / 'python3').symlink_to(PYTHON)
    return str(folder)


def test_help_lists_every_subcommand_without_a_setup(checkout):
    done = launch(checkout, '--help')
    assert done.returncode == 0
    listed = re.findall(r'^  (\w+) +\S', done.stdout, re.MULTILINE)
    assert listed[: len(SUBCOMMANDS)] == SUBCOMMANDS
    assert not (checkout / '.venv').exists()


@pytest.mark.parametrize(('typed', 'meant'), [('statoin', 'station'), ('Demo', 'demo'), ('tests', 'test'), ('xyz', '')])
def test_unknown_subcommand_names_the_nearest(checkout, typed, meant):
    line = one_line(launch(checkout, typed))
    assert f"'{typed}'" in line
    assert f"did you mean '{meant}" in line


def test_missing_compiler(checkout, bare_path):
    line = one_line(launch(checkout, 'info', path=bare_path))
    assert 'sudo apt install g++' in line
    assert not (checkout / '.venv').exists()


def test_missing_venv_module(checkout, tmp_path_factory):
    """Debian's python3 without python3-venv lacks ensurepip."""
    folder = tmp_path_factory.mktemp('site')
    (folder / 'sitecustomize.py').write_text("import sys\nsys.modules['ensurepip'] = None\n")
    line = one_line(launch(checkout, 'info', PYTHONPATH=str(folder)))
    assert re.search(r'sudo apt install python3\.\d+-venv', line)


def test_unsupported_python_named(checkout):
    """An interpreter asked for that is none."""
    line = one_line(launch(checkout, 'info', DRFMCW_PYTHON='/bin/false'))
    assert '3.11, 3.12 or 3.13' in line
    assert 'DRFMCW_PYTHON=/bin/false' in line


@pytest.mark.parametrize('version', ['2.7', '3.6', '3.8', '3.10'])
def test_old_python_says_so_in_one_line_or_finds_a_newer_one(checkout, bare_path, version):
    old = _old_python(version)
    if old is None:
        pytest.skip(f'no Python {version} here')
    line = one_line(launch(checkout, 'info', path=bare_path, python=old))
    if version == '2.7':
        assert '3.11, 3.12 or 3.13' in line
    else:
        assert 'g++' in line  # it went on with the Python on PATH and found the next thing missing


def test_other_ros_distribution(checkout):
    line = one_line(launch(checkout, 'info', ROS_DISTRO='humble', AMENT_PREFIX_PATH='/opt/ros/humble'))
    assert 'Humble' in line
    assert 'Jazzy' in line


def test_no_network(checkout):
    """The package index cannot be reached: said within seconds, and no half set-up counts as one."""
    nowhere = {'PIP_INDEX_URL': 'http://127.0.0.1:9/simple', 'PIP_NO_CACHE_DIR': '1', 'PIP_CONFIG_FILE': os.devnull}
    done = launch(checkout, 'info', **nowhere)
    assert done.returncode == 2
    assert 'no network' in done.stderr.splitlines()[-1]
    assert not (checkout / '.venv' / 'drfmcw_wheels.json').exists()


def test_read_only_checkout(checkout):
    if os.geteuid() == 0:
        pytest.skip('nothing is read-only for root')
    checkout.chmod(0o555)
    try:
        assert 'read-only' in one_line(launch(checkout, 'info'))
    finally:
        checkout.chmod(0o755)


def test_interrupted_setup_is_not_taken_for_a_complete_one(checkout):
    """Killed while pip runs: the next call starts over, although .venv/bin/python is there and starts."""
    nowhere = {'PIP_INDEX_URL': 'http://10.255.255.1/simple', 'PIP_NO_CACHE_DIR': '1', 'PIP_CONFIG_FILE': os.devnull}
    environ = {'PATH': os.environ['PATH'], 'HOME': str(checkout), **nowhere}
    command = [PYTHON, str(checkout / 'drfmcw'), 'info']
    process = subprocess.Popen(command, env=environ, stderr=subprocess.DEVNULL, start_new_session=True)
    limit = time.monotonic() + 60
    while not (checkout / '.venv' / 'bin' / 'pip').exists() and time.monotonic() < limit:
        time.sleep(0.05)
    assert process.poll() is None
    os.killpg(process.pid, 9)
    process.wait()
    assert (checkout / '.venv' / 'bin' / 'python').exists()
    # After saying that there is no network, it has begun again instead of starting a module that is not there.
    unreachable = {**nowhere, 'PIP_INDEX_URL': 'http://127.0.0.1:9/simple'}
    done = launch(checkout, 'info', **unreachable)
    assert done.returncode == 2
    assert 'setting up' in done.stderr
    assert 'no network' in done.stderr


def test_a_second_call_waits_for_the_first(checkout):
    """Two calls at once do not write into the same .venv."""
    with open(checkout / '.venv.lock', 'w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        command = [PYTHON, str(checkout / 'drfmcw'), 'info']
        process = subprocess.Popen(command, env={'PATH': os.environ['PATH']}, stderr=subprocess.PIPE, text=True)
        try:
            assert 'waiting for another set-up' in process.stderr.readline()
            assert not (checkout / '.venv').exists()
        finally:
            process.kill()
            process.communicate()


def test_start_of_a_finished_setup_is_quick():
    """What the launcher itself adds to a call in this checkout."""
    names = ('ROS_DISTRO', 'AMENT_PREFIX_PATH', 'PYTHONPATH')
    sourced = {name: os.environ[name] for name in names if name in os.environ}
    began = time.monotonic()
    done = launch(ROOT, 'test', '--version', **(sourced if 'ROS_DISTRO' in sourced else {}))
    elapsed = time.monotonic() - began
    assert done.returncode == 0, done.stderr
    assert 'setting up' not in done.stderr
    assert elapsed < 2


def test_every_dependency_is_pinned():
    for name in ('requirements-first.txt', 'requirements.txt', 'requirements-test.txt', 'lint.txt', 'controllers.txt'):
        lines = (ROOT / 'setup' / name).read_text().splitlines()
        pins = [line for line in lines if line and not line.startswith('#')]
        assert pins
        assert all(re.fullmatch(r'[\w.-]+==[\w.]+', pin) for pin in pins)


def test_every_pin_has_hashes_of_its_files(tmp_path):
    pins = wheels.read_requirements(ROOT, [wheels.FIRST, *wheels.REQUIREMENTS])
    lines = wheels.read_requirements(ROOT, [wheels.HASHES])
    assert [line.split()[0] for line in lines] == pins
    assert all(re.fullmatch(r'\S+( --hash=sha256:[0-9a-f]{64})+', line) for line in lines)
    environ = {**os.environ, 'PIP_NO_INDEX': '1', 'PIP_FIND_LINKS': str(tmp_path)}
    pin = next(pin for pin in pins if pin.startswith('iniconfig=='))
    (tmp_path / f'{pin.replace("==", "-")}-py3-none-any.whl').write_bytes(b'another file')
    wanted = wheels.with_hashes(ROOT, tmp_path, [pin])
    command = [PYTHON, '-m', 'pip', 'download', '--no-deps', *wanted, '-d', tmp_path / 'got']
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environ)
    assert done.returncode != 0 and 'HASHES' in done.stderr
    with pytest.raises(SetupError, match='lists no file of unknown==1'):
        wheels.with_hashes(ROOT, tmp_path, ['unknown==1'])


def _old_python(version):
    # pyenv keeps its versions side by side.
    candidates = [shutil.which(f'python{version}'), *Path(PYTHON).parents[2].glob(f'{version}.*/bin/python')]
    for candidate in candidates:
        if candidate and subprocess.run([candidate, '-c', ''], capture_output=True, check=False).returncode == 0:
            return str(candidate)
    return None


def test_repair_of_a_wheels_file_leaves_the_cache_alone(tmp_path):
    numpy = Path('site-packages', 'numpy', '_core', 'include')
    site = Path('lib', f'python{sys.version_info[0]}.{sys.version_info[1]}') / numpy
    exported = f'set(INCLUDES "/opt/python/cp311-cp311/lib/python3.11/{numpy};${{PREFIX}}/include")\n'
    cached = tmp_path / 'cached.cmake'
    cached.write_text(exported)
    for name in ('first', 'second'):
        folder = tmp_path / name / 'share'
        folder.mkdir(parents=True)
        os.link(cached, folder / 'export.cmake')  # as uv installs
        wheels.repair(str(tmp_path / name))
        assert f'"{tmp_path / name / site};${{PREFIX}}/include"' in (folder / 'export.cmake').read_text()
    assert cached.read_text() == exported


def test_paths_of_another_setup_are_repaired(tmp_path):
    folder = tmp_path / 'here' / 'share'
    folder.mkdir(parents=True)
    (folder / 'export.cmake').write_text('"/gone/.venv/lib/python3.12/site-packages/numpy/_core/include"\n')
    wheels.repair(str(tmp_path / 'here'))
    assert '/gone' not in (folder / 'export.cmake').read_text()
