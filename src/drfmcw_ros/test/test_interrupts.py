"""What Python reports of destructors, after a Ctrl-C broke off what they belong to."""

import subprocess
import sys

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
