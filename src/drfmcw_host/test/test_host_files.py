"""Recordings, findings and parameter files: names lead nowhere else, archives hold what is there."""

import io
import json
import math
import tarfile

import pytest
import yaml

from drfmcw_host.configure.parameter_file import content, save
from drfmcw_host.configure.values import Described, shown, split_unit, typed
from drfmcw_host.files.findings import Effect, Findings
from drfmcw_host.files.recordings import Recordings
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import write_atomically

ESCAPES = ['..', '.', '', '../other', '/etc', 'a/b', 'a\\b', 'a\0b', '.hidden', 'x' * 101, 'ä', 'a\n', '~']


@pytest.fixture
def recordings(tmp_path):
    for name, data in (('one', b'x' * 1000), ('two', b'y' * 512)):
        (tmp_path / 'kept' / name).mkdir(parents=True)
        (tmp_path / 'kept' / name / 'a.mcap').write_bytes(data)
    (tmp_path / 'kept' / 'one' / 'metadata.yaml').write_text('x: 1\n')
    (tmp_path / 'kept' / 'no_recording').mkdir()
    (tmp_path / 'outside').mkdir()
    (tmp_path / 'outside' / 'a.mcap').write_bytes(b'secret')
    (tmp_path / 'kept' / 'linked').symlink_to(tmp_path / 'outside')
    return Recordings(tmp_path / 'kept')


def test_list_holds_recordings_only(recordings):
    found = {r.name: r for r in recordings.list()}
    assert set(found) == {'one', 'two'}
    assert found['one'].complete and not found['two'].complete and found['two'].size == 512


@pytest.mark.parametrize('name', [*ESCAPES, 'linked', 'no_recording', 'nothing'])
def test_names_reach_nothing_outside(recordings, name, tmp_path):
    for work in (recordings.path, recordings.archive, recordings.delete):
        with pytest.raises(ConfigurationError):
            work(name)
    assert (tmp_path / 'outside' / 'a.mcap').read_bytes() == b'secret'


@pytest.mark.parametrize('name', [*ESCAPES, 'one', 'linked'])
def test_new_names_are_free_and_inside(recordings, name):
    with pytest.raises(ConfigurationError):
        recordings.new_path(name)


@pytest.mark.parametrize('name', ['one', 'two'])
def test_archive_unpacks_to_the_same_bytes(recordings, name):
    data = b''.join(recordings.archive(name))
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        unpacked = {m.name: archive.extractfile(m).read() for m in archive.getmembers()}
    folder = recordings.directory / name
    assert unpacked == {f'{name}/{path.name}': path.read_bytes() for path in folder.iterdir()}


def test_delete_takes_the_results_along(recordings):
    recordings.results('one').mkdir(parents=True)
    (recordings.results('one') / 'report.html').write_text('x')
    assert recordings.list()
    recordings.delete('one')
    assert [r.name for r in recordings.list()] == ['two'] and not recordings.results('one').exists()


def finding(verdict='explained', **more):
    effect = {
        'effect': 'sweep_ripple',
        'station': 'master',
        'parameters': {'deviation': {'value': 1200.0, 'std': 40.0, 'unit': 'Hz'}},
    }
    return {'verdict': verdict, 'significance': 1e-9, 'effects': [effect], 'next_measurement': None} | more


def test_findings_are_read_and_damaged_ones_left_out(tmp_path):
    contents = {'20260101T000000': finding(), '20260102T000000': finding('ambiguous', next_measurement='drive')}
    for name, data in contents.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / 'finding.json').write_text(json.dumps(data))
    for name, text in (('20260103T000000', '{'), ('20260104T000000', '[]'), ('20260105T000000', '{"effects": 1}')):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'finding.json').write_text(text)
    kept = Findings(tmp_path)
    found = kept.list()
    assert [f.verdict for f in found] == ['ambiguous', 'explained']
    assert found[0].next_measurement == 'drive' and found[1].effects == (
        Effect('sweep_ripple', 'master', (('deviation', 1200.0, 40.0, 'Hz'),)),
    )
    assert Findings(tmp_path / 'nothing').list() == []
    (tmp_path / '20260106T000000-a-b').mkdir()
    assert kept.list() == found  # it is being written
    written = json.dumps(finding('partial', window={'pair': 'a/b'}))
    write_atomically(tmp_path / '20260106T000000-a-b' / 'finding.json', written)
    newest, *others = kept.list()
    assert (newest.verdict, newest.pair, newest.report) == ('partial', 'a/b', False) and others == found
    write_atomically(tmp_path / '20260106T000000-a-b' / 'report.html', 'x')
    assert kept.list()[0].report and kept.report('20260106T000000-a-b').read_text() == 'x'


@pytest.mark.parametrize('name', ESCAPES)
def test_reports_lead_nowhere_else(tmp_path, name):
    with pytest.raises(ConfigurationError):
        Findings(tmp_path).report(name)


@pytest.mark.parametrize(
    ('value', 'kind'),
    [
        (True, bool),
        (-3, int),
        (1e-5, float),
        (math.inf, float),
        ('tcp', str),
        ([1.5, -2.0], list[float]),
        (['a/b', 'c/d'], list[str]),
    ],
)
@pytest.mark.parametrize('language', ['en', 'de'])
def test_what_is_shown_can_be_typed_again(value, kind, language):
    again = typed(shown(value, language), kind, language)
    assert again == value and type(again) is type(value)


def test_german_takes_comma_and_point():
    assert shown([0.5, 2.0], 'de') == '0,5; 2,0'
    assert typed('4321,5', float, 'de') == typed('4321.5', float, 'de') == 4321.5
    with pytest.raises(ConfigurationError):
        typed('4321,5', float, 'en')


@pytest.mark.parametrize(('text', 'kind'), [('maybe', bool), ('1.5', int), ('fast', float), ('1,x', list[float])])
def test_what_means_nothing_is_refused(text, kind):
    with pytest.raises(ConfigurationError):
        typed(text, kind)


def test_unit_is_taken_from_the_declaration():
    assert split_unit('speed of air [m/s]; NaN: unknown') == ('speed of air; NaN: unknown', 'm/s')
    assert split_unit('how the line is found (a | b)') == ('how the line is found (a | b)', '')


def described(name, value, read_only=False, description=''):
    return Described('/master/station', name, type(value), value, description, '', -math.inf, math.inf, read_only)


def test_choices_are_those_of_the_declaration():
    assert described('x', 'b', description='how (a | b | c)').choices == ['a', 'b', 'c']
    assert described('x', 1.0, description='how (a | b | c)').choices == []


def test_parameter_file_is_in_the_format_of_ros(tmp_path):
    parameters = [described('estimator', 'ml'), described('threshold', 1e-5), described('fixed', 1, read_only=True)]
    parsed = yaml.safe_load(content(parameters))
    assert parsed == {'/master/station': {'ros__parameters': {'estimator': 'ml', 'threshold': 1e-5}}}
    path = save(tmp_path / 'new', 'site', parameters)
    assert path.name == 'site.yaml' and yaml.safe_load(path.read_text()) == parsed
    for name in ('../x', '', 'a/b', '.x'):
        with pytest.raises(ConfigurationError):
            save(tmp_path, name, parameters)
