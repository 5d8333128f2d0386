"""`survey --live`: the running graph is recorded until Ctrl-C, then judged as its recording would be."""

import json
import signal
import subprocess
import sys

import pytest
import yaml
from scenes import mapping

from drfmcw_commissioning.survey.command import main
from drfmcw_commissioning.survey.live import progress

SURVEY = 'drfmcw_commissioning.survey.command'
STANDING = {'standing': {'distances': [100.0], 'sweeps': 1_000_000}}


@pytest.fixture
def hardware(tmp_path):
    """A simulator in the place of the hardware, without any evaluating node: a survey needs what is measured."""
    path = tmp_path / 'scenario.yaml'
    path.write_text(yaml.safe_dump(mapping(STANDING, timing={'sweep_interval': 0.05})))
    settings = (f'scenario:={path}', 'mode_control:=range', 'wait_for_subscribers:=0.0')
    command = [sys.executable, '-m', 'drfmcw_sim.simulator', '--ros-args']
    process = subprocess.Popen(command + [part for setting in settings for part in ('-p', setting)])
    yield
    process.terminate()
    assert process.wait(30.0) == 0


def judged(path):
    """Verdicts of a report: (requirement, result, what was measured)."""
    return [(v['name'], v['result'], v['measured']) for v in json.loads(path.read_text())['verdicts']]


@pytest.mark.usefixtures('hardware')
def test_survey_until_ctrl_c_is_that_of_the_recording(tmp_path):
    command = [sys.executable, '-m', SURVEY, str(tmp_path / 'travel'), '--live', '--json', str(tmp_path / 'live.json')]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        line = next(line for line in process.stdout if 'sweeps: ' in line)
        assert 'of master' in line and 'of slave' in line and 'until Ctrl-C' in line
        process.send_signal(signal.SIGINT)
        said = process.stdout.read()
    assert process.returncode in (0, 1)
    assert 'master/slave' in said
    assert main([str(tmp_path / 'travel'), '--json', str(tmp_path / 'later.json')]) == process.returncode
    assert judged(tmp_path / 'live.json') == judged(tmp_path / 'later.json') != []


def test_nothing_to_survey_is_one_line_and_status_2(tmp_path):
    for arguments, reason in (
        (['--live', '--duration', '1'], 'travel'),
        (['--live', '--duration', '1'], 'exists already'),
        (['--live', '--duration', '0'], '--duration = 0 s must be above zero'),
        (['--duration', '1'], '--duration needs --live'),
    ):
        command = [sys.executable, '-m', SURVEY, str(tmp_path / 'travel'), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 2, done
        lines = [line for line in done.stderr.splitlines() if '[INFO]' not in line]
        assert len(lines) == 1 and reason in lines[0]


def test_progress_says_who_is_missing():
    counts = {'/master/if_samples': 40, '/master/status': 3, '/site/temperature': 1}
    assert progress(2.0, 60.0, counts) == 'recording: 2 of 60 s; sweeps: 40 of master'
    assert progress(2.0, float('inf'), {}) == 'recording: 2 s, until Ctrl-C; no sweep yet'
