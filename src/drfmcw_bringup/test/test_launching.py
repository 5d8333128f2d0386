"""What the launch files decide, and the launch files themselves where `launch` is installed."""

import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree

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


def launched(file, *arguments, until=None, limit=90.0):
    """(status, output) of `ros2 launch`; SIGINT ends it once the output matches `until`."""
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
            if (until and re.search(until, said)) or time.monotonic() > end:
                process.send_signal(signal.SIGINT)
                until = None
        return process.wait(limit), said


@pytest.mark.graph
@pytest.mark.parametrize(
    ('file', 'arguments', 'said'),
    [
        ('crane.launch.py', ['simulate:=yes'], "Valid options are: ['true', 'false']"),
        ('crane.launch.py', ['rate:=fast'], 'give a number above zero'),
        ('crane.launch.py', ['scenario:=cran'], "did you mean 'crane'"),
        ('crane.launch.py', ['simulate:=false', 'parameters:=nowhere.yaml'], 'nowhere.yaml: no such file'),
        ('station.launch.py', ['station:=master', 'source:=tcp'], 'needs the name of at least one peer'),
        ('station.launch.py', ['station:=master', 'source:=tpc'], "'tcp', 'udp'"),
        ('watch.launch.py', ['pair:=master'], 'wrong configuration (status 2)'),
    ],
)
def test_wrong_launches_end_with_the_reason(file, arguments, said):
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
