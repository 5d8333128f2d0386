"""Calibrations on the page: what is kept, what is compared, and what a change does to ranges."""

import dataclasses
import json

import pytest
import yaml

from drfmcw_host.configure.calibration import typed_document
from drfmcw_host.configure.comparison import effects, side_by_side
from drfmcw_host.files.calibrations import Calibrations
from drfmcw_host.state.store import Store
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode, Role, SweepSettings
from drfmcw_ros.calibration.document import Clock, Delay, Document, Temperatures
from drfmcw_ros.calibration.store import CalibrationStore

DOCUMENT = Document(
    'master',
    note='after the repair',
    temperature=Temperatures(25.0, -10.0, 45.0),
    reference_clock=Clock(1.000037, 2e-8, -2e-7, covariance=[1e-16] + [0.0] * 9),
    delay=Delay(12.3e-9, 1.7e-11, peer='slave'),
)


@pytest.fixture
def kept(tmp_path):
    return Calibrations(tmp_path / 'seen', CalibrationStore(tmp_path / 'station'))


@pytest.fixture
def store():
    """A pair in the short-distance mode, T_off 3.41 us."""
    store = Store()
    store.pair('master/slave')
    for own, peer, role in (('master', 'slave', Role.FIRST), ('slave', 'master', Role.SECOND)):
        settings = SweepSettings(own, peer, role=role, mode=Mode.SHORT_DISTANCE, start_delay=3.41e-6)
        store.station(own).settings[peer] = settings
    return store


def test_every_calibration_that_was_in_use_stays_known(kept):
    first, second = Calibration('master', delay=1e-9), dataclasses.replace(DOCUMENT, version=1)
    for used in (first, second.calibration(), first):
        kept.see(used)
    assert [(d.version, d.delay.value) for d in kept.of('master')] == [(1, 12.3e-9), (0, 1e-9)]
    again = dataclasses.replace(DOCUMENT, version=1, delay=Delay(5e-9))
    kept.see(again.calibration())  # the station lost its store and counts from 1 again
    assert len(kept.of('master')) == 3


def test_a_stored_document_says_more_than_the_published_one(kept):
    stored = dataclasses.replace(DOCUMENT, version=4, date='2026-11-22T09:48:42+00:00', operator='anna')
    kept.see(stored.calibration())
    assert kept.known(stored.calibration()).operator == ''
    kept.keep(stored)
    assert kept.known(stored.calibration()) == stored == kept.of('master')[0]


def test_what_stations_of_this_machine_keep_is_known(kept, tmp_path):
    CalibrationStore(tmp_path / 'station').add(DOCUMENT, 'bert')
    (found,) = kept.of('master')
    assert (found.version, found.operator, found.note) == (1, 'bert', 'after the repair')
    kept.see(found.calibration())
    assert kept.of('master') == [found]


def test_damaged_files_and_hostile_names_are_left_out(kept, tmp_path):
    kept.see(DOCUMENT.calibration())
    (path,) = (tmp_path / 'seen' / 'master').glob('*.yaml')
    path.write_text(path.read_text().replace('1.23e-08', '1.33e-08'))
    assert kept.of('master') == []
    for name in ('../outside', '', 'a/b', '.'):
        assert kept.of(name) == []
        with pytest.raises(ConfigurationError, match='no name of a station'):
            kept.see(Calibration(name))
    assert {p.name for p in tmp_path.iterdir()} == {'seen'}


def test_the_network_cannot_fill_the_disk(kept, tmp_path):
    for i in range(300):
        kept.see(Calibration('master', delay=i * 1e-12))
    assert len(list((tmp_path / 'seen' / 'master').iterdir())) == 200


def test_documents_are_taken_as_yaml_and_as_json():
    content = yaml.safe_load(DOCUMENT.text())
    assert typed_document(DOCUMENT.text(), 'document') == DOCUMENT
    assert typed_document(json.dumps(content), 'document') == DOCUMENT
    with pytest.raises(ConfigurationError, match='document: the checksum does not match'):
        typed_document(json.dumps(content | {'note': 'changed'}), 'document')
    for text in ('', '[1]', 'a: [', '{"station": "master"}'):
        with pytest.raises(ConfigurationError, match=r'^document'):
            typed_document(text, 'document')


def test_values_stand_side_by_side_with_units():
    found = {f'{v.section}.{v.key}': v for v in side_by_side(Document('master'), DOCUMENT)}
    clock, delay = found['reference_clock.value'], found['delay.value']
    assert (clock.unit, clock.before, clock.changed) == ('ppm', 0.0, True)
    assert clock.after == pytest.approx(37.0, rel=1e-9) and delay.after == pytest.approx(12.3, rel=1e-12)
    assert (delay.unit, found['reference_clock.linear'].unit) == ('ns', 'ppm/K')
    assert found['delay.peer'].before is None and found['delay.peer'].after == 'slave'
    assert not found['sample_clock.value'].changed and not found['temperature.reference'].changed
    assert 'noise.floor' not in found and 'delay.slope' not in found  # neither states it


@pytest.mark.parametrize(
    ('change', 'expected'),
    [
        ({'delay': 2e-9}, (-2e-9 * SPEED_OF_LIGHT, -2e-9 * SPEED_OF_LIGHT)),
        ({'alpha': 1.000001}, (-1e-4, -1e-3)),  # eq. 19: the delay shrinks by alpha
        ({'sample_clock_alpha': 1.000001}, (0.561e-3, 1.011e-3)),  # (distance + c T_off) / 2 per unit
    ],
)
def test_effect_on_a_range_is_that_of_the_formulas(store, change, expected):
    before = Calibration('master')
    found = effects(store, before, dataclasses.replace(before, **change))
    assert [e.distance for e in found] == [100.0, 1000.0]
    for effect, shift in zip(found, expected, strict=True):
        assert effect.shift == pytest.approx(shift, rel=1e-3)  # the index of the air is 1.0003


def test_uncertainty_is_what_the_calibrations_state(store):
    before = Calibration('master')
    found = effects(store, before, dataclasses.replace(before, alpha_std=1e-6))
    assert [(e.std_before, e.std_after) for e in found] == [
        (0.0, pytest.approx(1e-4, rel=1e-3)),
        (0.0, pytest.approx(1e-3, rel=1e-3)),
    ]


def test_without_settings_nothing_is_claimed(store):
    store.stations['slave'].settings.clear()
    assert effects(store, Calibration('master'), Calibration('master', delay=1e-9)) == []
    assert effects(store, Calibration('other'), Calibration('other')) == []
