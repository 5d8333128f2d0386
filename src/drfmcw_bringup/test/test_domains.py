"""A graph of one's own gets a domain in which nobody else is."""

import contextlib
import json
import os
import socket
import subprocess
import sys

import pytest

from drfmcw_bringup import graph
from drfmcw_bringup.graph import free_domain_id, private_environment
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.operation.security import uses_fast_dds

PARTICIPANT = """
import json, os, rclpy
from pathlib import Path

rclpy.init()
node = rclpy.create_node('participant')
mapped = [line for line in Path('/proc/self/maps').read_text().splitlines() if '/dev/shm/fastrtps' in line]
own = {os.readlink(link) for link in Path('/proc/self/fd').iterdir() if link.is_symlink()}
bound = [line.split() for line in Path('/proc/self/net/udp').read_text().splitlines()[1:]]
print(json.dumps([mapped, [columns[1] for columns in bound if f'socket:[{columns[9]}]' in own]]))
"""
"""A node: what it maps of Fast DDS's shared memory, and the addresses (hexadecimal) and ports that it listens to."""


def test_domain_is_taken_while_any_of_its_participants_runs():
    """The participant of the lowest port may have ended before the others (RTPS 2.2, 9.6.1.1: 7410 + 250 d + 2 p)."""
    quiet = set(range(71, 102))
    with contextlib.ExitStack() as stack:
        for domain in set(range(1, 102)) - quiet:
            later = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            with contextlib.suppress(OSError):  # another test's participant is as good
                later.bind(('', 7410 + 250 * domain + 2 * 3))
        found = [free_domain_id() for _ in range(6)]
        assert set(found) <= quiet
        assert len(set(found)) == len(found)


def test_domain_of_the_environment_is_nobodys_own(monkeypatch):
    """Who looks there hears nothing of a graph in a domain of its own, even if nobody has been there so far."""
    monkeypatch.setattr(graph, '_LARGEST_DOMAIN', 1)
    monkeypatch.setenv('ROS_DOMAIN_ID', '1')
    with pytest.raises(ConfigurationError):
        free_domain_id()


@pytest.mark.skipif(not uses_fast_dds(os.environ), reason='our profile is one of Fast DDS')
def test_nodes_of_a_private_environment_talk_over_the_loopback_alone():
    """Not through shared memory, which may leave one deaf that was killed and started again."""
    command = [sys.executable, '-c', PARTICIPANT]
    done = subprocess.run(command, env=private_environment(), capture_output=True, text=True, timeout=60, check=True)
    mapped, bound = json.loads(done.stdout.splitlines()[-1])
    assert not mapped
    assert bound and {address.partition(':')[0] for address in bound} == {'0100007F'}  # 127.0.0.1
