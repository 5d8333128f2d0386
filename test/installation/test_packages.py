"""What the packages declare against what they hold: dependencies, tests, and their place in the checks of .ci/run."""

import ast
import functools
import re
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from checkout import DATA, ROOT

PACKAGES = sorted(path.parent for path in ROOT.glob('src/*/setup.py'))
"""Those with Python code; drfmcw_msgs holds messages only."""

DATA_LIMIT = 15_000_000  # of test/data [bytes]
ROOM_LIMIT = 12  # modules in a room, see docs/architecture.md
REGISTRIES = {'drfmcw_sim/effects'}
"""Rooms with a file for each entry, of which there are as many as there are."""

ROSDEP_KEYS = {
    'PIL': 'python3-pil',
    'cryptography': 'python3-cryptography',
    'fastapi': 'python3-fastapi',
    'h5py': 'python3-h5py',
    'hypothesis': 'python3-hypothesis',
    'jinja2': 'python3-jinja2',
    'markupsafe': 'python3-jinja2',  # rosdep has no key of its own for it; Jinja cannot be without it
    'matplotlib': 'python3-matplotlib',
    'numpy': 'python3-numpy',
    'orjson': 'python3-orjson',
    'psutil': 'python3-psutil',
    'pytest': 'python3-pytest',
    'rich': 'python3-rich',
    'rosbags': 'python3-rosbags-pip',
    'scipy': 'python3-scipy',
    'soundfile': 'python3-soundfile',
    'starlette': 'python3-fastapi',  # which is made of it
    'uvicorn': 'python3-uvicorn',
    'yaml': 'python3-yaml',
}
"""Python module and its key in rosdep/python.yaml of github.com/ros/rosdistro; a ROS package is its own key."""
NO_KEY = {
    'argon2',
    'asyncua',
    'distributed',
    'foxglove',
    'itsdangerous',
    'nicegui',
    'o6',
    'playwright',
    'pyModbusTCP',
    'pyarrow',
    'pymodbus',
    'pyvisa',
    'zarr',
}
"""Unknown to rosdep or too old in it (docs/dependencies.md); optional, of host and gateway (wheels), or tests' own."""
NOT_IMPORTED = {'drfmcw_bringup': {'ros2launch'}}
"""What a package needs beside its imports: the command that runs its launch files."""
NAMED = re.compile(r'(drfmcw_[a-z]+(?=\.\w+)|(drfmcw|std|sensor|diagnostic)_msgs(?=/msg/))[\w./]*$')
"""Modules that a string starts as a process, and messages of recordings."""
LAUNCHED = re.compile(r'(drfmcw_[a-z]+)$')
"""Packages in launch files."""
EVERY_TEST = {'python3-pytest', 'python3-pytest-timeout'}
"""pyproject.toml sets a time limit for each test."""


@functools.cache
def uses(module: Path) -> frozenset[str]:
    """Packages that a module imports, or names in a string; what shared test modules use counts too."""
    found = set()
    for node in ast.walk(ast.parse(module.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            found |= {name.name.partition('.')[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.add(str(node.module).partition('.')[0])
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            named = LAUNCHED.match(node.value) if module.parent.name == 'launch' else NAMED.match(node.value)
            found |= {named[1]} if named else set()
    for name in tuple(found):
        for shared in (ROOT / 'test' / f'{name}.py', module.parent / f'{name}.py'):
            if 'test' in module.relative_to(ROOT).parts and shared.is_file():
                found = found - {name} | uses(shared)
    return frozenset(found - sys.stdlib_module_names)


def needed(package: Path, modules: list[Path]) -> set[str]:
    """Keys that package.xml must name for what these modules use."""
    names = set().union(*map(uses, modules)) - NO_KEY - {package.name}
    return {ROSDEP_KEYS.get(name, name) for name in names}


def declared(package: Path, *kinds: str) -> set[str]:
    """Keys that package.xml names with one of these tags."""
    tree = ElementTree.parse(package / 'package.xml')
    return {str(element.text) for kind in kinds for element in tree.iter(kind)}


def differences(have: set[str], need: set[str]) -> dict[str, list[str]]:
    """What package.xml lacks and what it has too much."""
    both = {'missing': sorted(need - have), 'superfluous': sorted(have - need)}
    return {how: names for how, names in both.items() if names}


def code_of(package: Path) -> list[Path]:
    """Modules and launch files of a package."""
    return sorted([*package.glob(f'{package.name}/**/*.py'), *package.glob('launch/*.py')])


@pytest.mark.parametrize('package', PACKAGES, ids=lambda path: path.name)
def test_package_xml_names_what_is_imported_and_nothing_else(package):
    run = needed(package, code_of(package)) | NOT_IMPORTED.get(package.name, set())
    assert differences(declared(package, 'depend', 'exec_depend'), run) == {}
    tests = needed(package, sorted(package.glob('test/**/*.py'))) | EVERY_TEST
    assert differences(declared(package, 'test_depend'), tests - run) == {}


@pytest.mark.parametrize('package', PACKAGES, ids=lambda path: path.name)
def test_colcon_test_runs_the_tests_of_each_package(package):
    """Ask setup.py what colcon asks it: whether pytest is among what its tests require."""
    assert list(package.glob('test/test_*.py')), 'a package with code has tests'
    code = (
        'import sys, setuptools; from distutils.core import run_setup; '
        "print(*run_setup('setup.py', stop_after='init').extras_require.get('test', []))"
    )
    done = subprocess.run([sys.executable, '-c', code], cwd=package, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ['pytest']


@pytest.mark.parametrize('path', sorted(ROOT.glob('src/*/package.xml')), ids=lambda path: path.parent.name)
def test_every_package_has_a_changelog_that_catkin_reads(path):
    """Title as catkin_generate_changelog writes it; a section for what is not released, or for the version."""
    text = (path.parent / 'CHANGELOG.rst').read_text(encoding='utf-8')
    title = f'Changelog for package {path.parent.name}'
    assert text.startswith(f'{"^" * len(title)}\n{title}\n{"^" * len(title)}\n')
    version = str(ElementTree.parse(path).findtext('version'))
    assert re.search(rf'^(Forthcoming|{re.escape(version)} \(.*\))\n-+\n\* ', text, re.MULTILINE)


@pytest.mark.parametrize('package', PACKAGES, ids=lambda path: path.name)
def test_rooms_are_small_enough_to_be_known(package):
    """A newcomer reads what a room holds at a glance."""
    rooms = [folder for folder in (package / package.name).rglob('*') if folder.is_dir()]
    for room in [package / package.name, *rooms]:
        modules = [path.stem for path in room.glob('*.py') if path.stem != '__init__']
        name = str(room.relative_to(package))
        assert len(modules) <= ROOM_LIMIT or name in REGISTRIES, f'{name} holds {len(modules)} modules: make rooms'


def test_tests_have_names_of_their_own():
    """Two modules of one name cannot be imported in one run."""
    names = [path.name for folder in [ROOT, *PACKAGES] for path in folder.glob('test/**/*.py')]
    assert sorted(names) == sorted(set(names))


def test_checks_know_every_package():
    """A package that import-linter or mypy does not know is not checked."""
    settings = tomllib.loads((ROOT / 'pyproject.toml').read_text(encoding='utf-8'))['tool']
    names = [package.name for package in PACKAGES]
    assert settings['importlinter']['root_packages'] == names
    contracts = {contract['name']: contract for contract in settings['importlinter']['contracts']}
    layers = ' '.join(contracts['Packages import downward only']['layers'])
    assert sorted(layers.replace('|', ' ').split()) == names
    assert contracts['No modules import each other in a circle']['ancestors'] == names
    assert {f'$MYPY_CONFIG_FILE_DIR/src/{name}' for name in names} <= set(settings['mypy']['mypy_path'])


def test_recordings_for_tests_stay_small():
    """Every checkout carries them, and their history."""
    sizes = {path: path.stat().st_size for path in DATA.rglob('*') if path.is_file()}
    largest = sorted(sizes, key=lambda path: sizes[path], reverse=True)[:3]
    assert sum(sizes.values()) <= DATA_LIMIT, [str(path) for path in largest]


def test_no_test_needs_a_path_of_one_machine():
    for path in [ROOT / 'conftest.py', *ROOT.glob('test/**/*.py'), *ROOT.glob('src/*/test/**/*.py')]:
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert not re.match(r'/(work|home|root)/', node.value), (path.name, node.lineno, node.value)
