"""Running for weeks and in company: signs of life, no pretended security, policies that name what a node needs."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import xml.etree.ElementTree as ET

import pytest
from checkout import ROOT

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.graph.topics import PAIR_TOPICS, SITE_TOPICS, STATION_TOPICS
from drfmcw_ros.operation import keystore
from drfmcw_ros.operation.security import fast_dds_is_secure, policy, refuse_pretence, rights
from drfmcw_ros.operation.watchdog import Watchdog

UNITS = sorted((ROOT / 'src/drfmcw_ros/systemd').glob('*.service'))
PAIRS = [('master', 'slave'), ('master', 'tower')]


@pytest.fixture
def manager(tmp_path):
    """Return a socket as systemd's, and its path."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        path = str(tmp_path / 'notify')
        listening.bind(path)
        listening.settimeout(60.0)
        yield listening, path


def test_watchdog_speaks_to_its_own_service_manager_only(manager):
    listening, path = manager
    ours = Watchdog({'NOTIFY_SOCKET': path, 'WATCHDOG_USEC': '8000000', 'WATCHDOG_PID': str(os.getpid())})
    assert ours.interval == 2.0
    ours.alive()
    assert listening.recv(100) == b'WATCHDOG=1'
    assert Watchdog({'NOTIFY_SOCKET': path, 'WATCHDOG_USEC': '8000000', 'WATCHDOG_PID': '1'}).interval == 0.0
    for environ in ({}, {'NOTIFY_SOCKET': '/nowhere/at/all'}, {'WATCHDOG_USEC': 'x'}):
        Watchdog(environ).alive()


@pytest.mark.graph
def test_a_node_says_that_it_is_ready_alive_and_stopping(manager):
    listening, path = manager
    variables = {'NOTIFY_SOCKET': path, 'WATCHDOG_USEC': '400000', 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'}
    node = subprocess.Popen([sys.executable, '-m', 'drfmcw_fusion.fusion'], env=os.environ | variables)
    try:
        assert [listening.recv(100) for _ in range(4)] == [b'READY=1', *[b'WATCHDOG=1'] * 3]
        node.send_signal(signal.SIGINT)
        said = b'WATCHDOG=1'
        while said == b'WATCHDOG=1':
            said = listening.recv(100)
        assert said == b'STOPPING=1'
        assert node.wait(60) == 0
    finally:
        node.kill()
        node.wait()


def library(folder, content):
    folder.mkdir(exist_ok=True)
    (folder / 'libfastrtps.so').write_bytes(content)
    return {'LD_LIBRARY_PATH': f':{folder}'}


def test_security_is_found_in_the_library_that_is_loaded(tmp_path):
    without = library(tmp_path / 'a', b'\x7fELF' * 100)
    secure = library(tmp_path / 'b', b'\x7fELF dds.sec.auth.builtin.PKI-DH')
    assert fast_dds_is_secure(without) is False and fast_dds_is_secure(secure) is True
    assert fast_dds_is_secure({**without, 'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp'}) is None
    assert fast_dds_is_secure({}) is None
    refuse_pretence({**secure, 'ROS_SECURITY_ENABLE': 'true'})
    refuse_pretence(without)
    with pytest.raises(ConfigurationError, match='built without security'):
        refuse_pretence({**without, 'ROS_SECURITY_ENABLE': 'true'})


@pytest.mark.graph
@pytest.mark.skipif(fast_dds_is_secure(os.environ) is not False, reason='this Fast DDS has security, or is not known')
def test_no_node_starts_open_where_security_is_asked_for(tmp_path):
    variables = {'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_KEYSTORE': str(tmp_path)}
    command = [sys.executable, '-m', 'drfmcw_fusion.fusion']
    done = subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr.count('\n')) == (2, 1) and 'without security' in done.stderr


def test_policy_names_topics_of_the_contract_and_no_others():
    for feed in (False, True):
        tree = ET.fromstring(policy(rights(PAIRS, feed)))
        named = {element.text for element in tree.iter('topic')}
        stations = {f'/{s}/{t}' for s in ('master', 'slave', 'tower') for t in STATION_TOPICS}
        ranges = {f'/{a}/{b}/{t}' for a, b in PAIRS for t in PAIR_TOPICS}
        others = {'/rosout', '/parameter_events', '/clock', '/diagnostics', '~/transition_event'}
        assert named <= stations | ranges | set(SITE_TOPICS) | others
        assert ranges <= named


def test_no_node_may_publish_what_another_one_measures():
    """Ranges come from fusion alone; what a station publishes bears its own name."""
    for node in rights(PAIRS, feed=True):
        own = [topic for topic in node.publish if topic != '/diagnostics']
        if node.node == 'station':
            assert own and all(topic.startswith(node.namespace + '/') for topic in own)
            assert not any(topic.endswith('_request') for topic in own)
        elif node.node == 'fusion':
            names = '/(range|range_sensor|range_batch|sweep_request|schedule_request)$'
            assert all(re.search(names, topic) for topic in own)
        else:
            assert own == []


def test_keystore_refuses_to_pretend(tmp_path, monkeypatch, capsys):
    for name, value in library(tmp_path / 'lib', b'nothing').items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp')
    assert keystore.main([str(tmp_path / 'store')]) == 2
    assert 'would protect nothing' in capsys.readouterr().err and not (tmp_path / 'store').exists()
    assert keystore.main([str(tmp_path / 'store'), '--pair', '../../etc/x', '--policy-only']) == 2
    assert keystore.main([str(tmp_path / 'store'), '--pair', 'a/b', '--policy-only']) == 0
    assert ET.parse(tmp_path / 'store/policy.xml').getroot().tag == 'policy'
    assert '/drfmcw/a/station' in capsys.readouterr().out


@pytest.mark.skipif(not shutil.which('systemd-analyze'), reason='no systemd here')
def test_units_are_what_systemd_takes(tmp_path):
    """With programs that exist in place of /opt/drfmcw, nothing is wrong with them."""
    for unit in UNITS:
        text = unit.read_text(encoding='utf-8').replace('/opt/drfmcw/drfmcw', '/bin/true')
        assert 'WatchdogSec=' in text and 'Type=notify' in text and 'Restart=always' in text
        (tmp_path / unit.name.replace('@', '@x')).write_text(text, encoding='utf-8')
    names = [str(path) for path in sorted(tmp_path.iterdir())]
    done = subprocess.run(
        ['systemd-analyze', 'verify', '--man=no', *names], capture_output=True, text=True, timeout=60, check=False
    )
    assert len(names) == 6 and not [line for line in done.stderr.splitlines() if 'drfmcw' in line], done.stderr
