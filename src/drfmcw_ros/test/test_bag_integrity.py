"""Recordings that were cut off, damaged or written by rosbag2 itself: what is whole is read, what is not is named."""

import contextlib
import json
import math
import random
import re
import shutil

import pytest
from checkout import DATA, SHARED

from drfmcw_ros.bag import info, repair
from drfmcw_ros.bag.files import SKIP_DAMAGED, STORAGES, BagError, BagReader, BagWriter
from drfmcw_ros.bag.storage.mcap_records import CHUNK, RECORD, records

OWN, MORE = DATA / 'ros2_bags', SHARED / 'ros2_bags'
KINDS = ('chunk', 'mfile', 'mid_real', 'mmsg', 'plain', 'ros2_killed', 'split', 'splitfile', 'sql', 'sqlmsg')
"""What `ros2 bag record` of Jazzy wrote, by storage and compression; the checkout holds two of them whole."""
SHORT = ('chunk_short', 'plain_short', 'ros2_killed_short', 'sql_short', 'sqlmsg_short')
"""Parts of these, all in the checkout, with counts and times of metadata.yaml made to fit.

plain_short is the last file of `split` as it is. chunk_short has one chunk of `chunk`, bit for bit, and a new summary.
ros2_killed_short has the first 800 000 bytes of `ros2_killed`: what the file was when half as long had been recorded.
The others have the last 200 rows of `messages`, all else as it was.
"""


def contents(path, **options):
    """Everything in a recording: (topic, time, type, bytes) in order."""
    with BagReader(path, **options) as bag:
        return list(bag.raw_messages())


@pytest.fixture(scope='module')
def rows():
    """Some 60 messages of a practice recording, all topics."""
    return contents(DATA / 'recording_0')[:60]


def write(path, rows, flush_each=None, **options):
    """Write rows, in chunks of `flush_each` messages; leave the file open if it stands from the start."""
    bag = BagWriter(path, **options)
    for number, (topic, time, kind, raw) in enumerate(rows, 1):
        bag.write(topic, kind, time, raw)
        if flush_each and number % flush_each == 0:
            bag.flush()
    return bag


@pytest.fixture(params=['finished', 'unfinished'])
def recorded(request, tmp_path, rows):
    """A recording of 6 chunks with its end and without it."""
    bag = write(tmp_path / 'run', rows, 10, from_the_start=request.param == 'unfinished')
    bag.close() if request.param == 'finished' else bag.abort()
    return tmp_path / 'run'


# --- messages that are cut off ---


@pytest.fixture
def cut_off(tmp_path):
    """(recording in which two of a topic's messages lack their end, all its rows, the topic, numbers of the two)."""
    rows = contents(DATA / 'recording_0')[:200]
    topic = '/master/if_samples'
    chosen = [number for number, row in enumerate(rows) if row[0] == topic][3:5]
    written = [(*row[:3], bytes(row[3])[: 90 if i in chosen else None]) for i, row in enumerate(rows)]
    write(tmp_path / 'cut', written).close()
    return tmp_path / 'cut', rows, topic, chosen


def test_cut_off_messages_are_refused_with_topic_and_time(cut_off, capsys):
    path, rows, topic, (first, _) = cut_off
    said = f"topic '{topic}': message cannot be decoded, {(rows[first][1] - rows[0][1]) * 1e-9:.3f} s after the start"
    with BagReader(path) as bag, pytest.raises(BagError, match=re.escape(said)):
        list(bag.messages({topic}))
    assert info.main([str(path)]) == 2
    assert said in capsys.readouterr().err


def test_cut_off_messages_are_counted_and_left_out_where_damage_is_skipped(cut_off, capsys):
    path, rows, topic, chosen = cut_off
    total = sum(row[0] == topic for row in rows)
    with BagReader(path, skip_damaged=True) as bag:
        for _ in range(2):  # said once, however often it is read
            assert len(list(bag.messages({topic}))) == total - len(chosen)
        [line] = bag.damages
        whole = list(bag.raw_messages(whole=True))
    assert f"'{topic}': 2 of {total} messages cannot be decoded, the first one " in line
    assert whole == [row for number, row in enumerate(rows) if number not in chosen]
    before = SKIP_DAMAGED.get()
    try:
        assert info.main([str(path), '--json', '--skip-damaged']) == 0
    finally:
        SKIP_DAMAGED.set(before)
    assert json.loads(capsys.readouterr().out)['damages'] == [line]


# --- one flipped bit ---


def test_one_flipped_bit_anywhere_is_found(recorded, rows):
    """Seeded positions in storage file and metadata.yaml, dense in all that is not samples.

    An unfinished recording states no checksum of its header's library name and of metadata.yaml: a flip there is found,
    or changes nothing that is read. With 32 bits, a flip escapes a checksum with 2^-32 at most.
    """
    rng = random.Random(5)
    with BagReader(recorded) as bag:
        intact = bag.unfinished
    finished = not intact
    file = recorded / 'run_0.mcap'
    sizes = {path: path.stat().st_size for path in (file, recorded / 'metadata.yaml')}
    head = [(file, at) for at in range(40)]
    tail = [(file, sizes[file] - 1 - at) for at in range(0, 1500, 11)]
    places = [(path, rng.randrange(size)) for path, size in sizes.items() for _ in range(60)]
    missed = []
    for path, at in (*head, *tail, *places):
        good = path.read_bytes()
        bad = bytearray(good)
        bad[at] ^= 1 << rng.randrange(8)
        path.write_bytes(bad)
        try:
            with BagReader(recorded) as bag:
                found = bool(bag.remarks)
                read = list(bag.raw_messages())
                # what may as well be the end of an unfinished file is stated as missing
                cut = not finished and bag.unfinished != intact
            harmless = read == rows and not finished and (path != file or at < 40)
            if not (found or cut or harmless):
                missed.append((path.name, at))
        except BagError as error:
            assert str(error).startswith(str(recorded))
            assert '\n' not in str(error)
        path.write_bytes(good)
    assert missed == []
    assert contents(recorded) == rows


def chunk_positions(file):
    """Position of each chunk of an MCAP file."""
    data = file.read_bytes()
    found = []
    with contextlib.suppress(ValueError):  # the magic behind the last record
        for opcode, begin, _ in records(data, 8, len(data)):
            found += [begin - RECORD.size] if opcode == CHUNK else []
    return found


def test_damage_is_named_and_the_rest_is_read(recorded, rows, caplog):
    """With file, position, topics and time span; `skip_damaged` gives all messages of the other chunks."""
    file = recorded / 'run_0.mcap'
    third = chunk_positions(file)[2]
    bad = bytearray(file.read_bytes())
    bad[third + 200] ^= 4
    file.write_bytes(bad)
    with pytest.raises(BagError) as caught:
        BagReader(recorded)
    line = str(caught.value)
    assert line.startswith(f'{file}: damaged at byte {third} to ')
    assert 'checksum of a chunk differs' in line
    lost = rows[20:30]
    if 'recording' not in (recorded / 'metadata.yaml').read_text():  # the index at the end says what was in the chunk
        assert all(topic in line for topic, *_ in lost)
        begin, end = (float(t) for t in re.search(r'from (\S+) s to (\S+) s after the start', line).groups())
        assert begin == pytest.approx((lost[0][1] - rows[0][1]) * 1e-9, abs=1e-3)
        assert end == pytest.approx((lost[-1][1] - rows[0][1]) * 1e-9, abs=1e-3)
    assert contents(recorded, skip_damaged=True) == rows[:20] + rows[30:]
    assert any(line.split(';')[0] in record.getMessage() for record in caplog.records)


def test_commands_refuse_damage_or_leave_it_out(tmp_path, rows, capsys):
    """Exit status 2 and one line; with the option the rest."""
    write(tmp_path / 'run', rows, 10).close()
    file = tmp_path / 'run' / 'run_0.mcap'
    bad = bytearray(file.read_bytes())
    bad[chunk_positions(file)[2] + 200] ^= 4
    file.write_bytes(bad)
    assert info.main([str(tmp_path / 'run')]) == 2
    line = capsys.readouterr().err
    assert line.count('\n') == 1
    assert '--skip-damaged reads the rest' in line
    before = SKIP_DAMAGED.set(False)
    try:
        assert info.main([str(tmp_path / 'run'), '--skip-damaged', '--json']) == 0
        said = json.loads(capsys.readouterr().out)
        assert said['messages'] == len(rows) - 10
        assert len(said['damages']) == 1
        out = tmp_path / 'rest'
        assert repair.main([str(tmp_path / 'run'), '--out', str(out), '--skip-damaged']) == 0
    finally:
        SKIP_DAMAGED.reset(before)
    assert contents(tmp_path / 'rest', skip_damaged=False) == rows[:20] + rows[30:]


# --- the end is missing ---


@pytest.mark.parametrize('storage', sorted(STORAGES))
def test_what_was_flushed_can_be_read_while_it_is_recorded(tmp_path, rows, storage):
    """Under rosbag2's own names, with metadata.yaml from the start; the rest follows with `close`."""
    path = tmp_path / 'run'
    bag = write(path, rows[:30], 10, from_the_start=True, storage=storage)
    suffix = {'mcap': 'mcap', 'sqlite3': 'db3'}[storage]
    assert {'metadata.yaml', f'run_0.{suffix}'} <= {p.name for p in path.iterdir()}
    assert contents(path) == rows[:30]
    for topic, time, kind, raw in rows[30:]:
        bag.write(topic, kind, time, raw)
    assert contents(path) == rows[:30], 'not flushed yet'
    bag.close()
    assert contents(path) == rows
    with BagReader(path) as whole:
        assert (whole.unfinished, whole.damages, whole.remarks) == ([], [], [])


def test_file_cut_anywhere_gives_all_its_whole_chunks(tmp_path, rows):
    """60 seeded cuts: exactly the messages of the chunks in front of the cut, and how much that is."""
    write(tmp_path / 'run', rows, 10, from_the_start=True).abort()
    file = tmp_path / 'run' / 'run_0.mcap'
    whole, rng = file.read_bytes(), random.Random(7)
    chunks = [(at, at + RECORD.size + RECORD.unpack_from(whole, at)[1]) for at in chunk_positions(file)]
    for _ in range(60):
        cut = rng.randrange(30, len(whole))
        file.write_bytes(whole[:cut])
        kept = sum(end <= cut for _, end in chunks) * 10
        with BagReader(tmp_path / 'run') as bag:
            assert list(bag.raw_messages()) == rows[:kept]
            [said] = bag.unfinished
        assert f'{kept} messages' in said
        assert f'of {cut} bytes are whole' in said


@pytest.mark.parametrize('storage', sorted(STORAGES))
def test_repair_completes_and_keeps_the_original(tmp_path, rows, storage):
    write(tmp_path / 'run', rows, 10, from_the_start=True, storage=storage).abort()
    before = {p.name: p.read_bytes() for p in (tmp_path / 'run').iterdir()}
    assert repair.main([str(tmp_path / 'run')]) == 0
    with BagReader(tmp_path / 'run') as bag:
        assert list(bag.raw_messages()) == rows
        assert (bag.unfinished, bag.checksums) == ([], True)
    assert sorted(p.name for p in (tmp_path / 'run').iterdir()) == ['metadata.yaml', 'run_0.mcap']
    assert {p.name: p.read_bytes() for p in (tmp_path / 'run.unrepaired').iterdir()} == before
    assert repair.main([str(tmp_path / 'run')]) == 2, 'the original of the first repair is not overwritten'


def test_recording_under_way_is_not_repaired(tmp_path, rows, capsys):
    bag = write(tmp_path / 'run', rows, 10, from_the_start=True)
    assert repair.main([str(tmp_path / 'run')]) == 2
    assert 'is being recorded' in capsys.readouterr().err
    bag.close()
    assert contents(tmp_path / 'run') == rows


def test_lost_metadata_does_not_matter(tmp_path, rows):
    path = tmp_path / 'run'
    write(path, rows, 10).close()
    (path / 'metadata.yaml').unlink()
    assert contents(path) == rows
    assert repair.main([str(path)]) == 0
    assert (path / 'metadata.yaml').exists()


# --- what rosbag2 wrote ---


def ros2_bag(kind):
    """Path of a recording that rosbag2 wrote."""
    path = next((folder / kind for folder in (OWN, MORE) if (folder / kind).exists()), None)
    return path or pytest.skip('lies in shared/recordings only')


def stated_count(path):
    """Messages that rosbag2's metadata.yaml states."""
    return int(re.search(r'^  message_count: (\d+)$', (path / 'metadata.yaml').read_text(), re.M)[1])


@pytest.mark.parametrize('kind', [*KINDS, *SHORT])
def test_rosbag2_files_are_read_whole(kind, tmp_path):
    """Every storage and compression, with and without metadata.yaml; repairing copies every byte of every message."""
    path = ros2_bag(kind)
    messages = contents(path)
    assert len(messages) == stated_count(path) > (190 if kind in SHORT else 800)
    assert {'/master/if_samples', '/master/slave/range', '/diagnostics'} <= {topic for topic, *_ in messages}
    with BagReader(path) as bag:
        assert bag.damages == []
        assert bool(bag.unfinished) == kind.startswith('ros2_killed')
        stored = list(bag.stored_messages(bag.topics.keys()))
    bare = shutil.copytree(path, tmp_path / 'bare')
    (bare / 'metadata.yaml').unlink()
    assert contents(bare) == messages
    repaired, count = repair.repair(path, tmp_path / 'repaired')
    assert count == len(messages)
    with BagReader(repaired) as bag:
        assert list(bag.stored_messages(bag.topics.keys())) == stored
    assert contents(repaired) == messages


@pytest.mark.parametrize('kind', ['mmsg', 'sqlmsg', 'sqlmsg_short', 'splitfile', 'mfile'])
def test_compressed_file_alone_is_read(kind):
    """A .mcap.zstd, or a file whose messages are compressed, without its directory."""
    path = ros2_bag(kind)
    files = sorted(f for f in path.iterdir() if f.name != 'metadata.yaml')
    assert sum(len(contents(file)) for file in files) == stated_count(path)


def test_compressed_file_cut_off_gives_its_whole_chunks(tmp_path):
    path = ros2_bag('splitfile') / 'splitfile_1.mcap.zstd'
    whole = contents(path)
    cut = tmp_path / path.name
    cut.write_bytes(path.read_bytes()[:-100_000])
    with BagReader(cut) as bag:
        assert 'cut off or damaged' in bag.unfinished[0]
        read = list(bag.raw_messages())
    assert read == whole[: len(read)]


def test_file_that_an_earlier_recorder_left_is_read():
    """Killed with -9: two chunks without an end, in a directory of another name, without metadata.yaml."""
    assert len(contents(ros2_bag('own_killed'))) == 1307


def test_field_that_a_recording_is_too_old_for_is_not_a_number():
    """Fields of messages are only ever added: the ranges of these recordings state no protection level yet."""
    with BagReader(ros2_bag('mmsg')) as bag:
        ranges = [m for _, _, m in bag.messages({'/master/slave/range'})]
    assert len(ranges) > 100
    assert all(math.isnan(m.protection_level) and 30.0 < m.range < 1100.0 for m in ranges)
