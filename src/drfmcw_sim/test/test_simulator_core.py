"""What the simulator does around the signal: recordings it writes, and flow control of the live node."""

import numpy as np
import pytest
from checkout import CONFIG, DATA

pytest.importorskip('rclpy')
bag = pytest.importorskip('drfmcw_ros.bag.files')
from drfmcw_physics.air import refractive_index  # noqa: E402
from drfmcw_physics.settings import ConfigurationError  # noqa: E402
from drfmcw_physics.sweep import Mode  # noqa: E402
from drfmcw_sim import simulate  # noqa: E402
from drfmcw_sim.flow_control import Acknowledgements  # noqa: E402
from drfmcw_sim.recording import write_recording  # noqa: E402
from drfmcw_sim.scenario import read_scenario, scenario_from_mapping  # noqa: E402
from drfmcw_sim.timeline import IfSweep, Timeline  # noqa: E402

SMALL = ('pairs.0.standing.sweeps=4', 'pairs.0.standing.distances=[100, 700]')


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_recording_holds_the_measured_topics(tmp_path, storage):
    """Topics, types and QoS are those of a recording made by another hand, but for rates; settings come first."""
    path = tmp_path / 'run'
    scenario = read_scenario(CONFIG / 'gantry.yaml', SMALL)
    progress = []
    assert write_recording(scenario, path, storage, progress.append) == 8
    assert progress[-1] == 8
    settings, sweeps = {}, {'master': [], 'slave': []}
    with bag.BagReader(path) as reader:
        topics = reader.topics
        qos = {c.topic: (c.ext.offered_qos_profiles[0].durability, c.ext.offered_qos_profiles[0].reliability)
               for c in reader.connections}  # fmt: skip
        for topic, time, message in reader.messages():
            station = topic.split('/')[1]
            if topic.endswith('sweep_config'):
                settings[station] = message
            elif topic.endswith('if_samples'):
                assert settings[station].mode == (0 if message.sweep_id < 4 else 1)
                assert len(message.samples) == settings[station].sample_count
                assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time
                sweeps[station].append(message.sweep_id)
    assert sweeps['master'] == sweeps['slave'] == list(range(8))
    with bag.BagReader(DATA / 'recording_0') as practice:
        schedules = {f'/{station}/sweep_schedule': 'drfmcw_msgs/msg/SweepSchedule' for station in sweeps}
        assert practice.topics | schedules == topics
        for connection in practice.connections:
            offered = connection.ext.offered_qos_profiles[0]
            assert qos[connection.topic] == (offered.durability, offered.reliability)


@pytest.mark.parametrize('interval', [0.05, 0.15, 0.3, 0.7])
@pytest.mark.parametrize('start_delay', [0.6e-6, 3e-4])
def test_readings_precede_the_sweeps_that_they_hold_for(interval, start_delay):
    """No reading with the stamp of a sweep, or an earlier one, follows it: a live fusion would have to guess it."""
    overrides = (f'timing.sweep_interval={interval}', 'timing.status_interval=0.1', 'weather.interval=0.3')
    scenario = read_scenario(
        CONFIG / 'gantry.yaml', (*overrides, 'pairs.0.standing.sweeps=300', 'pairs.0.standing.distances=[100]')
    )
    timeline = Timeline(scenario)
    timeline.change_mode(0, Mode.SHORT_DISTANCE, start_delay)
    newest, readings, sweeps = -1, [], 0
    while not timeline.finished:
        slots = timeline.slots(64)
        for event in timeline.render(slots):
            if isinstance(event.content, IfSweep):
                newest = max(newest, event.stamp)
                sweeps += 1
            elif event.topic != '/reference/range':
                assert event.stamp > newest, event.topic
                readings.append((event.topic, event.stamp))
        timeline.advance(len(slots))
    assert sweeps == 600
    assert len(readings) == len(set(readings)) > 2 * 299 * interval / 0.1, 'each once, none left out'


def test_same_seed_gives_the_same_recording(tmp_path):
    """Samples and readings are functions of the scenario alone."""
    rows = []
    for name, seed in (('a', 5), ('b', 5), ('c', 6)):
        scenario = read_scenario(CONFIG / 'gantry.yaml', SMALL, seed)
        write_recording(scenario, tmp_path / name)
        with bag.BagReader(tmp_path / name) as reader:
            rows.append([(topic, time, raw) for topic, time, _, raw in reader.raw_messages()])
    assert rows[0] == rows[1]
    assert rows[0] != rows[2]


def test_station_that_hears_itself(tmp_path):
    """One station as its own peer: one set of samples per measurement, its line at k tau."""
    scenario = scenario_from_mapping(
        {
            'stations': {'radar': {'delay': 10e-9}},
            'pairs': [
                {'first': 'radar', 'second': 'radar', 'path_loss': 60, 'standing': {'distances': [600.0], 'sweeps': 2}}
            ],
        },
        'test',
    )
    write_recording(scenario, tmp_path / 'loop')
    with bag.BagReader(tmp_path / 'loop') as reader:
        messages = [m for topic, _, m in reader.messages() if topic == '/radar/if_samples']
    assert [m.sweep_id for m in messages] == [0, 1]
    assert {m.peer for m in messages} == {'radar'}
    spectrum = np.abs(np.fft.rfft(messages[0].samples * np.hanning(2048)))
    expected = 150e9 * (10e-9 + 600.0 * 1.0003 / 299792458.0)
    assert np.argmax(spectrum[5:]) + 5 == pytest.approx(expected / 1e3, abs=1.0)


def test_command_line(tmp_path, capsys):
    """A recording by command; wrong input is one line and status 2, and leaves nothing behind."""
    gantry = str(CONFIG / 'gantry.yaml')
    options = [part for o in SMALL for part in ('--set', o)]
    assert simulate.main([gantry, '--out', str(tmp_path / 'run'), *options]) == 0
    assert (tmp_path / 'run' / 'metadata.yaml').exists()
    capsys.readouterr()
    for arguments, word in (
        ([gantry, '--out', str(tmp_path / 'run'), *options], 'exists'),
        ([str(tmp_path / 'no.yaml'), '--out', str(tmp_path / 'x')], 'no.yaml'),
        ([gantry, '--out', str(tmp_path / 'x'), '--set', 'timing.sweep_intervall=1'], 'sweep_interval'),
    ):
        assert simulate.main(arguments) == 2
        lines = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
        assert len(lines) == 1
        assert word in lines[0]
    assert sorted(p.name for p in tmp_path.iterdir()) == ['run']


def test_conditions_are_those_of_the_physics():
    """Delay of a moving crane in the air of its time, free-space link budget, clocks and starts of both stations."""
    scenario = scenario_from_mapping(
        {
            'stations': {
                'a': {'alpha': 1.00001, 'delay': 12e-9, 'noise_floor': -140.7, 'tx_eirp': 13, 'rx_antenna_gain': 21},
                'b': {'alpha': 0.99998, 'sample_clock_alpha': 1.00003, 'delay': 15e-9, 'noise_floor': -150.0,
                      'tx_eirp': 10, 'rx_antenna_gain': 18},
            },
            'pairs': [{'first': 'a', 'second': 'b', 'drive': {'waypoints': [100, 900], 'speed': 2.0}}],
            'weather': {'temperature': {'times': [0, 400], 'values': [-10, 30]}, 'pressure': 98000, 'humidity': 0.5},
            'timing': {'sweep_interval': 1.0, 'start_delay_jitter': 1e-9},
        },
        'test',
    )  # fmt: skip
    timeline = Timeline(scenario)
    m = timeline.measurements(timeline.slots(200), 0)
    temperature = -10.0 + m.time / 10.0
    index = refractive_index(temperature, 98000.0, 0.5)
    assert np.ptp(index) > 1e-6  # the air changes: 1 mm per km and 1e-6
    assert m.paths[0].delay == pytest.approx(27e-9 + index * m.range / 299792458.0, abs=1e-16)
    assert m.paths[0].rate == pytest.approx(index * m.velocity / 299792458.0, abs=1e-18)
    loss = 20.0 * np.log10(4.0 * np.pi * m.range * 5.8e9 / 299792458.0)
    first, second = m.stations
    assert first.received_power == pytest.approx(10.0 + 21.0 - loss, abs=1e-9)
    assert second.received_power == pytest.approx(13.0 + 18.0 - loss, abs=1e-9)
    assert (first.noise_density[0], second.noise_density[0]) == (-140.7, -150.0)
    assert (first.alpha[0], second.alpha[0]) == (1.00001, 0.99998)
    assert second.sample_clock[0] == 1.00003
    assert m.start_delay[0] == scenario.mode.start_delay_short
    assert m.start_delay_jitter == 1e-9


def test_unknown_storage_is_refused(tmp_path):
    """One line that names it."""
    with pytest.raises(ConfigurationError, match='mcpa'):
        write_recording(read_scenario(CONFIG / 'gantry.yaml', SMALL), tmp_path / 'x', 'mcpa')


def test_window_of_unanswered_sweeps():
    """A station gets no more than the window; an answer covers earlier sweeps; a silent one is not waited for."""
    under_way = Acknowledgements(['a', 'b'])
    under_way.sent('a', 0)
    assert not under_way.room('a', 5)  # never heard of: one sweep, then only now and then another
    assert not under_way.answered('a', 0)
    for sweep_id in range(1, 6):
        under_way.sent('a', sweep_id)
    assert not under_way.room('a', 5)
    assert under_way.room('b', 5)
    assert not under_way.answered('a', 4)
    assert under_way.outstanding() == 1
    assert under_way.room('a', 5)
    for sweep_id in range(6, 10):
        under_way.sent('a', sweep_id)
    assert not under_way.give_up('a', 60.0)
    assert under_way.give_up('a', 0.0)
    assert under_way.silent == {'a'}
    assert under_way.room('a', 5)
    assert under_way.answered('a', 9)
    assert not under_way.silent


def test_who_is_not_there_is_not_waited_for():
    """A graph without fusion goes on; one that gets fusion later waits for it from its first range on."""
    under_way = Acknowledgements(['a/b'])
    under_way.expect_nothing('a/b')
    for sweep_id in range(30):
        under_way.sent('a/b', sweep_id)
    assert under_way.full(5) == []
    assert not under_way.give_up('a/b', 0.0)
    assert not under_way.answered('a/b', 29)
    for sweep_id in (30, 30, 31, 31, 32, 32):  # both stations' sweeps of a measurement
        under_way.sent('a/b', sweep_id)
    assert under_way.outstanding() == 3
    assert under_way.full(3) == ['a/b']
    assert under_way.full(4) == []
