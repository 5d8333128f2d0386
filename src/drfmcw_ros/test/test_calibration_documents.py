"""Calibrations as documents: round trip, checksum, migration, plausibility, history."""

import dataclasses
import math

import numpy as np
import pytest
import yaml

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.calibration.document import (
    Clock,
    Delay,
    Document,
    IfResponse,
    Noise,
    Temperatures,
    from_calibration,
    matrix,
    parse_document,
    read_document,
    triangle,
)
from drfmcw_ros.calibration.store import CalibrationStore, state_directory

COVARIANCE = triangle(np.diag([4e-16, 1e-18, 1e-21, 1e-24]))
MEASURED = Document(
    'master',
    operator='A. Operator',
    instrument='counter 7',
    note='after the repair: ±5 K',
    temperature=Temperatures(25.0, -10.0, 45.0),
    reference_clock=Clock(1.000037, 2e-8, -2.5e-7, 2e-9, 1.05e-10, COVARIANCE),
    sample_clock=Clock(1.000018, 2e-8),
    delay=Delay(12.3e-9, 1.7e-11, 4e-12, 1e-12, 'slave'),
    noise=Noise(-140.7, 0.05, -90.0, 0.3, 200e3, 8e3),
    if_response=IfResponse([1e5, 2e5], [0.1, -0.1], [0.02, 0.02]),
)


def test_a_document_comes_back_as_it_was():
    assert parse_document(MEASURED.text(), 'here') == MEASURED


def test_what_is_not_measured_stays_out_of_the_text():
    text = Document('master').text()
    assert 'noise' not in text and 'if_response' not in text and '.nan' not in text
    assert math.isnan(parse_document(text, 'here').noise.floor)


def test_calibration_of_a_document_and_back():
    calibration = MEASURED.calibration()
    assert calibration.alpha_at(45.0) == pytest.approx(1.000037 - 2.5e-7 * 20 + 2e-9 * 400 + 1.05e-10 * 8000, abs=1e-15)
    assert from_calibration(calibration).calibration() == calibration


def test_changed_content_does_not_match_its_checksum():
    changed = MEASURED.text().replace('1.23e-08', '1.24e-08')
    assert changed != MEASURED.text()
    with pytest.raises(ConfigurationError, match='here: the checksum does not match the content'):
        parse_document(changed, 'here')
    unsigned = '\n'.join(line for line in changed.splitlines() if not line.startswith('checksum'))
    assert parse_document(unsigned, 'here').delay.value == 1.24e-8


def test_schema_1_is_migrated():
    """Schema 1 named values as StationCalibration did before it had standard deviations."""
    old = {'schema': 1, 'station': 'slave', 'version': 4, 'date': '2025-03-01T10:00:00+00:00', 'alpha': 0.999978}
    old |= {'sample_clock_alpha': 0.999991, 'temperature': 22.0, 'delay': 15.8e-9, 'noise_floor': -137.7}
    old |= {'phase_noise_level': -90.0, 'phase_noise_corner': 2e5, 'note': 'bench'}
    document = parse_document(yaml.safe_dump(old), 'old')
    assert document.calibration() == Calibration(
        'slave', 0.999978, 0.999991, 22.0, 15.8e-9, -137.7, -90.0, 2e5, version=4
    )
    assert (document.note, document.date) == ('bench', old['date'])
    assert parse_document(document.text(), 'new') == document
    with pytest.raises(ConfigurationError, match="old: unknown key 'alpha_std' of schema 1"):
        parse_document(yaml.safe_dump(old | {'alpha_std': 1e-8}), 'old')


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'reference_clock': Clock(37.0)}, r'alpha = 37 is outside .*looks like ppm of deviation'),
        ({'delay': Delay(12.3)}, r'delay = 12.3 s is outside .*looks like'),
        ({'delay': Delay(0.0, -1e-12)}, 'delay_std = -1e-12 s is outside'),
        ({'noise': Noise(-20.0)}, 'noise_floor = -20 dBm/Hz is outside'),
        ({'temperature': Temperatures(25.0, 45.0, -10.0)}, 'low = 45 degC is above high = -10 degC'),
        ({'temperature': Temperatures(60.0, -10.0, 45.0)}, 'reference = 60 degC is outside'),
        ({'temperature': Temperatures(25.0)}, 'a curve over the temperature needs the range'),
        ({'reference_clock': Clock(1.00045, linear=4e-6)}, r'alpha at 40 degC = 1\.00051 is outside'),
        ({'reference_clock': Clock(covariance=[1.0])}, 'covariance has 1 numbers, not 10'),
        ({'reference_clock': Clock(covariance=triangle(-np.eye(4)))}, 'a negative variance'),
    ],
)
def test_implausible_documents_are_refused(tmp_path, changes, reason):
    document = dataclasses.replace(MEASURED, **changes)
    with pytest.raises(ConfigurationError, match=reason):
        parse_document(document.text(), 'here')
    with pytest.raises(ConfigurationError, match=reason):
        CalibrationStore(tmp_path).add(document)
    assert not list(tmp_path.rglob('*.yaml'))


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('schema: 3\nstation: master\n', "'schema' must be 1 to 2, not 3"),
        ('station: master\n', "'schema' must be 1 to 2, not None"),
        ('schema: 2\nstation: master\ndelai: {}\n', "unknown key 'delai'.*delay"),
        ('schema: 2\nstation: master\ndelay: {valu: 1}\n', "here: delay: unknown key 'valu'"),
        ('schema: 2\n', "key 'station' is missing"),
        ('schema: 2\nschema: 2\n', "key 'schema' is given twice"),
        ('[1, 2]', 'expected a mapping'),
        ('a: [', 'here line'),
    ],
)
def test_other_texts_are_refused_in_one_line(text, reason):
    with pytest.raises(ConfigurationError, match=reason) as error:
        parse_document(text, 'here')
    assert '\n' not in str(error.value)


def test_versions_count_up_and_none_is_changed(tmp_path):
    store = CalibrationStore(tmp_path)
    assert store.newest('master') is None and store.stations() == []
    first = store.add(MEASURED)
    before = store.path('master', 1).read_bytes()
    second = store.add(dataclasses.replace(MEASURED, note='again'), operator='B. Operator')
    assert (first.version, second.version, store.versions('master')) == (1, 2, [1, 2])
    assert store.path('master', 1).read_bytes() == before
    assert store.read('master') == store.newest('master') == second
    assert (second.operator, store.read('master', 1).operator) == ('B. Operator', 'A. Operator')
    assert second.calibration().version == 2
    assert store.stations() == ['master']
    assert not [path for path in tmp_path.rglob('*') if path.name.startswith('.')], 'no temporary file stays'
    with pytest.raises(ConfigurationError, match=r"'master' has no calibration of version 7; stored: 1 \.\.\. 2"):
        store.read('master', 7)
    with pytest.raises(ConfigurationError, match="no calibration of 'slave' is stored"):
        store.read('slave')


def test_a_damaged_file_is_named_and_not_passed_over(tmp_path):
    store = CalibrationStore(tmp_path)
    store.add(MEASURED)
    path = store.path('master', 2)
    path.write_text(store.path('master', 1).read_text()[:300])
    with pytest.raises(ConfigurationError, match=str(path)):
        store.newest('master')
    path.write_text(store.path('master', 1).read_text())
    with pytest.raises(ConfigurationError, match=r"000002\.yaml: is version 1 of 'master'"):
        store.newest('master')


def test_a_directory_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / 'calibration').write_text('a file')
    with pytest.raises(ConfigurationError, match='calibration'):
        CalibrationStore(tmp_path).add(MEASURED)


def test_state_directory_is_that_of_the_service_manager_or_of_the_user(tmp_path):
    environ = {'STATE_DIRECTORY': '/var/lib/drfmcw:/var/lib/other', 'XDG_STATE_HOME': '/x', 'HOME': '/y'}
    assert str(state_directory(environ, 'here')) == 'here'
    assert str(state_directory(environ)) == '/var/lib/drfmcw'
    del environ['STATE_DIRECTORY']
    assert str(state_directory(environ)) == '/x/drfmcw'
    del environ['XDG_STATE_HOME']
    assert str(state_directory(environ)) == '/y/.local/state/drfmcw'


def test_read_document_names_the_file(tmp_path):
    with pytest.raises(ConfigurationError, match=r'none\.yaml: No such file'):
        read_document(tmp_path / 'none.yaml')


def test_triangle_and_matrix_are_inverse():
    full = np.arange(16.0).reshape(4, 4)
    full = full + full.T
    assert (matrix(triangle(full)) == full).all() and (matrix([]) == 0.0).all()
