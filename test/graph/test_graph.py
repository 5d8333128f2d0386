"""Whole graphs of real processes: no loss, the same replayed, stations that die, time division, clean ends."""

import contextlib
import dataclasses
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from checkout import DATA, ROOT
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from drfmcw_msgs.msg import BeatFrequency, IfSamples, ReferenceRange
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from scenes import mapping

from drfmcw_bringup.graph import (
    FUSION,
    PAIR_STATION,
    RECORDER,
    REPLAY,
    SIMULATOR,
    STATION,
    Graph,
    parameters,
    private_environment,
)
from drfmcw_bringup.monitor import RangeMonitor, monitored
from drfmcw_bringup.run import PATIENT, pair_names, start_graph, start_nodes
from drfmcw_fusion.offline import replay_recording
from drfmcw_fusion.pipeline import Flag
from drfmcw_fusion.replayed.statistics import reference_at
from drfmcw_fusion.replayed.verification import compare
from drfmcw_node.processing.records import Sweep
from drfmcw_ros.bag.files import BagReader
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import from_message, stamp_ns, to_message
from drfmcw_sim.scenario import read_scenario

pytestmark = pytest.mark.graph

WATCH = 'drfmcw_diagnosis.live.node'
PRACTICE = DATA / 'recording_0'
LIMIT = 40.0  # for anything that is waited for, on a busy machine [s]
STOP_LIMIT = 20.0  # for a process to end after a signal, before a launcher uses force [s]
STANDING = {'standing': {'distances': [100.0], 'sweeps': 1_000_000}}


@dataclasses.dataclass
class Site:
    """Processes, and what is heard of them."""

    graph: Graph
    monitor: RangeMonitor
    directory: Path
    diagnostics: dict[tuple[str, str], DiagnosticStatus] = dataclasses.field(default_factory=dict)
    references: dict[int, float] = dataclasses.field(default_factory=dict)  # by stamp [ns]

    def listen(self) -> None:
        """Take in diagnostics and the reference instrument."""

        def diagnose(array: DiagnosticArray) -> None:
            self.diagnostics.update({(s.hardware_id, s.name): s for s in array.status})

        def refer(message: ReferenceRange) -> None:
            self.references[stamp_ns(message.header.stamp)] = message.range

        self.monitor.create_subscription(DiagnosticArray, '/diagnostics', diagnose, qos.RELIABLE)
        self.monitor.create_subscription(ReferenceRange, '/reference/range', refer, qos.RELIABLE)

    def start(
        self, scenario: Path, simulator: dict[str, Any], record: Path | None = None, file: Path | None = None
    ) -> None:
        """Start everything that a scenario needs, with parameters from a file."""
        start_graph(self.graph, scenario, read_scenario(scenario), simulator, self.monitor, record, file=file)

    def wait(self, condition: Any, what: str) -> None:
        """Wait for a condition; failing that, show what the processes said."""
        end = time.monotonic() + LIMIT
        while not condition():
            if time.monotonic() > end:
                pytest.fail(f'waited {LIMIT:g} s for {what}; {self.monitor.total} ranges\n{self.logs()}')
            time.sleep(0.02)

    def wait_for_end(self, name: str) -> int:
        """Wait until a process has ended; return its status."""
        process = self.graph.members[name].process
        self.wait(lambda: process.poll() is not None, f'the end of {name}')
        return process.returncode

    def log(self, name: str) -> str:
        return (self.directory / 'log' / f'{name}.log').read_text(encoding='utf-8', errors='replace')

    def logs(self) -> str:
        """The last lines of every process."""
        names = sorted(p.stem for p in (self.directory / 'log').glob('*.log'))
        return '\n'.join(f'--- {name}\n{self.log(name)[-2000:]}' for name in names)

    def value(self, name: str, key: str) -> str:
        """A value in the diagnostics, '' while there is none."""
        found = [v.value for (_, n), s in self.diagnostics.items() if n == name for v in s.values if v.key == key]
        return found[0] if found else ''

    def set_parameter(self, node: str, name: str, value: Any) -> tuple[bool, str]:
        """Set a parameter through the node's service, as `ros2 param set` does; return (accepted, reason)."""
        kinds = {
            bool: (ParameterType.PARAMETER_BOOL, 'bool_value'),
            float: (ParameterType.PARAMETER_DOUBLE, 'double_value'),
            str: (ParameterType.PARAMETER_STRING, 'string_value'),
            (float,): (ParameterType.PARAMETER_DOUBLE_ARRAY, 'double_array_value'),
            (int,): (ParameterType.PARAMETER_INTEGER_ARRAY, 'integer_array_value'),
        }
        kind, field = kinds[(type(value[0]),) if isinstance(value, list) else type(value)]
        request = SetParameters.Request(
            parameters=[Parameter(name=name, value=ParameterValue(type=kind, **{field: value}))]
        )
        client = self.monitor.create_client(SetParameters, f'{node}/set_parameters')
        self.wait(client.service_is_ready, f'the parameter service of {node}')
        future = client.call_async(request)
        self.wait(future.done, f'the answer of {node}')
        (result,) = future.result().results
        self.monitor.destroy_client(client)
        return result.successful, result.reason


@contextlib.contextmanager
def site(directory: Path, pairs=('master/slave',)):
    """A graph of its own with nothing started yet; afterwards everything is stopped."""
    environment = private_environment()
    with (
        Graph(environment, directory / 'log') as graph,
        monitored(list(pairs), int(environment['ROS_DOMAIN_ID']), keep=True) as monitor,
    ):
        opened = Site(graph, monitor, directory)
        opened.listen()
        yield opened


def scenario_file(directory: Path, trajectory: dict[str, Any], **sections: Any) -> Path:
    path = directory / 'scenario.yaml'
    path.write_text(yaml.safe_dump(mapping(trajectory, **sections)))
    return path


def errors_of(ranges: list[Any], truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(error [m], reported standard deviation [m]) of ranges in which nothing is in doubt."""
    sure = np.array([r.flags == 0 for r in ranges])
    error = np.array([r.range for r in ranges]) - truth
    return error[sure], np.array([r.range_std for r in ranges])[sure]


# --- a crane, recorded and replayed ---


@pytest.fixture(scope='module')
def recorded_drive(tmp_path_factory):
    """A drive across the limit between the modes, as fast as the stations go, recorded; (site, arrivals, recording)."""
    directory = tmp_path_factory.mktemp('drive')
    path = scenario_file(
        directory,
        {'drive': {'waypoints': [640, 680], 'speed': 4.0, 'acceleration': 0.3, 'dwell': 4.0}},
        alphas=(1.000006, 0.999991),
        timing={'sweep_interval': 0.05},
    )
    recording = directory / 'recording'
    with site(directory) as live:
        # recorder and fusion hear of a station's topics after it has started, on a busy machine three seconds later
        simulator = {'pace': 'subscribers', 'start': 'scenario', 'window': 20, 'settings_pause': 5.0}
        live.start(path, simulator, recording)
        assert live.wait_for_end('simulator') == 0, live.logs()
        sweeps = int(re.search(r'scenario ended after (\d+) sweeps', live.log('simulator'))[1])
        live.wait(lambda: live.monitor.total >= sweeps, f'{sweeps} ranges')
        written = ('/recorder: Recording', '/master/slave/range')
        live.wait(lambda: live.value(*written) == str(sweeps), f'{sweeps} ranges in the recording')
        live.graph.stop()
    return live, live.monitor.arrivals, recording, sweeps


def test_every_sweep_yields_one_range(recorded_drive):
    """Nothing is lost or doubled, across a change of mode at full speed."""
    _, arrivals, _, sweeps = recorded_drive
    assert sweeps > 400
    assert [a.sweep_id for a in arrivals] == list(range(sweeps))
    assert all((a.message.first_station, a.message.second_station) == ('master', 'slave') for a in arrivals)
    assert all(a.message.header.frame_id == 'master_antenna' for a in arrivals)


def test_ranges_are_true(recorded_drive):
    """Unbiased, and scattered as they say, in both modes; P(false failure) < 1e-6 (5 sigma)."""
    _, arrivals, recording, _ = recorded_drive
    reference = replay_recording(str(recording)).reference
    ranges = [a.message for a in arrivals]
    truth = reference_at(reference, np.array([a.stamp for a in arrivals]))
    assert np.isfinite(truth).all()
    assert truth.min() == pytest.approx(640.0, abs=1e-6)
    assert truth.max() == pytest.approx(680.0, abs=1e-6)
    for mode in (0, 1):
        chosen = [i for i, r in enumerate(ranges) if r.mode == mode]
        error, std = errors_of([ranges[i] for i in chosen], truth[chosen])
        n = len(error)
        assert n > 50
        assert n > 0.95 * len(chosen), 'few are in doubt'
        assert abs(error.mean()) < 1e-3 + 5 * std.mean() / np.sqrt(n)
        assert np.mean((error / std) ** 2) == pytest.approx(1.0, abs=5 * np.sqrt(2 / n))


def test_mode_follows_the_distance(recorded_drive):
    """Short-distance mode below the limit, long-distance mode beyond it, one change between."""
    live, arrivals, _, _ = recorded_drive
    modes = np.array([a.message.mode for a in arrivals])
    assert np.count_nonzero(np.diff(modes)) == 1
    assert (modes[0], modes[-1]) == (0, 1)
    asked = float(re.search(r'LD mode asked for at ([\d.]+) m', live.log('fusion'))[1])
    assert asked == pytest.approx(660.0, abs=0.5), '650 m and half the hysteresis; 17 cm per sweep, 6 sigma of 9 mm'
    assert live.log('fusion').count('mode asked for') == 1


def assert_replays(recording: Path, sweeps: int, *options: str) -> None:
    """Every range of the recording is computed again to the last bit, and no other, in both modes."""
    ended = subprocess.run(
        [sys.executable, '-m', REPLAY, str(recording), '--verify', '--json', '-', *options],
        capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    said = ' '.join(ended.stderr.split())
    expected = f'{sweeps} identical bit by bit, 0 different, 0 only in the recording, 0 only recomputed'
    assert expected in said
    assert ended.returncode == 0
    assert {row['mode'] for row in json.loads(ended.stdout)} == {'SD', 'LD'}


def test_recording_replays_bit_by_bit(recorded_drive):
    _, _, recording, sweeps = recorded_drive
    assert_replays(recording, sweeps)


def test_every_node_reports_diagnostics(recorded_drive):
    live, _, _, _ = recorded_drive
    found = set(live.diagnostics)
    wanted = {
        ('simulator', '/simulator: Scenario'),
        ('master', '/master/station: Sweeps'), ('master', '/master/station: Source'),
        ('slave', '/slave/station: Sweeps'), ('slave', '/slave/station: Source'),
        ('fusion', '/fusion: Range master/slave'), ('fusion', '/fusion: Pairing'),
        ('recorder', '/recorder: Recording'),
    }  # fmt: skip
    assert wanted <= found
    assert live.value('/master/station: Sweeps', 'dropped') == '0'


# --- both stations evaluated together ---

PACKED = '/slave/if_samples_compressed'


@pytest.fixture(scope='class')
def joint_drive(tmp_path_factory):
    """A drive with one station's sweeps raw, the other's compressed, at full speed; (site, recording, sweeps).

    It crosses the limit between the modes. The recording has ended; all but recorder and simulator still run.
    """
    directory = tmp_path_factory.mktemp('joint')
    path = scenario_file(
        directory,
        {'drive': {'waypoints': [645, 667], 'speed': 4.0, 'acceleration': 0.3, 'dwell': 1.0}},
        alphas=(1.000006, 0.999991),
        timing={'sweep_interval': 0.05},
    )
    recording = directory / 'recording'
    with site(directory) as live:
        start_nodes(live.graph, read_scenario(path), recording, estimator='pair', patient=True)
        matched = [  # each topic on its own, and at both ends: what is sent before is lost
            ('/fusion: Range master/slave', 'subscribers of /master/slave/range', 2),  # monitor and recorder
            ('/fusion: Inputs', 'publishers of /master/beat_frequency', 1),
            ('/fusion: Inputs', 'publishers of /slave/beat_frequency', 2),  # the pair's node and the slave's own
            ('/master/pair_station: Source', f'publishers of {PACKED}', 1),
            ('/master/pair_station: Sweeps', 'subscribers of /master/beat_frequency', 2),  # fusion and recorder
            ('/master/pair_station: Sweeps', 'subscribers of /slave/beat_frequency', 2),
            ('/slave/station: Sweeps', f'subscribers of {PACKED}', 2),  # the pair's node and recorder
        ]
        for name, key, count in matched:
            live.wait(lambda n=name, k=key, c=count: live.value(n, k) == str(c), f'{count} {key}')
        live.wait(lambda: live.monitor.wait_for_publishers(1.0), 'the fusion to be heard')
        simulator = {'scenario': path, 'pace': 'subscribers', 'start': 'scenario', 'window': 20, 'listeners': 2}
        live.graph.start('simulator', SIMULATOR, *parameters(simulator))
        assert live.wait_for_end('simulator') == 0, live.logs()
        sweeps = int(re.search(r'scenario ended after (\d+) sweeps', live.log('simulator'))[1])
        live.wait(lambda: live.monitor.total >= sweeps, f'{sweeps} ranges')
        written = ('/recorder: Recording', '/master/slave/range')
        live.wait(lambda: live.value(*written) == str(sweeps), f'{sweeps} ranges in the recording')
        live.graph.stop('recorder')
        yield live, recording, sweeps


class TestJointDrive:
    """A pair's node in place of both stations'."""

    def test_every_sweep_yields_one_range(self, joint_drive):
        live, recording, sweeps = joint_drive
        assert sweeps > 200
        assert [a.sweep_id for a in live.monitor.arrivals] == list(range(sweeps))
        assert np.mean([a.message.flags == 0 for a in live.monitor.arrivals]) > 0.9, 'few are in doubt'
        with BagReader(str(recording)) as bag:
            beats = {t: sum(1 for _ in bag.messages({t})) for t in bag.topics if t.endswith('/beat_frequency')}
        assert beats == {'/master/beat_frequency': sweeps, '/slave/beat_frequency': sweeps}, (
            "none from the slave's own node"
        )

    def test_recording_replays_bit_by_bit(self, joint_drive):
        _, recording, sweeps = joint_drive
        assert_replays(recording, sweeps, '--estimator', 'pair')

    def test_sweep_without_partner_is_not_kept_waiting(self, joint_drive):
        """When nothing else comes either, it still gives its beat frequency; until then none was without partner."""
        live, recording, sweeps = joint_drive
        live.wait(lambda: live.value('/master/pair_station: Pairs', 'pairs') == str(sweeps), 'the count of pairs')
        assert live.value('/master/pair_station: Pairs', 'sweeps without partner') == '0'
        assert live.value('/master/pair_station: Sweeps', 'dropped') == '0'
        beats: list[BeatFrequency] = []
        subscription = live.monitor.create_subscription(
            BeatFrequency, '/master/beat_frequency', beats.append, qos.RELIABLE
        )
        sender = live.monitor.create_publisher(IfSamples, '/master/if_samples', qos.RELIABLE)
        live.wait(lambda: subscription.get_publisher_count() and sender.get_subscription_count(), "the pair's node")
        with BagReader(str(recording)) as bag:
            *_, (_, _, last) = bag.messages({'/master/if_samples'})
        last = from_message(last, Sweep)
        numbers = itertools.count(sweeps)

        def answered() -> bool:
            """Send another one: what was sent before the other side found this one too is lost."""
            number = next(numbers)
            samples = np.roll(last.samples, number % 100 + 1)  # a buffer read twice would be dropped
            sender.publish(to_message(dataclasses.replace(last, sweep_id=number, samples=samples), IfSamples))
            time.sleep(0.1)
            return any(b.sweep_id >= sweeps for b in list(beats))

        live.wait(answered, 'the beat frequency of a sweep without partner')
        alone = ('/master/pair_station: Pairs', 'sweeps without partner')
        live.wait(lambda: live.value(*alone) != '0', 'the count of those')


# --- a graph that runs on ---


@pytest.fixture(scope='class')
def running(tmp_path_factory):
    """A crane standing at 100 m, 100 sweeps per second, without end."""
    directory = tmp_path_factory.mktemp('running')
    path = scenario_file(directory, STANDING, timing={'sweep_interval': 0.02})
    with site(directory) as live:
        live.start(path, {'rate': 2.0})
        live.wait(lambda: live.monitor.total > 20, 'the first ranges')
        yield live


def newest(live: Site) -> Any:
    return live.monitor.newest['master/slave']


@pytest.mark.usefixtures('running')
class TestRunningGraph:
    """One graph, several questions."""

    def test_right_parameter_takes_effect(self, running):
        """Of the fusion and of a station, and back again."""
        assert newest(running).refractive_index == pytest.approx(1.00028, abs=5e-5)
        assert running.set_parameter('/fusion', 'atmosphere', 'vacuum') == (True, '')
        running.wait(lambda: newest(running).refractive_index == 1.0, 'ranges in vacuum')
        assert running.set_parameter('/fusion', 'atmosphere', 'itu_r_p453') == (True, '')
        running.wait(lambda: newest(running).refractive_index != 1.0, 'ranges in air')
        assert running.set_parameter('/master/station', 'weak_threshold', 100.0) == (True, '')
        running.wait(lambda: newest(running).flags & Flag.WEAK_SIGNAL, 'ranges flagged as weak')
        assert running.set_parameter('/master/station', 'weak_threshold', 13.0) == (True, '')
        running.wait(lambda: not newest(running).flags & Flag.WEAK_SIGNAL, 'ranges not flagged')

    @pytest.mark.parametrize(
        ('node', 'name', 'value', 'reason'),
        [
            ('/fusion', 'atmosphere', 'thick', "atmosphere: 'thick' is not valid; valid: "),
            ('/fusion', 'velocity', 'trackd', "did you mean 'tracked'?"),
            ('/fusion', 'default_pressure', 5.0, 'default_pressure'),
            ('/fusion', 'default_pressure', float('nan'), 'default_pressure'),
            ('/fusion', 'maximum_range', -5.0, 'maximum_range'),
            ('/fusion', 'alpha_correction', 'no', "expected 'Type.BOOL' got 'Type.STRING'"),
            ('/master/station', 'weak_threshold', -5.0, 'weak_threshold'),
            ('/master/station', 'weak_threshold', float('nan'), 'weak_threshold'),
            ('/master/station', 'window', 'han', "did you mean 'hann'?"),
            ('/master/station', 'maximum_frequency', 1.0, 'minimum_frequency'),
            ('/master/station', 'station', 'other', 'read-only'),
            ('/simulator', 'rate', 0.0, 'rate'),
            ('/simulator', 'pace', 'quick', 'read-only'),
        ],
    )
    def test_wrong_parameter_is_refused_with_the_reason(self, running, node, name, value, reason):
        if name == 'maximum_frequency':  # wrong only together with another
            assert running.set_parameter(node, 'minimum_frequency', 1000.0) == (True, '')
        accepted, said = running.set_parameter(node, name, value)
        if name == 'maximum_frequency':
            assert running.set_parameter(node, 'minimum_frequency', 0.0) == (True, '')
        assert not accepted
        assert reason in said
        count = running.monitor.total
        running.wait(lambda: running.monitor.total > count, 'another range')

    def test_killed_station_comes_back(self, running):
        """After kill -9 there are no ranges, but the site goes on; a new process is all that it takes."""
        running.graph.members['station_slave'].process.send_signal(signal.SIGKILL)
        assert running.wait_for_end('station_slave') == -signal.SIGKILL
        running.wait(lambda: running.monitor.rate() == 0.0, 'the ranges to stop')
        before = newest(running).sweep_id
        count = running.monitor.total
        running.graph.stop('station_slave')
        running.graph.start('station_slave', STATION, '--station', 'slave')
        running.wait(lambda: running.monitor.total >= count + 100, 'ranges of the new process')
        for name in ('simulator', 'fusion', 'station_master', 'station_slave'):
            assert running.graph.members[name].process.poll() is None
        after = [a.message for a in running.monitor.arrivals[count:]]
        assert after[0].sweep_id > before + 100, 'the simulator went on meanwhile'
        ids = [m.sweep_id for m in after]
        assert ids == list(range(ids[0], ids[0] + len(ids)))
        error, std = errors_of(after[-80:], np.full(80, 100.0))
        assert len(error) == 80
        assert np.abs(error / std).max() < 6  # P(false failure) = 80 * 2e-9


def test_silent_station_holds_nobody_up(tmp_path):
    """As fast as the stations go, the simulator goes on without a dead one; restarted by its keeper, it is back."""
    path = scenario_file(tmp_path, STANDING)
    with site(tmp_path) as live:
        live.start(path, {'pace': 'subscribers', 'acknowledge_timeout': 0.5})
        live.wait(lambda: live.monitor.total > 20, 'the first ranges')
        slave = live.graph.members['station_slave']
        slave.keep_alive = True
        slave.process.send_signal(signal.SIGKILL)
        live.wait(lambda: "'slave' does not answer: going on" in live.log('simulator'), 'the simulator to go on')
        live.wait_for_end('station_slave')
        live.wait(lambda: live.graph.tend() == [] and slave.restarts == 1, 'the keeper to start it again')
        live.wait(lambda: "'slave' answers again" in live.log('simulator'), 'the answer of the new process')
        count = live.monitor.total
        live.wait(lambda: live.monitor.total > count + 100, 'ranges of the new process')


@pytest.mark.parametrize('reliabilities', [('best_effort',) * 2, ('best_effort', 'reliable')], ids=['both', 'one'])
def test_sweeps_of_a_best_effort_driver_are_evaluated_once(tmp_path, reliabilities):
    """As REP 2003 has it for sensors: stations and watch hear them, and no range comes twice."""
    path = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.02})
    names = [f'qos_overrides./{s}/if_samples.publisher.reliability' for s in ('master', 'slave')]
    with site(tmp_path) as live:
        live.graph.start('watch', WATCH, *parameters({'fewest': 24, 'window.interval': 0.0}))
        live.start(path, {'rate': 1.0} | dict(zip(names, reliabilities, strict=True)))
        live.wait(lambda: live.monitor.total >= 200, 'ranges')
        live.wait(lambda: live.value('/watch: Model master/slave', 'stations heard') == 'master, slave', 'the watch')
        ids = [a.sweep_id for a in live.monitor.arrivals]
        assert len(set(ids)) == len(ids)
        assert live.value('/master/station: Source', 'publishers of /master/if_samples') == '1'


# --- time division ---


def test_one_master_and_three_slaves(tmp_path):
    """Pairs measure in turn; each gets its own distance and its own mode. P(false failure) < 1e-6 (6 sigma)."""
    path = ROOT / 'config' / 'tdma.yaml'
    scenario = read_scenario(path)
    pairs = pair_names(scenario)
    assert pairs == ['master/slave_1', 'master/slave_2', 'master/slave_3']
    with site(tmp_path, pairs) as live:
        live.start(path, {'pace': 'subscribers'})
        far = pairs[2]

        def compared(pair):
            """Ranges whose reference arrived too: that topic is matched on its own, perhaps after the first sweeps."""
            return [a for a in list(live.monitor.arrivals) if a.pair == pair and a.stamp in live.references]

        live.wait(
            lambda: min(len(compared(p)) for p in pairs) >= 100 and live.monitor.newest[far].mode == 1,
            '100 ranges of each pair with their references, the farthest in long-distance mode',
        )
        live.graph.stop('simulator')
        arrivals = list(live.monitor.arrivals)
    for pair, distance in zip(pairs, (80.0, 300.0, 720.0), strict=True):
        everything = [a for a in arrivals if a.pair == pair]
        assert {f'{a.message.first_station}/{a.message.second_station}' for a in everything} == {pair}
        assert len(set(np.diff([a.sweep_id for a in everything]))) == 1, 'nothing lost'
        assert everything[0].message.range == pytest.approx(distance, abs=0.2)
        own = compared(pair)
        truth = np.array([live.references[a.stamp] for a in own])
        error, std = errors_of([a.message for a in own], truth)
        assert len(error) > 0.8 * len(own)
        assert np.abs(error / np.hypot(std, scenario.reference.range_std)).max() < 6
    assert {a.message.mode for a in arrivals if a.pair == 'master/slave_2'} == {0}


# --- a recording played into the graph ---


def test_published_recording_gives_the_offline_ranges(tmp_path):
    """Stations and fusion make of a played recording what the offline replay makes of it, bit by bit."""
    with site(tmp_path) as live:
        live.graph.start('fusion', FUSION, *PATIENT)  # at full speed one station may fall behind the other
        for station in ('master', 'slave'):
            live.graph.start(f'station_{station}', STATION, '--station', station)
        # fusion and a station find each other within some 3 s: a sweep that is played before has no range
        answers = {f'/{name}/station: Sweeps': f'subscribers of /{name}/beat_frequency' for name in ('master', 'slave')}
        live.wait(lambda: all(live.value(*answer) == '1' for answer in answers.items()), 'fusion at both stations')
        live.wait(lambda: live.monitor.wait_for_publishers(1.0), 'the monitor at fusion')
        live.graph.start('player', REPLAY, str(PRACTICE), '--publish', '--rate', '0')
        assert live.wait_for_end('player') == 0, live.logs()
        live.wait(lambda: live.monitor.total >= 336, 'all ranges')
        published = {('master', 'slave', a.sweep_id, a.stamp): a.message for a in live.monitor.arrivals}
    found = compare(published, replay_recording(str(PRACTICE)).results)
    assert (found.identical, found.different, found.only_recorded, found.only_recomputed) == (336, 0, 0, 0)


# --- the end of processes ---


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_every_process_cleanly(tmp_path, number):
    """Status 0, no traceback, a complete recording, all within twenty seconds.

    It may lack the last pairs: those on their way to the recorder as the signal comes.
    """
    path = scenario_file(tmp_path, STANDING)
    with site(tmp_path) as live:
        live.start(path, {}, tmp_path / 'recording')
        live.wait(lambda: live.monitor.total > 30, 'the first ranges')
        members = dict(live.graph.members)
        for member in members.values():
            member.process.send_signal(number)
        end = time.monotonic() + STOP_LIMIT
        for name, member in members.items():
            assert member.process.wait(max(0.1, end - time.monotonic())) == 0, live.log(name)
        for name in members:
            assert 'Traceback' not in live.log(name)
    assert len(replay_recording(str(tmp_path / 'recording')).results) > 20
    assert not list(tmp_path.glob('.*')), 'nothing half-written stays'


@pytest.mark.parametrize(
    ('module', 'arguments', 'said'),
    [
        (STATION, ['--station', 'master', *parameters({'weak_threshold': -5.0})], 'weak_threshold'),
        (STATION, ['--station', 'master', *parameters({'weak_threshold': float('nan')})], 'weak_threshold'),
        (STATION, ['--station', 'master', *parameters({'weak_threshold': 'high'})], 'weak_threshold'),
        (STATION, ['--station', 'master', *parameters({'window': 'han'})], "did you mean 'hann'?"),
        (STATION, ['--station', 'master', '--config', '/nowhere.yaml'], '/nowhere.yaml: No such file or directory'),
        (STATION, ['--station', 'master', *parameters({'source': 'recording', 'recording': '/nowhere'})], '/nowhere'),
        (STATION, [], 'station'),
        (STATION, ['--station', 'a crane'], "station: 'a crane' cannot be part of a topic's name"),
        (PAIR_STATION, ['--first', 'master'], 'second: give the name of the station'),
        (
            PAIR_STATION,
            ['--first', 'master', '--second', 'master'],
            "second: a pair needs two stations, both are 'master'",
        ),
        (
            PAIR_STATION,
            ['--first', 'master', '--second', 'slave', *parameters({'second_source': 'compresed'})],
            "did you mean 'compressed'?",
        ),
        (
            PAIR_STATION,
            ['--first', 'a', '--second', 'b', *parameters({'estimator': 'ml'})],
            "estimator: 'ml' is not valid",
        ),
        (FUSION, ['--pair', 'masterslave'], "'masterslave' is not 'first/second'"),
        (FUSION, parameters({'default_pressure': float('nan')}), 'default_pressure'),
        (FUSION, parameters({'maximum_range': -3.0}), 'maximum_range'),
        (
            SIMULATOR,
            parameters({'scenario': 'crne'}),
            "no such file, and none of that name in config/; did you mean 'crane'?",
        ),
        (SIMULATOR, [], "'scenario' is missing"),
        (SIMULATOR, parameters({'scenario': ROOT / 'config' / 'crane.yaml', 'pace': 'quick'}), 'pace'),
        (SIMULATOR, parameters({'scenario': ROOT / 'config' / 'crane.yaml', 'rate': float('nan')}), 'rate'),
        (
            SIMULATOR,
            ['--ros-args', '-p', f'scenario:={ROOT}/config/crane.yaml', '-p', 'overrides:=[weathr.temperature=3]'],
            "unknown key 'weathr'; did you mean 'weather'?",
        ),
        (RECORDER, [str(PRACTICE)], 'exists already, not overwriting'),
        (RECORDER, ['/tmp/none', '--duration', '0'], '--duration = 0 s must be above zero'),
    ],
)
def test_wrong_start_ends_with_one_line(module, arguments, said):
    ended = subprocess.run([sys.executable, '-m', module, *arguments], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2, ended.stderr
    assert re.fullmatch(r'[^\n]+\n', ended.stderr), ended.stderr
    assert said in ended.stderr
    assert ended.stdout == ''
    assert not os.path.exists('/tmp/none')
