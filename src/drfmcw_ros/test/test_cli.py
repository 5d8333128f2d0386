"""What every command line makes of errors."""

import errno

import pytest

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.cli import guarded


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
