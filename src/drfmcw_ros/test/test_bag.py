"""Recordings: what is written comes back to the byte, nothing half-done stays behind, damage is said in one line."""

import math
import os
import re
import resource
import shutil

import pytest
from checkout import DATA
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drfmcw_ros.bag.files import STORAGES, BagError, BagReader, BagWriter, typestore
from drfmcw_ros.bag.info import main

PRACTICE = DATA / 'recording_0'
TEMPERATURE = 'sensor_msgs/msg/Temperature'
SUFFIX = {'mcap': '.mcap', 'sqlite3': '.db3'}
both_storages = pytest.mark.parametrize('storage', sorted(STORAGES))


def contents(path):
    """Everything in a recording: (topic, time, type, bytes) in order."""
    with BagReader(path) as bag:
        return list(bag.raw_messages())


def write(path, rows, storage='mcap', **options):
    """Write rows of (topic, time, type, bytes)."""
    with BagWriter(path, storage, **options) as bag:
        for topic, time, kind, raw in rows:
            bag.write(topic, kind, time, raw)
    return path


def problem(path):
    """Read a recording to its end; return the one line that says why that fails."""
    with pytest.raises(BagError) as caught, BagReader(path) as bag:
        list(bag.messages())
    line = str(caught.value)
    assert '\n' not in line
    assert str(path) in line
    return line


@pytest.fixture(scope='module')
def rows():
    """Messages of a recording made by another hand: settings, calibrations, status, weather, some sweeps."""
    return contents(PRACTICE)[:60]


@pytest.fixture(params=sorted(STORAGES))
def stored(request, tmp_path, rows):
    """A recording in each storage format, and its storage file."""
    path = write(tmp_path / 'run', rows, request.param)
    return path, path / f'run_0{SUFFIX[request.param]}'


@both_storages
def test_everything_comes_back(tmp_path, storage):
    """A whole recording copied into either format is the same to the byte, with topics, types and QoS."""
    original = contents(PRACTICE)
    copy = write(tmp_path / 'copy', original, storage)
    assert contents(copy) == original
    with BagReader(PRACTICE) as one, BagReader(copy) as other:
        assert other.topics == one.topics
        assert (other.start_time, other.end_time, other.message_count) == (
            one.start_time, one.end_time, one.message_count,
        )  # fmt: skip
        assert {c.topic: c.msgcount for c in other.connections} == {c.topic: c.msgcount for c in one.connections}
        # calibrations have got further fields since that recording was made
        same = [c for c in one.connections if not c.topic.endswith('/calibration')]
        digests = {c.topic: c.digest for c in other.connections}
        assert all(digests[c.topic] == c.digest for c in same)
        for connection in other.connections:
            (offered,) = connection.ext.offered_qos_profiles
            latched = connection.topic.endswith(('sweep_config', 'calibration'))
            assert offered.reliability == QosReliability.RELIABLE
            assert (offered.durability == QosDurability.TRANSIENT_LOCAL) == latched
            assert not latched or offered.depth == 1


TEXT = st.text(st.characters(codec='utf-8', exclude_characters='\0'))


@both_storages
@given(values=st.lists(st.tuples(st.floats(), TEXT), min_size=1))
@settings(max_examples=20, deadline=None)
def test_any_message_comes_back(tmp_path_factory, storage, values):
    """Objects of rosbags are serialised and come back with every field, NaN and infinity included."""
    types = typestore().types
    path = tmp_path_factory.mktemp('any') / 'run'
    time_of = types['builtin_interfaces/msg/Time']
    with BagWriter(path, storage) as bag:
        for i, (value, text) in enumerate(values):
            header = types['std_msgs/msg/Header'](time_of(sec=i, nanosec=i), text)
            bag.write('/site/temperature', TEMPERATURE, 10 + i, types[TEMPERATURE](header, value, 0.0))
    with BagReader(path) as bag:
        read = list(bag.messages())
    assert [(m.header.stamp.sec, m.header.frame_id, repr(m.temperature)) for _, _, m in read] == [
        (i, text, repr(value)) for i, (value, text) in enumerate(values)
    ]
    assert [time for _, time, _ in read] == list(range(10, 10 + len(values)))


@both_storages
def test_messages_come_in_order_of_time(tmp_path, rows, storage):
    """However they were written."""
    path = write(tmp_path / 'run', rows[::-1], storage)
    times = [time for _, time, _, _ in contents(path)]
    assert times == sorted(times)
    assert sorted(contents(path)) == sorted(rows)


def test_only_the_topics_asked_for_come(rows):
    with BagReader(PRACTICE) as bag:
        assert {t for t, _, _ in bag.messages({'/master/status', '/nowhere'})} == {'/master/status'}
        assert list(bag.messages(())) == []


@both_storages
def test_topic_without_message_is_kept(tmp_path, storage):
    with BagWriter(tmp_path / 'run', storage) as bag:
        bag.add_topic('/master/if_samples', 'drfmcw_msgs/msg/IfSamples')
        bag.add_topic('/master/if_samples', 'drfmcw_msgs/msg/IfSamples')
    with BagReader(tmp_path / 'run') as bag:
        assert bag.topics == {'/master/if_samples': 'drfmcw_msgs/msg/IfSamples'}
        assert list(bag.messages()) == []


@both_storages
def test_single_storage_file_is_a_recording_too(tmp_path, rows, storage):
    """The storage file alone, and a directory that lost its metadata.yaml, read like the whole."""
    path = write(tmp_path / 'run', rows, storage)
    assert contents(path / f'run_0{SUFFIX[storage]}') == rows
    (path / 'metadata.yaml').unlink()
    assert contents(path) == rows


# --- nothing half-done stays behind ---


@both_storages
def test_name_stands_only_for_a_complete_recording(tmp_path, rows, storage):
    path = tmp_path / 'deep' / 'run'
    with BagWriter(path, storage) as bag:
        bag.write('/site/temperature', TEMPERATURE, 1, next(r for t, _, k, r in rows if k == TEMPERATURE))
        assert not path.exists()
    assert [p.name for p in path.parent.iterdir()] == ['run']
    assert sorted(p.name for p in path.iterdir()) == ['metadata.yaml', f'run_0{SUFFIX[storage]}']


@both_storages
def test_aborted_recording_leaves_nothing(tmp_path, rows, storage):
    with pytest.raises(ZeroDivisionError), BagWriter(tmp_path / 'run', storage) as bag:
        bag.write(rows[0][0], rows[0][2], rows[0][1], rows[0][3])
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_existing_recording_is_not_overwritten_unasked(tmp_path, rows):
    path = write(tmp_path / 'run', rows[:5])
    with pytest.raises(BagError, match=f'^{path}: exists already'):
        BagWriter(path)
    assert contents(path) == rows[:5]
    write(path, rows[5:9], overwrite=True)
    assert contents(path) == rows[5:9]
    with pytest.raises(ZeroDivisionError), BagWriter(path, overwrite=True):
        raise ZeroDivisionError
    assert contents(path) == rows[5:9], 'the old one stands until the new one is complete'
    assert [p.name for p in tmp_path.iterdir()] == ['run']


def test_overwriting_spares_what_is_no_recording(tmp_path):
    (tmp_path / 'photos').mkdir()
    (tmp_path / 'photos' / 'one.jpg').touch()
    with pytest.raises(BagError, match='is no recording'):
        BagWriter(tmp_path / 'photos', overwrite=True)
    assert (tmp_path / 'photos' / 'one.jpg').exists()


def test_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.raises(BagError, match=f'^{tmp_path}/file/run: Not a directory$'):
        BagWriter(tmp_path / 'file' / 'run')
    with pytest.raises(BagError, match=r"^storage 'mcp' is not valid; did you mean 'mcap'\?$"):
        BagWriter(tmp_path / 'run', 'mcp')


@both_storages
def test_full_disk_is_said_in_one_line(tmp_path, rows, storage):
    """A limit on the file size stands for the full disk; nothing half-written stays."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, hard))
    try:
        with pytest.raises(BagError) as caught:
            write(tmp_path / 'run', rows * 20, storage)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert str(caught.value).startswith(f'{tmp_path}/run: ')
    assert '\n' not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


# --- what cannot be read ---


def test_missing_path_and_directory_without_recording(tmp_path):
    assert problem(tmp_path / 'none') == f'{tmp_path}/none: no such recording'
    assert 'no rosbag2 recording (no metadata.yaml, 0 storage files)' in problem(tmp_path)
    for name in ('a.mcap', 'b.mcap'):
        (tmp_path / name).touch()
    assert '2 storage files' in problem(tmp_path)


def test_text_file_is_no_recording(tmp_path):
    for name in ('notes.txt', 'run.mcap', 'run.db3'):
        (tmp_path / name).write_text('not a recording\n' * 500)
        problem(tmp_path / name)


@pytest.mark.parametrize('broken', ['', 'rosbag2_bagfile_information: {', 'nothing: known\n', '\xff\xfe', '- 1\n- 2\n'])
def test_broken_metadata(stored, broken):
    path, _ = stored
    (path / 'metadata.yaml').write_bytes(broken.encode('latin-1'))
    problem(path)


def test_storage_file_that_metadata_names_is_gone(stored):
    path, file = stored
    file.unlink()
    problem(path)


@pytest.mark.parametrize('kept', [0.0, 1e-5, 1e-3, 0.1, 0.5, 0.9])
def test_truncated_database_is_refused(tmp_path, rows, kept):
    """With metadata.yaml and without it: SQLite's pages do not fit together any more."""
    path = write(tmp_path / 'run', rows, 'sqlite3')
    file = path / 'run_0.db3'
    os.truncate(file, int(kept * file.stat().st_size))
    problem(path)
    (path / 'metadata.yaml').unlink()
    problem(path)


def test_damage_within_is_said_or_harmless(stored):
    """Overwritten with zeros anywhere, a recording is read or refused in one line, never with a traceback."""
    path, file = stored
    whole = file.read_bytes()
    refused = 0
    for start in range(0, len(whole), len(whole) // 40):
        file.write_bytes(whole[:start] + bytes(min(600, len(whole) - start)) + whole[start + 600 :])
        try:
            with BagReader(path) as bag:
                list(bag.messages())
        except BagError as error:
            assert re.fullmatch(rf'{path}(/run_0.\w+|/metadata.yaml)?: .+', str(error))
            refused += 1
    assert refused > 0


@both_storages
def test_changed_message_definition_is_refused(tmp_path, storage):
    """A field of another type would be read as rubbish; the topic and the type are named."""
    kind = 'drfmcw_msgs/msg/IfSamples'
    with BagReader(PRACTICE) as bag:
        definition = next(c.msgdef.data for c in bag.connections if c.msgtype == kind)
    theirs = get_typestore(Stores.ROS2_JAZZY)
    assert 'int16[] samples' in definition
    theirs.register(get_types_from_msg(definition.replace('int16[] samples', 'int32[] samples'), kind))
    with Writer(tmp_path / 'run', version=9, storage_plugin=StoragePlugin[storage.upper()]) as bag:
        bag.write(bag.add_connection('/master/if_samples', kind, typestore=theirs), 1, b'\0\1\0\0' + bytes(100))
    line = problem(tmp_path / 'run')
    assert "'/master/if_samples'" in line
    assert f'its definition of {kind} differs' in line


@both_storages
def test_older_definition_is_converted_and_its_missing_fields_are_named(tmp_path, storage, capsys):
    """Calibrations of the first release come back in today's definition, fields that they lack as zero or NaN."""
    kind, topic = 'drfmcw_msgs/msg/StationCalibration', '/master/calibration'
    with BagReader(PRACTICE) as bag:
        definition = next(c.msgdef.data for c in bag.connections if c.topic == topic)
        assert 'alpha_std' not in definition  # by another hand, before there was this field
        [recorded] = [message for _, _, message in bag.messages({topic})]
    theirs = get_typestore(Stores.ROS2_JAZZY)
    theirs.register(get_types_from_msg(definition, kind))
    old = theirs.types[kind](**{name: getattr(recorded, name) for name, _ in theirs.fielddefs[kind][1]})
    with Writer(tmp_path / 'run', version=9, storage_plugin=StoragePlugin[storage.upper()]) as bag:
        bag.write(bag.add_connection(topic, kind, typestore=theirs), 1, theirs.serialize_cdr(old, kind))
    with BagReader(tmp_path / 'run') as bag:
        [(_, _, message)] = bag.messages()
        [(_, _, _, raw)] = bag.raw_messages(whole=True)
        for read in (message, typestore().deserialize_cdr(raw, kind)):
            assert (read.alpha, read.delay, read.station) == (recorded.alpha, recorded.delay, 'master')
            assert math.isnan(read.alpha_std) and read.delay_peer == ''
        assert 'alpha_std' in bag.older[kind] and 'alpha' not in bag.older[kind] and not bag.unreadable
    assert main([str(tmp_path / 'run')]) == 0
    assert f'note: an older {kind} without alpha_std' in ' '.join(capsys.readouterr().out.split())


def test_unknown_message_type_matters_only_where_asked_for(tmp_path):
    kind = 'other_msgs/msg/Note'
    theirs = get_typestore(Stores.EMPTY)
    theirs.register(get_types_from_msg('int32 number', kind))
    with Writer(tmp_path / 'run', version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        bag.write(bag.add_connection('/note', kind, typestore=theirs), 1, b'\0\1\0\0\7\0\0\0')
    with BagReader(tmp_path / 'run') as bag:
        assert list(bag.messages()) == []
        with pytest.raises(BagError, match=rf"topic '/note': message type {kind} is unknown"):
            list(bag.messages({'/note'}))


@both_storages
@pytest.mark.parametrize('kept', [0, 3, 8, 20, 60])
def test_corrupt_message_is_refused(tmp_path, rows, storage, kept):
    """A message cut short, with the topic that it stood on."""
    topic, time, kind, raw = next(r for r in rows if r[0] == '/master/if_samples')
    path = write(tmp_path / 'run', [*rows[:4], (topic, time, kind, raw[:kept])], storage)
    assert "topic '/master/if_samples': message cannot be decoded" in problem(path)


def test_missing_topic_is_named_with_the_nearest():
    with BagReader(PRACTICE) as bag, pytest.raises(BagError) as caught:
        bag.require('/mastr/if_samples')
    assert str(caught.value) == f"{PRACTICE}: topic '/mastr/if_samples' is missing; did you mean '/master/if_samples'?"


def test_practice_recording_is_untouched_by_reading(tmp_path):
    """Reading needs no write access and leaves no file."""
    copy = shutil.copytree(PRACTICE, tmp_path / 'run')
    before = {p.name: (p.stat().st_size, p.stat().st_mtime_ns) for p in copy.iterdir()}
    contents(copy)
    assert {p.name: (p.stat().st_size, p.stat().st_mtime_ns) for p in copy.iterdir()} == before
