"""Stations for real hardware start as the shipped parameter file says; wrong input is one line, status 2."""

import os
import subprocess
import sys

import pytest
from checkout import CONFIG

FILE = CONFIG / 'hardware' / 'two_stations.yaml'


def outcome(arguments, limit, **environment):
    """(status, None where it still ran after `limit` seconds; stderr) of a station."""
    command = [sys.executable, '-m', 'drfmcw_node.station', *arguments]
    with subprocess.Popen(command, env=os.environ | environment, stderr=subprocess.PIPE, text=True) as process:
        try:
            status = process.wait(limit)
        except subprocess.TimeoutExpired:
            status = None
            process.terminate()
        return status, process.stderr.read()


@pytest.mark.parametrize('station', ['master', 'slave'])
def test_station_runs_with_the_shipped_parameters(station):
    remap = ('--ros-args', '-r', f'__ns:=/{station}', '--params-file', str(FILE), '-p', 'ip_port:=0')
    status, said = outcome(remap, 6.0)
    assert status is None, said


@pytest.mark.parametrize(
    ('arguments', 'environment', 'expected'),
    [
        (['--station', 'a', '--ros-args', '-p'], {}, "Couldn't parse"),
        (['--station', 'a', '--ros-args', '--params-file', '/none'], {}, '/none'),
        (['--station', 'a'], {'ROS_DOMAIN_ID': 'abc'}, 'ROS_DOMAIN_ID is not an integral number'),
    ],
)
def test_wrong_ros_arguments_are_one_line(arguments, environment, expected):
    status, said = outcome(arguments, 30.0, **environment)
    assert status == 2
    assert 'Traceback' not in said
    assert expected in said
    assert said.count('drfmcw: ') == 1, 'beside the log line of rcl'
