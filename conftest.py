"""Environment of all tests: messages check their fields, and what a test starts talks to nobody but itself.

The tests of a package lie in its own `test/`, where `colcon test` looks for them. What needs a package above the one
it examines lies in that upper package's `test/`, so that the packages keep their order: recordings of the proof's
generator are diagnosed in drfmcw_proof, the watch is put into a graph in drfmcw_bringup. What examines the checkout as
a whole lies in `test/`, beside the modules and data that tests share: whole graphs of real processes in `graph/`, the
documents against the code in `documents/`, launcher and dependencies in `installation/`.
"""

import importlib.util
import os
import signal
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent / 'test'))

os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
# `colcon test` of a lower package may find no drfmcw_bringup; those that start many processes have it
if importlib.util.find_spec('drfmcw_bringup'):
    from drfmcw_bringup.graph import private_environment

    os.environ.update(private_environment())

# started in the background (nohup, some CI services) we would pass an ignored Ctrl-C on to the processes under test
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _discovery() -> dict[str, str]:
    own = 'ROS_', 'RMW_', 'FASTDDS_', 'FASTRTPS_'
    return {name: value for name, value in os.environ.items() if name.startswith(own)}


@pytest.fixture(autouse=True, scope='module')
def unchanged_discovery():
    """Refuse a module that leaves the next one, in the same process, a different way to find other processes."""
    before = _discovery()
    yield
    assert _discovery() == before


def _inherited() -> list[str]:
    """What a process that is started now does about signals: those blocked, and those ignored."""
    status = Path('/proc/thread-self/status').read_text()
    return [line for line in status.splitlines() if line.startswith(('SigBlk', 'SigIgn'))]


@pytest.fixture(autouse=True, scope='module')
def unchanged_signals():
    """Refuse a module after which a Ctrl-C does not reach the processes that the next one starts."""
    before = _inherited()
    yield
    assert _inherited() == before


@pytest.fixture(autouse=True, scope='module')
def closed_context():
    """Leave no initialised ROS context to the next module: the default one can be initialised once."""
    yield
    if 'rclpy' in sys.modules:
        sys.modules['rclpy'].utilities.try_shutdown()
