"""Live diagnosis: what the window keeps, when it is looked at and what is said, work in a process, the node."""

import contextlib
import dataclasses
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import record, scene, without

from drfmcw_bringup.graph import REPLAY, STATION, Graph, parameters, private_environment
from drfmcw_bringup.monitor import monitored
from drfmcw_diagnosis.finding.result import BeforeAfter, Diagnosis, Estimate, Explanation, Fit, FoundEffect, Remainder
from drfmcw_diagnosis.live.watch import OK, STALE, WARN, Judgement, Order, Watch, WatchSettings, is_expected, judge
from drfmcw_diagnosis.live.window import Window, WindowSettings
from drfmcw_diagnosis.recording.dataset import Dataset, read_dataset
from drfmcw_node.processing.records import Sweep
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.bag.files import BagReader
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import from_message

WATCH = 'drfmcw_diagnosis.live.node'
LIMIT = 150.0  # for a full search on a busy machine [s]
STOP_LIMIT = 20.0  # for a process to end after a signal, before a launcher uses force [s]
BEGIN = 1_700_000_000_000_000_000  # [ns]
SWEEPS = 120
STANDING = {'standing': {'distances': [60.0, 200.0, 350.0, 500.0, 640.0], 'sweeps': SWEEPS // 5, 'move_time': 3.0}}
EFFECT = {'effect': 'sweep_ripple', 'station': 'master', 'deviation': 800.0, 'rate': 9000.0}


@pytest.fixture(scope='module')
def recordings(tmp_path_factory) -> dict[str, Path]:
    """A crane that stands at five distances: as the model has it, and with a ramp that ripples."""
    folder = tmp_path_factory.mktemp('watch')
    common = {'timing': {'sweep_interval': 0.02}, 'reference': {'range_std': 0.005}}
    return {
        'clean': record(scene(STANDING, **common), folder / 'clean'),
        'ripple': record(scene(STANDING, effects=[EFFECT], **common), folder / 'ripple'),
    }


# --- the window ---


def sweep(number: int, station: str = 'master', length: int = 8, interval: int = 1_000_000) -> Sweep:
    """A sweep of a pair; the slave's record is stamped 3 us later."""
    peer = {'master': 'slave', 'slave': 'master'}[station]
    stamp = BEGIN + number * interval + (3_000 if station == 'slave' else 0)
    return Sweep(station, peer, number, 8192.0, False, np.zeros(length, np.int16), stamp)


def numbers(window: Window) -> set[int]:
    return {s.sweep_id for s in window.snapshot().sweeps}


@given(
    order=st.permutations([(n, station) for n in range(60) for station in ('master', 'slave')]),
    most=st.integers(24, 80),
)
@settings(max_examples=30, deadline=None)
def test_window_keeps_the_newest_whatever_the_order(order, most):
    """The newest sweeps stay, each with both records; the bound holds after every one."""
    window = Window('master/slave', WindowSettings(sweeps=most, interval=0.0))
    for number, station in order:
        window.add([sweep(number, station)])
        assert len(window) <= most
        assert window.size <= 16 * 2 * len(window)
    assert numbers(window) == set(range(max(0, 60 - most), 60))
    assert window.complete == len(window) == min(60, most)
    assert window.size == 2 * 16 * len(window)
    assert window.received == 120


@given(
    events=st.lists(
        st.tuples(
            st.integers(0, 30), st.sampled_from(['master', 'slave']), st.integers(0, 40_000_000_000),
            st.integers(1, 300_000),
        ),
        max_size=60,
    ),
    interval=st.sampled_from([0.0, 1.0]),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_window_keeps_its_bounds_whatever_comes(events, interval):
    """Numbers that begin again, clocks that are set, sweeps of any length: no more sweeps and bytes than allowed."""
    window = Window('master/slave', WindowSettings(sweeps=24, memory=1.0, interval=interval, burst=3))
    for number, station, offset, length in events:
        one = dataclasses.replace(sweep(number, station, length), stamp=BEGIN + offset)
        window.add([one])
        kept = window.snapshot().sweeps
        assert len(window) <= 24
        assert sum(s.samples.nbytes for s in kept) <= window.size <= 1_000_000
        assert window.complete <= len(window)


def test_bursts_leave_out_what_lies_between():
    """Five consecutive pairs every 50 ms of a sweep per millisecond; partners agree on it in any order of arrival."""
    window = Window('master/slave', WindowSettings(sweeps=100, interval=0.05, burst=5))
    window.add([sweep(n) for n in range(120)])
    window.add([sweep(n, 'slave') for n in range(120)])
    assert numbers(window) == {n for n in range(120) if n % 50 < 5}
    assert window.complete == len(window)


def test_sweeps_with_others_are_not_kept():
    window = Window('master/slave', WindowSettings(interval=0.0))
    window.add([dataclasses.replace(sweep(0), peer='slave_2'), dataclasses.replace(sweep(1), station='other')])
    assert len(window) == window.received == 0


def test_time_set_back_begins_a_new_window():
    """A recording that is played again, or a clock that is set: sweeps of the other time go at once."""
    window = Window('master/slave', WindowSettings(interval=0.0))
    window.add([sweep(n) for n in range(100_000, 100_010)])
    window.add([sweep(n) for n in range(5)])
    assert numbers(window) == set(range(5))


def fed(recording: Path, stations=('master', 'slave'), missing=(), until: int | None = None, **changes) -> Window:
    """A window that has taken a recording's messages in the order of its clock, the sweeps of some stations.

    Those of the topics `missing` do not come, nor do sweeps from number `until` on.
    """
    window = Window('master/slave', WindowSettings(**{'interval': 0.0} | changes))
    with BagReader(recording) as bag:
        for topic, _, message in bag.messages(set(bag.topics) - set(missing)):
            if topic.endswith('/if_samples'):
                taken = message.station in stations and (until is None or message.sweep_id < until)
                window.add([from_message(message, Sweep)] * taken)
            else:
                window.take(topic, message)
    return window


def assert_same(one: Dataset, other: Dataset) -> None:
    for field in dataclasses.fields(Dataset):
        if field.name != 'path':
            np.testing.assert_equal(getattr(one, field.name), getattr(other, field.name), err_msg=field.name)


def test_window_gives_the_dataset_of_the_recording(recordings):
    assert_same(fed(recordings['clean']).snapshot().dataset(), read_dataset(recordings['clean']))


def test_one_station_alone_is_a_window_too(recordings):
    """Where the other one's raw sweeps are not at hand: everything but them is as before."""
    window = fed(recordings['clean'], stations=('master',))
    assert window.complete == SWEEPS
    alone, both = window.snapshot().dataset(), fed(recordings['clean']).snapshot().dataset()
    assert alone.samples[1] is None and np.array_equal(alone.samples[0], both.samples[0])
    assert alone.sweeps == both.sweeps and np.array_equal(alone.reference, both.reference)


def test_conditions_leave_with_the_sweeps_they_were_for(recordings):
    """Of a window of the last setting only its readings stay, and what held before it and still holds."""
    whole, window = fed(recordings['clean']), fed(recordings['clean'], sweeps=24)
    dataset, full = window.snapshot().dataset(), whole.snapshot().dataset()
    assert np.array_equal(dataset.sweep_id, full.sweep_id[-24:])
    for name in ('reference', 'temperature', 'board_temperature', 'full_scale'):
        assert np.array_equal(getattr(dataset, name), getattr(full, name)[..., -24:]), name
    assert dataset.calibration == full.calibration
    readings = [w.snapshot().conditions.reference(w.pair).stamps for w in (whole, window)]
    assert len(readings[1]) < len(readings[0]) == len(full)
    assert readings[1][0] >= dataset.stamp[0] - 10_000_000_000


# --- when is looked, and what is said ---


def judgement(verdict: str = '', failed: bool = False, *effects: str, left: float = 0.0) -> Judgement:
    """What a look says; `verdict` that of a search, '' for none, `left` the share that its effects leave."""
    names = {'target_motion': 'velocity[0]', 'echo': 'excess_range'}
    found = [FoundEffect(e, None, {names[e]: Estimate(1.0, 0.1, 'm')}, 50.0, 1e-9) for e in effects]
    fit = Fit(BeforeAfter(9.0, 1.0), BeforeAfter(9.0, 1.0))
    explanation = Explanation(tuple(found), 50.0) if found else None
    rest = Remainder(1e-9, left, ()) if left else None
    diagnosis = Diagnosis('live', verdict, 1e-9, 1e-4, (), explanation, (), None, fit, None, (), (), remainder=rest)
    found = diagnosis if verdict else None
    return Judgement('', 96, BEGIN, BEGIN + 10**9, 0.5, 1.0, failed, False, False, found)


@pytest.fixture
def ready(recordings) -> Watch:
    """A watch over a window that can be judged."""
    return Watch(fed(recordings['clean']), WatchSettings(fewest=96, period=10.0, search_interval=100.0, hold=60.0))


def test_nothing_is_judged_from_too_little(recordings):
    """What lacks is said, and no look is ordered."""
    window = Window('master/slave')
    watch = Watch(window)
    assert watch.order(0.0) is None
    assert (watch.statement(0.0).level, 'no sweep of master/slave' in watch.statement(0.0).message) == (STALE, True)
    window.add([sweep(0)])
    assert watch.order(1.0) is None
    said = watch.statement(1.0).message
    assert '/master/sweep_config' in said and '/slave/calibration' in said
    watch = Watch(fed(recordings['clean'], sweeps=50), WatchSettings(fewest=96))
    assert watch.order(0.0) is not None, 'a window that holds no more is judged when it is full'
    watch = Watch(fed(recordings['clean']), WatchSettings(fewest=500))
    assert watch.order(0.0) is None
    assert '120 of 336' in watch.statement(0.0).message


def test_looks_come_by_period_and_only_for_new_sweeps(ready):
    first = ready.order(0.0)
    assert first is not None and not first.search and not first.failed
    ready.take(judgement(), 1.0)
    assert (ready.statement(2.0).level, ready.statement(2.0).message) == (OK, 'the model explains the last 96 sweeps')
    assert ready.order(50.0) is None, 'nothing new'
    assert ready.statement(50.0).level == STALE
    ready.window.add([sweep(10**6)])
    assert ready.order(50.1) is not None
    assert ready.statement(50.2).level == OK
    ready.window.add([sweep(10**6 + 1)])
    assert ready.order(55.0) is None
    assert ready.order(150.0).search, 'from time to time, whatever the check says'


def test_a_finding_is_said_until_it_has_gone_for_a_while(ready):
    """Checked, searched, found, gone, forgotten."""
    ready.order(0.0)
    ready.settings = dataclasses.replace(ready.settings, expected=[''])
    ready.take(dataclasses.replace(judgement(failed=True), searching=True), 1.0)
    said = ready.statement(1.0)
    assert said.level == WARN and 'searching' in said.message and said.values['verdict'] == 'being searched'
    ready.take(judgement('explained', True, 'echo'), 2.0)
    for now in (2.0, 9.0):
        said = ready.statement(now)
        assert said.level == WARN and 'left out of the model: echo' in said.message
        assert (said.values['verdict'], said.values['effect 1'], said.values['misfit after']) == (
            'explained',
            'echo',
            1.0,
        )
    ready.window.add([sweep(10**6)])
    assert ready.order(20.0).failed, 'a search only where the check changes'
    ready.take(judgement(failed=True), 21.0)
    assert ready.statement(21.0).level == WARN
    ready.take(judgement('consistent', False), 25.0)
    assert ready.finding is None
    assert ready.statement(26.0).level == WARN and 'again' in ready.statement(26.0).message
    ready.window.add([sweep(10**6 + 1)])
    ready.order(90.0)
    assert ready.statement(90.0).level == OK


def test_what_is_expected_is_no_reason_to_warn(ready):
    ready.order(0.0)
    ready.take(judgement('explained', True, 'target_motion'), 1.0)
    assert ready.statement(1.0).level == OK and 'target motion' in ready.statement(1.0).message.lower()
    ready.take(judgement('explained', True, 'target_motion', 'echo'), 2.0)
    assert ready.statement(2.0).level == WARN
    with pytest.raises(ConfigurationError, match="did you mean 'target_motion'"):
        WatchSettings(expected=['target_moton'])


def test_a_search_warns_only_when_it_has_ended(ready):
    """Of what it may find, or found before, some is expected: no warning before it names something else."""
    ready.settings = dataclasses.replace(ready.settings, expected=['echo'])
    search = dataclasses.replace(judgement(failed=True), searching=True)
    for now, look, level, verdict in (
        (1.0, search, OK, 'being searched'),
        (60.0, judgement('explained', True, 'echo'), OK, 'explained'),
        (360.0, search, OK, 'explained'),
        (420.0, judgement('explained', True, 'echo'), OK, 'explained'),
        (720.0, search, OK, 'explained'),
        (780.0, judgement('explained', True, 'echo', 'target_motion'), WARN, 'explained'),
    ):
        ready.window.add([sweep(10**6 + int(now))])
        ready.order(now)
        ready.take(look, now)
        said = ready.statement(now)
        assert (said.level, said.values['verdict']) == (level, verdict), now


def test_a_search_that_fails_leaves_no_doubt(ready):
    """What the check found stays a warning although nothing names it, expected or not."""
    ready.order(0.0)
    ready.take(dataclasses.replace(judgement(failed=True), searching=True), 1.0)
    ready.take(Judgement('killed by SIGKILL'), 20.0)
    assert ready.statement(20.0).level == WARN
    ready.window.add([sweep(10**6)])
    assert not ready.order(30.0).search
    ready.take(judgement(failed=True), 31.0)
    said = ready.statement(31.0)
    assert (said.level, said.values['verdict']) == (WARN, 'not judged') and 'no search has said why' in said.message


DRIVING = {'drive': {'waypoints': [300.0, 308.0], 'speed': 1.0, 'acceleration': 0.3, 'dwell': 1.0}}


@pytest.fixture(scope='module')
def driving(tmp_path_factory) -> Path:
    """A crane that accelerates, drives and stops."""
    return record(scene(DRIVING, timing={'sweep_interval': 0.05}), tmp_path_factory.mktemp('drive') / 'drive')


@pytest.mark.parametrize('missing', [(), ('/reference/range',)], ids=['reference', 'no_reference'])
def test_a_drive_alone_starts_no_search(driving, recordings, missing):
    """Where it is expected; a mismatch of a crane that stands does. The recordings are fixed."""
    for path, expected, failed, drives in (
        (driving, ('target_motion',), False, True),
        (driving, (), True, False),
        (recordings['ripple'], ('target_motion',), True, False),
        (recordings['clean'], ('target_motion',), False, False),
    ):
        window = fed(path, missing=missing)
        (judged,) = judge(Order(window.snapshot(), 1e-4, failed, False, None, expected))
        assert not judged.problem
        assert (judged.failed, judged.searching, judged.driving) == (failed, False, drives)


def judged_alone(window: Window) -> Judgement:
    """What the quick check says of a window where a drive is expected."""
    return next(judge(Order(window.snapshot(), 1e-4, False, False, None, ('target_motion',))))


@pytest.mark.parametrize('missing', [(), ('/reference/range',)], ids=['reference', 'no_reference'])
@pytest.mark.parametrize('since', [0.1, 0.3])
def test_a_drive_is_seen_from_its_first_centimetre_on(tmp_path, missing, since):
    """Within 5 mm of noise, when a tenth of a second and 1.5 mm of it are in the window; the recording is fixed."""
    drive = {'drive': {'waypoints': [300.0, 301.0], 'speed': 1.0, 'acceleration': 0.3, 'dwell': 2.0}}
    path = record(scene(drive, timing={'sweep_interval': 0.02}, reference={'range_std': 0.005}), tmp_path / 'drive')
    begin = round(2.0 / 0.02)
    judged = judged_alone(fed(path, missing=missing, until=begin + round(since / 0.02)))
    assert (judged.driving, judged.failed) == (True, False)
    assert not judged_alone(fed(path, missing=missing, until=begin)).driving


def test_sway_is_no_drive(tmp_path):
    """It brings the crane nowhere: what the check leaves over is searched for."""
    standing = {'standing': {'distances': [100.0] * 3, 'sweeps': 40, 'move_time': 3.0}}
    sway = {'effect': 'sway', 'amplitude': 0.005, 'frequency': 0.7}
    common = {'timing': {'sweep_interval': 0.02}, 'reference': {'range_std': 0.005}}
    judged = judged_alone(fed(record(scene(standing, effects=[sway], **common), tmp_path / 'sway')))
    assert (judged.driving, judged.failed) == (False, True)


def test_a_drive_warns_only_of_what_is_named_beside_it(ready):
    """What no effect explains of an accelerating crane does not; of a crane that stands it does, even beside one."""
    for verdict, effects, left, drives, expected in (
        ('explained', ('target_motion',), 0.0, True, True),
        ('explained', ('target_motion',), 1e-4, False, True),
        ('partial', ('target_motion',), 0.1, True, True),
        ('partial', ('target_motion',), 0.1, False, False),
        ('ambiguous', ('target_motion',), 0.0, False, True),
        ('ambiguous', ('target_motion',), 1e-4, False, True),
        ('ambiguous', ('target_motion',), 0.1, False, False),
        ('ambiguous', ('target_motion',), 0.1, True, True),
        ('unexplained', (), 1.0, True, True),
        ('unexplained', (), 1.0, False, False),
        ('explained', ('target_motion', 'echo'), 0.0, True, False),
    ):
        look = judgement(verdict, False, *effects, left=left)
        assert is_expected(look.found, ('target_motion',), drives) == expected
        ready.finding = None
        ready.order(0.0)
        ready.take(dataclasses.replace(look, driving=drives), 1.0)
        assert (ready.statement(1.0).level == OK) == expected, (verdict, effects)


def test_what_cannot_be_judged_is_said(ready):
    ready.order(0.0)
    ready.take(Judgement('real and quadrature samples are mixed'), 1.0)
    assert ready.statement(1.0).level == STALE and 'quadrature' in ready.statement(1.0).message
    ready.take(judgement(), 2.0)
    ready.take(Judgement('killed by SIGKILL'), 3.0)
    assert ready.statement(3.0).level == WARN and 'SIGKILL' in ready.statement(3.0).message


# --- in a graph ---


@pytest.mark.graph
@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (['--pair', 'masterslave'], "pair: 'masterslave' is not 'first/second'"),
        (['--findings', '/proc/none'], 'findings: /proc/none: '),
        (parameters({'expected': '[target_moton]'}), "did you mean 'target_motion'?"),
        (parameters({'second_source': 'compresed'}), "did you mean 'compressed'?"),
        (parameters({'window.sweeps': 3}), 'window.sweeps'),
    ],
)
def test_wrong_start_ends_with_one_line(arguments, said):
    ended = subprocess.run([sys.executable, '-m', WATCH, *arguments], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2
    assert re.fullmatch(r'[^\n]+\n', ended.stderr) and said in ended.stderr, ended.stderr
    assert ended.stdout == ''


class Heard:
    """What the watch has said so far."""

    def __init__(self) -> None:
        self.said: list[DiagnosticStatus] = []

    def take(self, array: DiagnosticArray) -> None:
        self.said += [s for s in array.status if s.name == '/watch: Model master/slave']

    def wait(self, condition, log: Path) -> DiagnosticStatus:
        """Wait until the newest statement is as wanted, and return it."""
        end = time.monotonic() + LIMIT
        while not self.said or not condition(self.said[-1]):
            hopeless = self.said and 'could not be judged' in self.said[-1].message
            if hopeless or time.monotonic() > end:
                pytest.fail(f'{[s.message for s in self.said[-5:]]}\n{log.read_text(encoding="utf-8")}')
            time.sleep(0.05)
        return self.said[-1]


@contextlib.contextmanager
def watched(directory: Path, **changes):
    """A watch node in a graph of its own that looks at all of a small recording, once; (graph, heard, log)."""
    environment = private_environment()
    given = {'window.burst': SWEEPS, 'window.interval': 3600.0, 'fewest': SWEEPS, 'period': 1.0} | changes
    with (
        Graph(environment, directory / 'log') as graph,
        monitored([], int(environment['ROS_DOMAIN_ID'])) as monitor,
    ):
        heard = Heard()
        monitor.create_subscription(DiagnosticArray, '/diagnostics', heard.take, qos.RELIABLE)
        findings = ('--findings', str(directory / 'findings'))
        graph.start('watch', WATCH, '--pair', 'master/slave', *findings, *parameters(given))
        log = directory / 'log' / 'watch.log'
        heard.wait(lambda s: s.level == DiagnosticStatus.STALE and 'no sweep' in s.message, log)
        yield graph, heard, log


@pytest.mark.graph
@pytest.mark.slow
def test_node_names_what_is_left_out(recordings, tmp_path):
    """The size lies within 4 of its standard deviations (the recording is fixed); Ctrl-C ends the node at once."""
    with watched(tmp_path) as (graph, heard, log):
        graph.start('player', REPLAY, str(recordings['ripple']), '--publish', '--rate', '4', '--loop', '0')
        said = heard.wait(lambda s: s.message.startswith('left out of the model: '), log)
        assert said.level == DiagnosticStatus.WARN
        assert 'sweep ripple at master' in said.message
        values = {v.key: v.value for v in said.values}
        assert (values['verdict'], values['sweeps judged']) == ('explained', str(SWEEPS))
        assert (values['effect 1'], values['effect 1 station']) == ('sweep_ripple', 'master')
        for name in ('deviation', 'rate'):
            size, std = (float(values[f'effect 1 {name}{x} [Hz]']) for x in ('', ' std'))
            assert abs(size - EFFECT[name]) < 4 * std < 0.05 * size
        assert float(values['misfit before']) > 2.0 > 1.1 > float(values['misfit after'])
        process = graph.members['watch'].process
        graph.stop('watch')
        assert process.returncode == 0
        text = log.read_text(encoding='utf-8')
        assert 'sweep ripple at master' in text and 'Traceback' not in text
    (folder,) = (tmp_path / 'findings').iterdir()
    assert {p.name for p in folder.iterdir()} == {'finding.json', 'report.html', 'refined.yaml'}
    finding = json.loads((folder / 'finding.json').read_text(encoding='utf-8'))
    assert finding['effects'][0]['effect'] == 'sweep_ripple' and finding['window']['sweeps'] == SWEEPS


@pytest.mark.graph
@pytest.mark.slow
def test_node_is_content_with_what_the_model_explains(recordings, tmp_path):
    """False failure: the stated rate of 1e-4, for a recording that is fixed. A full search is made, too."""
    with watched(tmp_path, search_interval=0.0) as (graph, heard, log):
        graph.start('player', REPLAY, str(recordings['clean']), '--publish', '--rate', '4')
        said = heard.wait(lambda s: s.message == f'the model explains the last {SWEEPS} sweeps', log)
        assert said.level == DiagnosticStatus.OK
        values = {v.key: v.value for v in said.values}
        assert (values['verdict'], values['records received']) == ('consistent', str(2 * SWEEPS))
        heard.wait(lambda s: {v.key: v.value for v in s.values}['last full search'] != 'none yet', log)
        assert DiagnosticStatus.WARN not in [s.level for s in heard.said]
    assert not list((tmp_path / 'findings').iterdir())


@pytest.mark.graph
@pytest.mark.slow
@pytest.mark.parametrize(
    ('reference', 'changes'),
    [
        (False, {'window.interval': 0.0, 'window.sweeps': 48, 'period': 0.5}),  # every look a quick check
        (True, {'window.burst': 48, 'search_interval': 0.0}),  # the first sweeps of the drive, and a full search
    ],
    ids=['looks', 'search'],
)
def test_node_is_content_with_a_drive(driving, tmp_path, reference, changes):
    """No warning and no finding while the crane accelerates, drives and stops, with and without a reference."""
    path = driving if reference else without(driving, tmp_path / 'played', '/reference/range')
    with watched(tmp_path, **{'fewest': 48} | changes) as (graph, heard, log):
        graph.start('player', REPLAY, str(path), '--publish')
        said = heard.wait(lambda s: s.message.startswith('the crane drives, as expected'), log)
        assert said.level == DiagnosticStatus.OK
        if reference:
            said = heard.wait(lambda s: {v.key: v.value for v in s.values}['last full search'] != 'none yet', log)
            assert {v.key: v.value for v in said.values}['verdict'] == 'explained' and 'arget motion' in said.message
        graph.members['player'].process.wait(LIMIT)
        assert DiagnosticStatus.WARN not in [s.level for s in heard.said], [s.message for s in heard.said]
    assert not list((tmp_path / 'findings').iterdir())


@pytest.mark.graph
def test_signal_ends_a_node_that_searches(recordings, tmp_path):
    """Within ten seconds, status 0, no traceback; one station's sweeps come compressed here."""
    with watched(tmp_path, **{'window.interval': 0.0, 'second_source': 'compressed'}) as (graph, heard, log):
        graph.start('slave', STATION, '--station', 'slave', *parameters({'output': 'compressed'}))
        graph.start('player', REPLAY, str(recordings['ripple']), '--publish', '--rate', '4', '--loop', '0')
        said = heard.wait(lambda s: 'searching for what it leaves out' in s.message, log)
        assert {v.key: v.value for v in said.values}['stations heard'] == 'master, slave'
        process = graph.members['watch'].process
        began = time.monotonic()
        graph.stop('watch')
        assert process.returncode == 0 and time.monotonic() - began < STOP_LIMIT
        assert 'Traceback' not in log.read_text(encoding='utf-8')
