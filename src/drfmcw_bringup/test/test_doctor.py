"""What the doctor says of environments, files, and graphs that are right or wrong."""

import os
import subprocess
import sys

import pytest
import rclpy
from checkout import CONFIG
from drfmcw_msgs.msg import BeatFrequency
from rclpy.node import Node

from drfmcw_bringup.doctor import machine
from drfmcw_bringup.doctor.files import check_file
from drfmcw_bringup.doctor.finding import ERROR, OK, WARN
from drfmcw_bringup.doctor.graph import check_graph
from drfmcw_bringup.graph import BY_PROFILE, ON_THIS_MACHINE, free_domain_id
from drfmcw_ros.graph import qos
from drfmcw_ros.nodes.runner import spinning

FILES = [p for p in (*CONFIG.glob('*.yaml'), *CONFIG.glob('hardware/*.yaml')) if p.stem != 'requirements']
"""Scenarios and parameter files."""


@pytest.mark.parametrize(
    ('variables', 'subject', 'level'),
    [
        ({}, 'domain', OK),
        ({'ROS_DOMAIN_ID': '42'}, 'domain', OK),
        ({'ROS_DOMAIN_ID': '150'}, 'domain', WARN),
        ({'ROS_DOMAIN_ID': '233'}, 'domain', ERROR),
        ({'ROS_DOMAIN_ID': 'crane'}, 'domain', ERROR),
        ({}, 'range', OK),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}, 'range', OK),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'localhost'}, 'range', ERROR),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'}, 'range', WARN),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF', 'ROS_STATIC_PEERS': '10.0.0.2'}, 'range', OK),
        ({'ROS_LOCALHOST_ONLY': '1'}, 'range', WARN),
        ({}, 'transport', WARN),
        ({'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}, 'transport', OK),
        ({'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4', **ON_THIS_MACHINE}, 'transport', WARN),  # which overrides it
        (BY_PROFILE, 'transport', OK),
    ],
)
def test_environment(variables, subject, level):
    found = [f for f in machine.environment(variables) if f.subject == subject]
    assert max((f.level for f in found), key=[OK, WARN, ERROR].index) == level
    assert all(f.advice for f in found if f.level != OK), 'says what to do'


def test_another_distribution_is_an_error():
    assert [f.level for f in machine.versions({'ROS_DISTRO': 'humble'})] == [ERROR, OK]
    assert [f.level for f in machine.versions({'ROS_DISTRO': 'jazzy'})] == [OK]


def test_multicast_that_does_not_come_back_has_a_reason():
    assert machine.multicast_trouble('192.0.2.1'), 'an address that this machine does not have'


def test_full_disk_and_forbidden_folder(tmp_path):
    """More free space is asked for than any disk has; a path below a file cannot be written."""
    assert machine._folder('logs', tmp_path, 1e30, 0.0).level == WARN
    assert machine._folder('logs', tmp_path, 1e30, 1e29).level == ERROR
    assert machine._folder('logs', tmp_path / 'not' / 'there', 0.0, 0.0).level == OK, 'can be made'


@pytest.mark.parametrize('file', FILES, ids=lambda p: p.stem)
def test_shipped_files_are_right(file):
    assert ERROR not in [f.level for f in check_file(file)]


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('/master/station: {ros__parameters: {estimatr: ml}}', "did you mean 'estimator'"),
        ('/master/station: {ros__parameters: {estimator: mll}}', "'mll' is not valid"),
        ('/master/station: {ros__parameters: {ip_port: 99999}}', 'ip_port'),
        ('/master/station: {ros__parameters: {sweep: {ramp: 1.0}}}', "no parameter 'sweep.ramp'"),
        ('master: {station: {ros__parameters: {window: 7}}}', 'window must be a string'),
        ('fusion: {ros__parameters: {integrity: {nothing: 1}}}', "no parameter 'integrity.nothing'"),
        ('drive: 5', 'drive'),
        ('a: [', 'line 1'),
    ],
)
def test_wrong_files_are_named_with_what_is_wrong(tmp_path, text, said):
    path = tmp_path / 'given.yaml'
    path.write_text(text, encoding='utf-8')
    (found,) = [f for f in check_file(path) if f.level == ERROR]
    assert said in found.line() and found.advice


@pytest.mark.graph
def test_nodes_that_do_not_hear_each_other_are_named():
    """A best-effort publisher and a reliable subscriber; two stations of one name; stamps of another time."""
    domain = free_domain_id()
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    one, two = (Node(name, namespace='/master', context=context) for name in ('station', 'rival'))
    beats = one.create_publisher(BeatFrequency, 'beat_frequency', qos.SENSOR)
    two.create_publisher(BeatFrequency, 'beat_frequency', qos.RELIABLE)
    controller = Node('controller', context=context)
    controller.create_subscription(BeatFrequency, '/master/beat_frequency', print, qos.RELIABLE)
    one.create_timer(0.1, lambda: beats.publish(BeatFrequency()))
    try:
        with spinning(one):
            lines = [f.line() for f in check_graph(5.0, domain)]
    finally:
        for node in (one, two, controller):
            node.destroy_node()
        context.try_shutdown()
    text = '\n'.join(lines)
    assert '/controller hears nothing of /master/station: Best effort publisher' in text
    assert '2 publishers on /master/beat_frequency: /master/rival, /master/station' in text
    assert 's before the system clock' in text
    assert not any('/master/rival:' in line for line in lines), 'that one is heard'


@pytest.mark.graph
def test_status_is_1_where_a_line_says_error(tmp_path):
    environment = os.environ | {'ROS_DOMAIN_ID': '233', 'ROS_LOG_DIR': str(tmp_path)}
    command = [sys.executable, '-m', 'drfmcw_bringup.doctor.command', '--seconds', '0']
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 1 and ended.stderr == ''
    assert [line.split()[1] for line in ended.stdout.splitlines() if line.startswith('ERROR')] == ['domain']
    assert 'discovery' not in ended.stdout, 'no node is started that cannot start'
