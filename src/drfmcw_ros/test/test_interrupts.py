"""What Python makes of a Ctrl-C that breaks off an object or code given as text."""

import subprocess
import sys

import pytest

OBJECT = 'from rclpy.task import Future; from drfmcw_ros.commands.interrupts import keep; keep(); '


def said(code):
    found = subprocess.run(
        [sys.executable, '-c', OBJECT + code], capture_output=True, text=True, check=True, timeout=60
    )
    return found.stderr


def test_a_broken_off_object_of_rclpy_says_nothing():
    assert said('x = Future.__new__(Future); del x') == ''


def test_any_other_destructor_that_fails_is_reported():
    assert 'AttributeError' in said("X = type('X', (), {'__del__': lambda self: self.absent}); X()")


@pytest.mark.parametrize(
    'program',
    [
        "from drfmcw_ros.commands.cli import guarded; raise SystemExit(guarded('x', lambda: exec(BROKEN_OFF)))",
        'from drfmcw_ros.nodes.runner import run; raise SystemExit(run(lambda: exec(BROKEN_OFF)))',
    ],
    ids=['command', 'node'],
)
def test_a_ctrl_c_in_code_given_as_text_ends_with_the_status_of_the_command(program, tmp_path):
    code = f"BROKEN_OFF = 'import os, signal; os.kill(os.getpid(), signal.SIGINT)'; {program}"
    (tmp_path / 'command.py').write_text(code, encoding='utf-8')
    found = subprocess.run(
        [sys.executable, '-m', 'command'], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert (found.returncode, found.stderr) in {(130, ''), (0, '')}
