"""Every command that README.md and the documents print is executed as printed, beside the files that it asks for.

Sizes are smaller, and paths and addresses this machine's, only where a list below says so. Nodes are interrupted once
they are ready, and must end cleanly.
"""

import contextlib
import functools
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from checkout import CONFIG, DATA, ROOT
from documented import LIMIT, commands, fixed_ports, matching, started
from scenes import mapping, record

from drfmcw_bringup.graph import SIMULATOR, Graph, free_domain_id, parameters
from drfmcw_bringup.run import start_nodes
from drfmcw_commissioning import calibrate
from drfmcw_gateway import gateway
from drfmcw_physics.settings import read_yaml
from drfmcw_ros.operation.security import fast_dds_is_secure
from drfmcw_sim.scenario import read_scenario, scenario_from_mapping

pytestmark = [pytest.mark.graph, pytest.mark.slow]

COMMANDS = list(commands())

NOT_EXECUTED = {
    r'\./drfmcw test$': 'runs this test, too',
    r'\./drfmcw (reproduce|bench)$': 'takes from ten minutes to hours; tests of their packages run parts of them',
    r'^git clone|^mkdir -p ws|^rosdep|^colcon': 'installs this repository, with ROS 2 Jazzy',
    r'^useradd|^cp install/|^systemctl': 'changes the computer, as its administrator',
    r'^python3.11 -m venv': 'looks for new versions of all dependencies at the package index',
    r'^export ROS_SECURITY': 'switches SROS2 on for what comes next; test_operation.py does so',
    r'calibrate station \w+ --counter': 'asks an instrument; test_calibrate_station.py has a simulated one',
    r'drfmcw import raw/': 'reads files of other radars, which are not in the repository',
    r'host --set-password': 'asks a person; test_host_access.py gives the answer',
}
"""What is not executed, and why."""

SHORTER = {
    r'\./drfmcw demo$|\./drfmcw demo --stay$': (r'$', ' --scenario short.yaml', 'drives 2 km'),
    r'\./drfmcw demo --scenario tdma': ('tdma ', 'short.yaml ', 'measures a minute'),
    r'simulate (config/)?gantry.* --out': (r'$', ' --set pairs.0.standing.sweeps=4', '10 000 sweeps'),
    r'simulate (config/)?crane.* --out': (r'$', ' --set pairs.0.drive.waypoints=[40,44]', '6689 sweeps'),
    r'simulate far\.yaml': (r'$', ' --set pairs.0.standing.sweeps=40', '8000 sweeps'),
    r'montecarlo': (r'( --trials \d+|$)', ' --trials 2 --jobs 1', '2000 trials at each point'),
    r'replay \w+ --publish --rate 2': ('--rate 2', '--rate 20', 'takes half as long as the recording'),
    r'rehearse --times 200': ('200', '2', 'takes minutes'),
    r'--duration \d+': (r'--duration \d+', '--duration 6', 'records minutes'),
}
"""What is made shorter: where, by what, and what the command does as printed."""

HERE = {'/etc/drfmcw/clients': 'clients', '/etc/drfmcw': 'etc', '10.0.7.1': '127.0.0.1'}
"""Paths that need an administrator and addresses of another network: what stands for them."""

RUNS_ON = (
    r'drfmcw (station|pair|fusion|foxglove|watch|host|run) |drfmcw (foxglove|host)$',
    r'drfmcw gateway --(pair|certificate)',
    r'drfmcw (demo --stay|simulate config/crane.yaml$|record \w+( --measured)?$)',
    r'ros2 launch|ros2 run \w+ (station|pair_station|fusion|simulator|watch|host|gateway) ',
)
"""What runs until it is interrupted."""

BESIDE_A_GRAPH = r'drfmcw record|survey \w+ --live'
"""What needs a running graph; each finds the same one."""

BESIDE = {
    r'calibrate push': './drfmcw station --station master --ros-args -p source:=tcp -p ip_port:=0 -p peer:=slave',
    r'send_sweeps': './drfmcw station --station master --ros-args -p source:=tcp -p peer:=slave -p feed_key:=feed.key',
}
"""What needs one other command that runs on, and which."""

BEFORE = {r'gateway --certificate': './drfmcw gateway --make-certificate etc/gateway'}
"""What needs that another command has ended, and which."""

STATUSES = {
    r'drfmcw survey': {0, 1},  # 1: these few sweeps do not meet the customer's requirements
    r'drfmcw keystore': {0} if fast_dds_is_secure(os.environ) else {2},  # a Fast DDS without security is refused
}
"""Exit statuses other than 0 that are right."""


def executed() -> list:
    """Every command that is executed, as a parameter of a test."""
    return [pytest.param(c, id=f'{c.place} {c.text[:60]}') for c in COMMANDS if not matching(c.text, NOT_EXECUTED)]


# --- what the commands ask for ---


@functools.cache
def _prepared(folder: Path) -> Path:
    """A directory with recordings, settings and documents of the names that the commands give them."""
    folder.mkdir()
    standing = {'standing': {'distances': [60.0, 200.0, 400.0, 640.0], 'sweeps': 24, 'move_time': 0.5}}
    common = {'timing': {'sweep_interval': 0.02}, 'reference': {'range_std': 0.005}}
    (folder / 'short.yaml').write_text(yaml.safe_dump(mapping(standing, **common)), encoding='utf-8')
    record(read_scenario(folder / 'short.yaml'), folder / 'gantry')
    for name in ('yard', 'travel', 'crane', 'RECORDING', 'recording'):
        shutil.copytree(folder / 'gantry', folder / name)
    shutil.copytree(DATA / 'ros2_bags' / 'splitfile', folder / 'run1')
    cable = read_yaml(CONFIG / 'cable.yaml') | {'reference': {'enabled': False}}
    pair = cable['pairs'][0]
    cable['pairs'] = [pair | {'standing': {'distances': [15.0 / 1.0003], 'sweeps': 24}}]
    record(scenario_from_mapping(cable, 'cable'), folder / 'cable')
    cable['pairs'] = [cable['pairs'][0] | {'path_loss': 300.0}]
    record(scenario_from_mapping(cable, 'dark'), folder / 'dark')
    readings = [f'reference,{1e8 * (1 + 6e-6 - 2e-7 * t)!r},{25 + t}\nadc,{2.048e6 * (1 + 6e-6)!r},{25 + t}'
                for t in (-30, -20, -10, 0, 10, 20)]  # fmt: skip
    for name in ('master.csv', 'readings.csv'):
        (folder / name).write_text('\n'.join(['clock,frequency,temperature', *readings, '']), encoding='utf-8')
    (folder / 'marks.csv').write_text('range,std\n60,0.003\n200,0.003\n400,0.003\n640,0.003\n', encoding='utf-8')
    for station in ('master', 'slave'):
        given = ['--csv', str(folder / 'master.csv'), '--state', str(folder / 'none')]
        assert calibrate.main(['station', station, *given, '--out', str(folder / f'{station}.calibration.yaml')]) == 0
    _write_foreign(folder)
    velocity = (ROOT / 'docs' / 'velocity.md').read_text(encoding='utf-8')
    (folder / 'far.yaml').write_text(re.findall(r'```yaml\n(.*?)```', velocity, re.DOTALL)[-1], encoding='utf-8')
    subprocess.run(['sh', '-c', 'umask 077; printf %064d 7 > feed.key'], cwd=folder, check=True)
    assert gateway.main(['--make-certificate', str(folder / 'clients')]) == 0
    (folder / 'clients' / 'key.pem').unlink()
    for path in ROOT.glob('src/*/README.md'):
        target = folder / path.relative_to(ROOT)
        target.parent.mkdir(parents=True)
        shutil.copyfile(path, target)
    return folder


def _write_foreign(folder: Path) -> None:
    """Write a radar's file under the names of the documents: a line in 32 chirps of 512 samples, and what made it."""
    t = np.arange(512) / 1e6
    rng = np.random.default_rng(5)
    samples = np.rint(1000.0 * np.cos(2 * np.pi * 61e3 * t) + rng.normal(0.0, 20.0, (32, 512))).astype(np.int16)
    radar = {'start_frequency': 24e9, 'bandwidth': 200e6, 'ramp_duration': 512e-6, 'sample_rate': 1e6}
    settings = {'radar': radar, 'layout': {'axes': ['chirp', 'sample'], 'shape': [-1, 512]}, 'samples': {'bits': 16}}
    for name in ('FILE', 'radar.npy'):
        with open(folder / name, 'wb') as file:
            np.save(file, samples)
    samples.tofile(folder / 'radar.bin')
    (folder / 'S.yaml').write_text(yaml.safe_dump(settings | {'format': 'numpy'}), encoding='utf-8')
    (folder / 'settings.yaml').write_text(yaml.safe_dump(settings), encoding='utf-8')


@pytest.fixture
def place(tmp_path, tmp_path_factory):
    """Prepare the directory in which commands are executed: what they name, but for what they write."""

    def prepare(texts: list[str], written: set[str]) -> Path:
        source = _prepared(tmp_path_factory.getbasetemp() / 'prepared')
        named = {name for text in texts for name in re.split(r'[\s/=]+', text)}
        for path in source.iterdir():
            if path.name in named - written:
                copy = shutil.copytree if path.is_dir() else shutil.copy2
                copy(path, tmp_path / path.name)
        (tmp_path / 'config').symlink_to(CONFIG)
        (tmp_path / 'test').symlink_to(ROOT / 'test')
        return tmp_path

    return prepare


@pytest.fixture(scope='module')
def graph(tmp_path_factory):
    """The environment in which a graph runs, and goes on."""
    folder = tmp_path_factory.mktemp('graph')
    standing = {'standing': {'distances': [100.0], 'sweeps': 1_000_000}}
    path = folder / 'scenario.yaml'
    path.write_text(yaml.safe_dump(mapping(standing, timing={'sweep_interval': 0.1})), encoding='utf-8')
    environment = os.environ | {'ROS_DOMAIN_ID': str(free_domain_id())}
    with Graph(environment, folder / 'log') as running:
        start_nodes(running, read_scenario(path))
        running.start('simulator', SIMULATOR, *parameters({'scenario': str(path)}))
        yield environment


# --- the commands ---


def shorter(text: str) -> str:
    """A command as it is executed."""
    for pattern, (what, by, _) in SHORTER.items():
        if re.search(pattern, text):
            text = re.sub(what, by, text, count=1)
    for there, here in HERE.items():
        text = text.replace(there, here)
    return text


@pytest.mark.parametrize('command', executed())
def test_command_of_the_documents_does_what_it_is_for(command, place, request):
    text = shorter(command.text)
    beside, before = BESIDE.get(matching(text, BESIDE) or ''), BEFORE.get(matching(text, BEFORE) or '')
    folder = place([text, beside or '', before or ''], command.written)
    environment = os.environ | {'XDG_STATE_HOME': str(folder / 'state'), 'MPLCONFIGDIR': str(folder / 'state')}
    environment['ROS_DOMAIN_ID'] = str(free_domain_id())
    if re.search(BESIDE_A_GRAPH, text):
        environment['ROS_DOMAIN_ID'] = request.getfixturevalue('graph')['ROS_DOMAIN_ID']
    if before:
        execute(before, folder, environment)
    with contextlib.ExitStack() as stack:
        if beside:
            stack.enter_context(running(beside, folder, environment))
        if matching(text, RUNS_ON):
            stack.enter_context(running(text, folder, environment))
        else:
            execute(text, folder, environment)
    for name in command.written:
        assert (folder / name).exists(), f'{command.text} wrote no {name}'


@contextlib.contextmanager
def running(text: str, folder: Path, environment: dict[str, str]) -> Iterator[None]:
    """Let a command run on until it is interrupted, and end cleanly."""
    with fixed_ports(), started(text, folder, environment) as run:
        run.wait_until_ready()
        yield
        assert set(run.interrupt()) <= {0, 130}, run.said()
        assert 'Traceback' not in run.said(), run.said()


def execute(text: str, folder: Path, environment: dict[str, str]) -> None:
    """Execute a command that ends by itself, with the status that is right."""
    with started(text, folder, environment) as run:
        right = STATUSES.get(matching(text, STATUSES) or '', {0})
        assert set(run.wait(LIMIT)) <= right, run.said()
        assert 'Traceback' not in run.said(), run.said()


def test_lists_name_commands_that_the_documents_print():
    """No entry of a list is left over."""
    texts = [command.text for command in COMMANDS]
    assert len(texts) > 100
    for pattern in (*NOT_EXECUTED, *SHORTER, *HERE, *RUNS_ON, BESIDE_A_GRAPH, *BESIDE, *BEFORE, *STATUSES):
        assert any(re.search(pattern, text) for text in texts), pattern


def test_code_of_the_velocity_document_runs():
    (code,) = re.findall(r'```python\n(.*?)```', (ROOT / 'docs' / 'velocity.md').read_text(encoding='utf-8'), re.DOTALL)
    ended = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, timeout=LIMIT)
    assert ended.returncode == 0 and len(ended.stdout.split()) == 2, ended.stderr
