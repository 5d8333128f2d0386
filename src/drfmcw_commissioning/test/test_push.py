"""`calibrate push`: a document goes to a running station, which takes it or says why not."""

import dataclasses
import subprocess
import sys

import pytest

pytest.importorskip('rclpy')
from drfmcw_commissioning.calibrate import main  # noqa: E402
from drfmcw_ros.calibration.document import Clock, Delay, Document, Temperatures  # noqa: E402
from drfmcw_ros.calibration.store import CalibrationStore  # noqa: E402

DOCUMENT = Document(
    'master', temperature=Temperatures(25.0, -10.0, 45.0), reference_clock=Clock(1.000037, 2e-8), delay=Delay(12.3e-9)
)
PATIENT = ('--timeout', '120')  # on a busy machine [s]


@pytest.fixture(scope='module')
def station(tmp_path_factory):
    """The state directory of a station that runs as a process."""
    state = tmp_path_factory.mktemp('state')
    settings = ('source:=tcp', 'ip_port:=0', 'peer:=slave', f'state_directory:={state}')
    command = [sys.executable, '-m', 'drfmcw_node.station', '--station', 'master', '--ros-args']
    command += [part for setting in settings for part in ('-p', setting)]
    process = subprocess.Popen(command)
    yield state
    process.terminate()
    assert process.wait(30.0) == 0


@pytest.fixture
def file(tmp_path):
    def write(document):
        path = tmp_path / 'document.yaml'
        path.write_text(document.text())
        return str(path)

    return write


def test_document_is_stored_on_the_station(station, file, capsys):
    assert main(['push', 'master', file(DOCUMENT), '--operator', 'A. Operator', *PATIENT]) == 0
    assert capsys.readouterr().out == 'master: accepted, stored there as version 1\n'
    stored = CalibrationStore(station).read('master')
    assert (stored.version, stored.operator, stored.reference_clock.value) == (1, 'A. Operator', 1.000037)


def test_refused_document_is_one_line_and_status_2(station, file, capsys):
    before = CalibrationStore(station).versions('master')
    for document, reason in (
        (dataclasses.replace(DOCUMENT, station='slave'), "document: is of station 'slave', this is 'master'"),
        (dataclasses.replace(DOCUMENT, delay=Delay(12.3)), 'delay = 12.3 s is outside'),
    ):
        assert main(['push', 'master', file(document), *PATIENT]) == 2
        said = capsys.readouterr().err
        assert said.startswith("drfmcw calibrate: 'master' refuses the ")
        assert reason in said and said.count('\n') == 1
    assert CalibrationStore(station).versions('master') == before


@pytest.mark.usefixtures('station')
@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (['nobody', '', '--timeout', '0.5'], 'nobody offers /nobody/store_calibration within 0.5 s'),
        (['a b', '', '--timeout', '0.5'], "'a b' is no name of a station"),
        (['master', '', '--timeout', '0'], '--timeout = 0 s'),
        (['master', '/no/such/file'], '/no/such/file: No such file'),
    ],
)
def test_nobody_there_or_wrong_input_is_one_line_and_status_2(file, capsys, arguments, reason):
    path = file(DOCUMENT)
    assert main(['push', *(argument or path for argument in arguments)]) == 2
    said = capsys.readouterr().err
    assert reason in said and said.count('\n') == 1
