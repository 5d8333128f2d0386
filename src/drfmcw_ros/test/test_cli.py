"""What every command line makes of errors."""

import errno
import signal
import subprocess
import sys

import pytest

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import guarded
from drfmcw_ros.work import children


def raising(error):
    def work():
        raise error

    return work


def missing():
    open('/nowhere/at/all', 'rb').close()


@pytest.mark.parametrize(
    ('work', 'line'),
    [
        (raising(ConfigurationError('a = 1\n is not 2')), 'drfmcw x: a = 1 is not 2\n'),
        (raising(FileExistsError(errno.EEXIST, 'File exists', '/tmp/a')), 'drfmcw x: /tmp/a: File exists\n'),
        (raising(OSError(errno.ENOSPC, 'No space left on device')), 'drfmcw x: No space left on device\n'),
        (missing, 'drfmcw x: /nowhere/at/all: No such file or directory\n'),
    ],
)
def test_wrong_input_and_the_system_are_one_line_and_status_2(work, line, capsys):
    assert guarded('drfmcw x', work) == 2
    assert capsys.readouterr().err == line


@pytest.mark.parametrize(('work', 'status'), [(lambda: None, 0), (lambda: 3, 3), (raising(KeyboardInterrupt()), 130)])
def test_other_ends_are_silent(work, status, capsys):
    assert guarded('drfmcw x', work) == status
    assert capsys.readouterr().err == ''


def test_faults_of_the_program_are_not_hidden():
    with pytest.raises(ZeroDivisionError):
        guarded('drfmcw x', lambda: 1 // 0)


BEGIN = children.command('drfmcw_ros.bag.info', '/nowhere/at/all')


def test_ctrl_c_while_the_interpreter_starts_is_silent():
    """It is sent at once, so it waits until `begin` takes it, ahead of all imports of the module."""
    process = subprocess.Popen(BEGIN, stderr=subprocess.PIPE, start_new_session=True, preexec_fn=children.prepare)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=120) == (None, b'')
    assert process.returncode == -signal.SIGINT


SWALLOWING = """
import os, signal, sys, time, weakref
from drfmcw_ros.commands.cli import guarded

def interrupt(reference=None):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.0)  # Python raises it here at the latest

class Object:
    pass

class Destroyed:
    __del__ = interrupt

def work():
    if sys.argv[1] == 'destructor':
        Destroyed()
    else:
        lock = Object()
        reference = weakref.ref(lock, interrupt)  # as of the lock of a module that is being imported
        del lock
    time.sleep(120.0)

sys.exit(guarded('drfmcw x', work))
"""


@pytest.mark.parametrize('where', ['destructor', 'weak reference'])
def test_ctrl_c_that_python_swallows_ends_the_process_all_the_same(where):
    ended = subprocess.run([sys.executable, '-c', SWALLOWING, where], capture_output=True, timeout=60, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, b'', b'')


def test_a_module_that_was_begun_is_the_main_one():
    direct = [*BEGIN[:2], *BEGIN[3:]]
    one, other = (subprocess.run(words, capture_output=True, timeout=120, check=False) for words in (BEGIN, direct))
    assert (one.returncode, one.stdout, one.stderr) == (other.returncode, other.stdout, other.stderr)
    assert one.returncode == 2 and one.stderr.count(b'\n') == 1


def test_node_that_lacks_a_device_may_be_started_again():
    """Status 2 is final for whoever supervises it; what the system refuses now may be there later."""
    program = """
from drfmcw_ros.commands.cli import guarded
from drfmcw_ros.nodes.runner import run

def node():
    open('/nowhere/at/all')

raise SystemExit(guarded('drfmcw x', lambda: run(node, [])))
"""
    ended = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True, timeout=120, check=False)
    assert (ended.returncode, ended.stderr) == (1, 'drfmcw: /nowhere/at/all: No such file or directory\n')


@pytest.mark.parametrize('kind', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('instead', ["raise RuntimeError('no object')", 'return'])
def test_signal_whose_exception_is_lost_ends_a_node(kind, instead):
    """rclpy raises an error of its own where a signal meets it as it makes a message."""
    program = f"""
import time
from rclpy.node import Node
from drfmcw_ros.nodes.runner import run

class Busy(Node):
    def __init__(self):
        super().__init__('busy')
        self.create_timer(0.01, self.work)

    def work(self):
        try:
            print('works', flush=True)
            time.sleep(60.0)
        except KeyboardInterrupt:
            {instead}

raise SystemExit(run(Busy, []))
"""
    words = [sys.executable, '-c', program]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == 'works\n'
        process.send_signal(kind)
        said = process.communicate(timeout=120)
    assert (process.returncode, *said) == (0, '', '')
