"""What the launch files decide, and the launch files themselves where `launch` is installed."""

import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
import types
import xml.etree.ElementTree as ElementTree

import launch_stub
import numpy as np
import pytest
import yaml
from checkout import CONFIG, ROOT
from drfmcw_msgs.msg import BeatFrequency, RangeEstimate, ReferenceRange

from drfmcw_bringup import launching
from drfmcw_fusion.crane.frames import JOINT
from drfmcw_fusion.crane.geometry import SiteGeometry
from drfmcw_physics.settings import ConfigurationError

FILE = CONFIG / 'hardware' / 'two_stations.yaml'


def test_shipped_parameters_give_the_pairs_and_stations():
    pairs = launching.pairs_in(str(FILE))
    assert pairs == ['master/slave']
    assert launching.stations_of(pairs) == ['master', 'slave']
    assert launching.parameter_files(str(FILE)) == [str(FILE)]
    for name in ('two_stations', 'two_stations.yaml'):
        (found,) = launching.parameter_files(name)
        assert launching.pairs_in(name) == launching.pairs_in(found) == pairs and found.endswith('/two_stations.yaml')
    assert launching.parameter_files('') == launching.pairs_in('') == []
    assert launching.has_node(str(FILE), 'fusion') and launching.has_node(str(FILE), 'frames')
    assert not launching.has_node(str(FILE), 'watch') and not launching.has_node('', 'fusion')
    assert launching.stations_of(['a/b', 'a/c', 'd/d']) == ['a', 'b', 'c', 'd']


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        (None, 'no such file, and none of that name in config/hardware/'),
        ('a: [', 'line 1'),
        ('master: 5', 'no ROS parameter file'),
        ('/fusion: {ros__parameters: {pairs: master/slave}}', "is no list of 'first/second'"),
        ('/fusion: {ros__parameters: {pairs: [master]}}', "is no list of 'first/second'"),
    ],
)
def test_wrong_parameter_files_are_refused(tmp_path, text, said):
    path = tmp_path / 'given.yaml'
    if text is not None:
        path.write_text(text, encoding='utf-8')
    with pytest.raises(ConfigurationError, match=said):
        launching.parameter_files(str(path)) and launching.pairs_in(str(path))


def test_arguments_of_a_station_are_its_parameters():
    """Those that are empty stay out: the parameter file or the default gives them."""
    assert set(launching.station_arguments()) >= {'source', 'ip_port', 'peer', 'estimator'}
    given = {'source': 'tcp', 'ip_port': '9000', 'peer': 'slave', 'estimator': ''}
    assert launching.station_parameters(given) == {'source': 'tcp', 'ip_port': 9000, 'peer': 'slave'}
    for name, value, said in (
        ('ip_port', 'nine', 'ip_port'),
        ('ip_port', '99999', 'ip_port'),
        ('source', 'tpc', "'tpc' is not valid"),
    ):
        with pytest.raises(ConfigurationError, match=said):
            launching.station_parameters({name: value})


@pytest.mark.parametrize('text', ['fast', '0', '-1', 'nan', 'inf', ''])
def test_rate_is_a_number_above_zero(text):
    with pytest.raises(ConfigurationError, match='rate:='):
        launching.positive('rate', text)
    assert launching.positive('rate', '2.5') == 2.5


def test_aggregator_puts_each_diagnosis_into_one_group():
    content = yaml.safe_load((CONFIG / 'tools' / 'diagnostic_aggregator.yaml').read_text(encoding='utf-8'))
    groups = [g for g in content['analyzers']['ros__parameters'].values() if isinstance(g, dict)]
    names = [f'{n}: Task' for n in ('/master/station', '/slave_2/station', '/master/pair_station', '/fusion')]
    names += [f'{n}: Task' for n in ('/recorder', '/player', '/simulator', '/watch', '/master/slave/watch')]
    for name in names:
        assert sum(any(part in name for part in group['contains']) for group in groups) == 1, name
    nodes = set()
    for module in ROOT.glob('src/*/drfmcw_*/**/*.py'):
        nodes |= set(re.findall(r"super\(\).__init__\('(\w+)'", module.read_text(encoding='utf-8')))
    known = ' '.join(itertools.chain.from_iterable(group['contains'] for group in groups))
    silent = {'host', 'range_monitor', 'sweep_sender'}
    assert all(f'/{node}: ' in known for node in nodes - silent), nodes


def test_foxglove_plots_fields_that_the_messages_have():
    layout = json.loads((CONFIG / 'tools' / 'foxglove.json').read_text(encoding='utf-8'))
    types = {'range': RangeEstimate, 'reference': ReferenceRange, 'beat_frequency': BeatFrequency}
    paths = [path['value'] for panel in layout['configById'].values() for path in panel.get('paths', [])]
    assert len(paths) >= 8
    for path in paths:
        topic, _, field = path.rpartition('.')
        kind = types['reference' if topic == '/reference/range' else topic.rpartition('/')[2]]
        assert field in kind.get_fields_and_field_types(), path
    panels = set(re.findall(r'"(\w+![\w]+)"', json.dumps(layout['layout'])))
    assert panels == set(layout['configById'])


def test_rviz_and_urdf_use_the_frames_and_topics_of_the_frames_node():
    site = SiteGeometry()
    rviz = yaml.safe_load((CONFIG / 'tools' / 'crane.rviz').read_text(encoding='utf-8'))['Visualization Manager']
    assert rviz['Global Options']['Fixed Frame'] == site.rail_frame
    topics = {display['Topic']['Value'] for display in rviz['Displays'] if 'Topic' in display}
    assert topics == {f'/{site.pair}/pose', f'/{site.pair}/range_sensor'}
    urdf = ElementTree.parse(ROOT / 'src' / 'drfmcw_bringup' / 'urdf' / 'crane.urdf.xacro').getroot()
    defaults = {e.get('name'): e.get('default') for e in urdf.iter('{http://www.ros.org/wiki/xacro}arg')}
    for name in ('rail_frame', 'crane_frame', *(f'{a}_{b}' for a in ('fixed', 'crane') for b in 'xyz')):
        assert defaults[name] == str(getattr(site, name)), name
    assert f'{defaults["fixed_station"]}/{defaults["crane_station"]}' == site.pair
    assert JOINT in {joint.get('name') for joint in urdf.iter('joint')}


def chain(robot, link):
    """Joints from the root of an expanded URDF to a link."""
    above = {joint.find('child').get('link'): joint for joint in robot.iter('joint')}
    found = []
    while link in above:
        found.insert(0, above[link])
        link = above[link].find('parent').get('link')
    return found


def place(robot, link, position):
    """Where a link stands in the root's frame with the crane's joint at `position` [m]."""
    at = np.zeros(3)
    for joint in chain(robot, link):
        origin, axis = joint.find('origin'), joint.find('axis')
        at += np.array(origin.get('xyz').split(), float) if origin is not None else 0.0
        at += position * np.array(axis.get('xyz').split(), float) if joint.get('type') == 'prismatic' else 0.0
    return at


@pytest.mark.parametrize(
    'given', [{}, {'fixed_z': 12.5, 'crane_x': -1.0, 'crane_z': 10.0, 'fixed_y': 2.0, 'rail_frame': 'track'}]
)
def test_urdf_has_the_antennas_where_the_frames_node_takes_them(given):
    """The distance of its antennas at a position of the joint is that from which the node computes the position."""
    xacro = pytest.importorskip('xacro')
    site = SiteGeometry(**given)
    path = ROOT / 'src' / 'drfmcw_bringup' / 'urdf' / 'crane.urdf.xacro'
    expanded = xacro.process_file(str(path), mappings={name: str(value) for name, value in given.items()})
    robot = ElementTree.fromstring(expanded.toxml())
    assert '$' not in ElementTree.tostring(robot, encoding='unicode')
    links = {link.get('name') for link in robot.iter('link')}
    assert links == {site.rail_frame, site.crane_frame, 'master_antenna', 'slave_antenna'}
    roots = {chain(robot, link)[0].find('parent').get('link') for link in links - {site.rail_frame}}
    assert roots == {site.rail_frame}
    for position in (40.0, 1000.0):
        distance = np.linalg.norm(place(robot, 'slave_antenna', position) - place(robot, 'master_antenna', position))
        assert site.position(float(distance), 0.01)[0] == pytest.approx(position, abs=1e-6)


# --- the launch files, evaluated without `launch` ---

SITE = [('drfmcw_fusion', 'fusion', ''), ('drfmcw_node', 'station', 'master'), ('drfmcw_node', 'station', 'slave')]
LAUNCHES = {
    'crane.launch.py': [*SITE, ('drfmcw_sim', 'simulator', '')],
    'crane.launch.py host:=true': [*SITE, ('drfmcw_host', 'host', ''), ('drfmcw_sim', 'simulator', '')],
    'crane.launch.py simulate:=false parameters:=two_stations.yaml': [
        SITE[0],
        ('drfmcw_fusion', 'frames', ''),
        *SITE[1:],
    ],
    'station.launch.py station:=master source:=tcp ip_port:=9000 peer:=slave estimator:=ml': [SITE[1]],
    'watch.launch.py pair:=master/slave findings:=findings': [('drfmcw_diagnosis', 'watch', 'master/slave')],
}


def described(command):
    """The nodes of a launch file with its arguments."""
    file, *arguments = command.split()
    return launch_stub.nodes(ROOT / 'src' / 'drfmcw_bringup' / 'launch' / file, *arguments)


def exited(node, status, shutdown=False):
    """What follows when a node's process has ended with a status, while the launch runs or is shut down."""
    event = types.SimpleNamespace(returncode=status, process_name=f'{node.executable}-1')
    return node.on_exit(event, launch_stub.Context(is_shutdown=shutdown))


@pytest.mark.parametrize('command', LAUNCHES)
def test_every_node_that_dies_comes_back_but_after_a_wrong_configuration(command):
    nodes = described(command)
    assert [(n.package, n.executable, n.namespace) for n in nodes] == LAUNCHES[command]
    for node in nodes:
        assert node.output == 'screen'
        with pytest.raises(ConfigurationError, match=f'{node.executable}-1: wrong configuration'):
            exited(node, 2)
        if node.executable == 'simulator':
            continue
        assert node.respawn is True and node.respawn_delay == launching.RESPAWN_DELAY > 0.0, node.executable
        assert all(exited(node, status) is None for status in (0, 1, -signal.SIGKILL, -signal.SIGSEGV))


@pytest.mark.parametrize('command', LAUNCHES)
def test_every_node_that_comes_back_hears_the_others(command, monkeypatch):
    """Not so through shared memory; unless the environment chooses that."""
    for given, added in ((None, {'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}), ('SHM', {})):
        monkeypatch.delenv('FASTDDS_BUILTIN_TRANSPORTS', raising=False)
        if given is not None:
            monkeypatch.setenv('FASTDDS_BUILTIN_TRANSPORTS', given)
        assert all(n.additional_env == added for n in described(command) if n.executable != 'simulator')


def test_the_end_of_the_scenario_ends_the_launch_and_that_of_the_simulator_fails_it():
    simulator = described('crane.launch.py')[-1]
    assert not simulator.respawn, 'the scenario would begin again'
    (action,) = exited(simulator, 0)
    assert action == launch_stub.Shutdown(reason='the scenario has ended')
    for status, how in ((1, 'status 1'), (-signal.SIGKILL, 'killed by SIGKILL'), (-signal.SIGTERM, 'killed by SIGT')):
        with pytest.raises(ConfigurationError, match=rf'simulator-1: ended before the scenario \({how}'):
            exited(simulator, status)
        assert exited(simulator, status, shutdown=True), 'who stops the launch stops the simulator'


def test_arguments_reach_the_nodes():
    fusion, *stations, simulator = described('crane.launch.py scenario:=tdma rate:=2')
    assert fusion.parameters == [{'pairs': [f'master/slave_{n}' for n in (1, 2, 3)]}]
    assert [s.parameters for s in stations] == [[{'station': s.namespace}] for s in stations]
    assert [s.namespace for s in stations] == ['master', 'slave_1', 'slave_2', 'slave_3']
    assert simulator.parameters == [{'scenario': str(CONFIG / 'tdma.yaml'), 'rate': 2.0}]
    for node in described(f'crane.launch.py simulate:=false parameters:={FILE}'):
        assert node.parameters[-1] == str(FILE), 'a parameter file decides'
    (station,) = described(f'station.launch.py station:=east parameters:={FILE} source:=udp ip_port:=9001 peer:=west')
    given = {'station': 'east', 'source': 'udp', 'ip_port': 9001, 'peer': 'west'}
    assert station.parameters == [str(FILE), given], 'arguments take precedence'
    (watch,) = described('watch.launch.py pair:=a/b')
    assert watch.parameters == [{'pair': 'a/b', 'findings': ''}]


WRONG = [
    ('crane.launch.py simulate:=yes', "Valid options are: ['true', 'false']"),
    ('crane.launch.py host:=1', "Valid options are: ['true', 'false']"),
    ('crane.launch.py rate:=fast', 'give a number above zero'),
    ('crane.launch.py scenario:=cran', "did you mean 'crane'"),
    ('crane.launch.py simulate:=false parameters:=nowhere.yaml', 'nowhere.yaml: no such file'),
    ('crane.launch.py simulate:=false parameters:=two_statoins.yaml', "did you mean 'two_stations'?"),
    ('station.launch.py', '"station" was not provided'),
    ('station.launch.py station:=master source:=tpc', "'tcp', 'udp'"),
    ('station.launch.py station:=master estimator:=mll', "'ml'"),
]
"""What ends a launch before anything starts, and with which reason."""


@pytest.mark.parametrize(('command', 'said'), WRONG)
def test_wrong_arguments_are_refused_with_the_valid_ones(command, said):
    with pytest.raises((RuntimeError, ConfigurationError), match=re.escape(said)):
        described(command)


# --- the launch files, with the real `launch` ---

LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
arguments = [tuple(word.split(':=', 1)) for word in sys.argv[2:]]
service = LaunchService(argv=sys.argv[2:])
source = PythonLaunchDescriptionSource(sys.argv[1])
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(source, launch_arguments=arguments)]))
sys.exit(service.run())
"""


def launched(file, *arguments, until=None, kill='', limit=90.0):
    """(status, output) of `ros2 launch`; SIGINT ends it once the output matches `until`.

    The first process of the executable `kill` gets SIGKILL as soon as it runs.
    """
    pytest.importorskip('launch_ros')
    path = ROOT / 'src' / 'drfmcw_bringup' / 'launch' / file
    command = [sys.executable, '-u', '-c', LAUNCH, str(path), *arguments]
    environment = os.environ | {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    said = ''
    with subprocess.Popen(
        command, env=environment, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        end = time.monotonic() + limit
        for line in process.stdout:
            said += line
            if kill and (found := re.search(rf'\[{kill}-\d+\]: process started with pid \[(\d+)\]', line)):
                os.kill(int(found[1]), signal.SIGKILL)
                kill = ''
            if (until and re.search(until, said)) or time.monotonic() > end:
                process.send_signal(signal.SIGINT)
                until = None
        return process.wait(limit), said


@pytest.mark.graph
@pytest.mark.parametrize(
    ('command', 'said'),
    [
        *WRONG,
        ('station.launch.py station:=master source:=tcp', 'needs the name of at least one peer'),
        ('watch.launch.py pair:=master', 'wrong configuration (status 2)'),
    ],
)
def test_wrong_launches_end_with_the_reason(command, said):
    file, *arguments = command.split()
    status, text = launched(file, *arguments)
    assert status == 1 and said in text, text


@pytest.mark.graph
@pytest.mark.parametrize(
    ('file', 'arguments', 'until'),
    [
        ('crane.launch.py', ['scenario:=tdma', 'rate:=2.0'], r'\d+ sweeps of 3 pair'),
        ('crane.launch.py', ['simulate:=false', f'parameters:={FILE}'], '(?s)127.0.0.1:900[01].*127.0.0.1:900[01]'),
        ('station.launch.py', ['station:=master', 'source:=tcp', 'ip_port:=9000', 'peer:=slave'], '127.0.0.1:9000'),
    ],
)
def test_right_launches_run_until_they_are_interrupted(file, arguments, until):
    _, text = launched(file, *arguments, until=until)
    assert re.search(until, text), text
    assert 'Traceback' not in text and 'process has died' not in text, text


@pytest.mark.graph
def test_killed_fusion_is_started_again():
    started = r'\[fusion-\d+\]: process started'
    _, text = launched('crane.launch.py', kill='fusion', until=f'(?s){started}.*process has died.*{started}')
    assert len(re.findall(started, text)) == 2, text
    assert 'Traceback' not in text, text


@pytest.mark.graph
def test_killed_simulator_ends_the_launch_with_the_reason():
    status, text = launched('crane.launch.py', kill='simulator')
    assert status == 1 and 'ended before the scenario (killed by SIGKILL)' in text, text
    assert 'the scenario has ended' not in text
