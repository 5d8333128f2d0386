"""Scenarios: what is wrong is named, trajectories keep their limits, the time line counts right."""

import dataclasses

import numpy as np
import pytest
import yaml
from checkout import CONFIG
from hypothesis import given, settings
from hypothesis import strategies as st

from drfmcw_physics.rules.mode import choose_mode
from drfmcw_physics.settings import ConfigurationError, declared_parameters
from drfmcw_physics.sweep import Mode
from drfmcw_sim.effects import Effect
from drfmcw_sim.recording import events
from drfmcw_sim.scenario import PairSettings, read_scenario, scenario_from_mapping
from drfmcw_sim.synthesis.signal_model import synthesise
from drfmcw_sim.timeline import IfSweep, Timeline
from drfmcw_sim.trajectory import Drive, Profile, Standing

SCENARIOS = sorted(set(CONFIG.glob('*.yaml')) - {CONFIG / 'requirements.yaml'})


def minimal(**changes):
    """Return the mapping of a small scenario."""
    mapping = {
        'stations': {'a': {'alpha': 1.000006}, 'b': {'delay': '15e-9'}},
        'pairs': [{'first': 'a', 'second': 'b', 'standing': {'distances': [100.0, 700.0], 'sweeps': 3}}],
    }
    mapping.update(changes)
    return mapping


def simulated(mapping):
    """Return the scenario of a mapping."""
    return scenario_from_mapping(mapping, 'test.yaml')


def test_scenarios_of_the_repository():
    """Those that the issue asks for are there, valid, and say what the paper says."""
    names = {'gantry', 'cable', 'crane', 'tdma'}
    found = {path.stem: read_scenario(path) for path in SCENARIOS if path.stem in names}
    assert set(found) == names
    gantry = found['gantry']
    first, second = gantry.sweep_settings(gantry.pairs[0], Mode.SHORT_DISTANCE, 3.41e-6)
    assert (first.bandwidth, first.start_frequency, first.ramp_duration) == (150e6, 5725e6, 1e-3)
    assert (first.sample_rate, first.tx_eirp, first.rx_antenna_gain, second.role) == (2.048e6, 13.0, 21.0, 2)
    assert Timeline(gantry).sweep_count == 20 * 500
    cable = Timeline(found['cable'])
    m = cable.measurements(cable.slots(1), 0)
    assert [s.received_power[0] for s in m.stations] == [-40.0, -40.0]
    assert m.start_delay[0] == 4e-6
    assert len(found['tdma'].pairs) == 3
    assert {p.first for p in found['tdma'].pairs} == {'master'}


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'statoins': {}}, ["'statoins'", "'stations'"]),
        ({'stations': {'a': {'aplha': 1.0}, 'b': {}}}, ['stations: a', "'aplha'", "'alpha'"]),
        ({'stations': {'a': {'alpha': float('nan')}, 'b': {}}}, ['alpha', 'NaN']),
        ({'stations': {'a': {'alpha': 2.0}, 'b': {}}}, ['alpha', '0.999']),
        ({'stations': {}}, ["'stations'"]),
        ({'pairs': [{'first': 'a', 'second': 'c', 'standing': {'distances': [1]}}]}, ["unknown station 'c'"]),
        ({'pairs': [{'first': 'a', 'second': 'b'}]}, ["'standing'", "'drive'"]),
        ({'pairs': [{'first': 'a', 'second': 'b', 'drive': {'waypoint': [1, 2]}}]}, ["'waypoint'", "'waypoints'"]),
        ({'pairs': [{'first': 'a', 'second': 'b', 'drive': {'waypoints': [1]}}]}, ['drive', 'waypoints']),
        ({'weather': {'temperatur': 20}}, ["'temperatur'", "'temperature'"]),
        ({'weather': {'pressure': 1013.25}}, ['pressure', 'outside']),
        ({'weather': {'temperature': {'times': [1, 0], 'values': [1, 2]}}}, ['temperature', 'rise']),
        ({'timing': {'sweep_interval': 1e-4}}, ['sweep_interval', 'shorter than a sweep']),
        ({'effects': [{'effect': 'ecko', 'excess_range': 1}]}, ["'ecko'", "'echo'"]),
        ({'effects': [{'effect': 'echo', 'excess_range': 1}]}, ['relative_power', 'missing']),
        ({'effects': [{'effect': 'spur', 'station': 'c', 'frequency': 1e5, 'level': -50}]}, ["station 'c'"]),
        ({'effects': [{'effect': 'delay_offset', 'station': 'a', 'delay': 1}]}, ['no station']),
        ({'waveform': {'bandwidth': 0}}, ['bandwidth']),
        ({'seed': -1}, ['seed']),
    ],
)
def test_what_is_wrong_is_named_in_one_line(changes, words):
    """The message names the file, the wrong key or value, and the nearest valid key."""
    with pytest.raises(ConfigurationError) as caught:
        simulated(minimal(**changes))
    message = str(caught.value)
    assert '\n' not in message
    assert message.startswith('test.yaml')
    for word in words:
        assert word in message


def test_overrides_reach_every_level():
    """section.key=value, with list items by number; a wrong path is refused."""
    path = CONFIG / 'crane.yaml'
    changed = read_scenario(
        path, ('timing.sweep_interval=0.5', 'pairs.0.drive.speed=1.5', 'stations.slave.delay=1e-9'), 9
    )
    assert changed.timing.sweep_interval == 0.5
    assert changed.pairs[0].trajectory.speed == 1.5
    assert changed.stations['slave'].delay == 1e-9
    assert changed.seed == 9
    for wrong in ('timing', 'pairs.7.first=a', 'seed.x=1', 'timing.sweep_intervall=1'):
        with pytest.raises(ConfigurationError):
            read_scenario(path, (wrong,))


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    waypoints=st.lists(st.floats(1.0, 2000.0), min_size=2, max_size=5),
    speed=st.floats(0.1, 5.0),
    acceleration=st.floats(0.05, 2.0),
)
def test_drive_keeps_its_limits_and_reaches_its_waypoints(waypoints, speed, acceleration):
    """Distance is continuous, its slope is the velocity, speed and acceleration stay within limits."""
    drive = Drive(waypoints, speed, acceleration, dwell=1.0)
    time = np.linspace(0.0, drive.duration, 4001)
    distance, velocity, accelerated = drive.state(np.arange(len(time)), time)
    assert np.max(np.abs(velocity)) <= speed * (1 + 1e-9)
    assert np.max(np.abs(accelerated)) <= acceleration
    step = time[1] - time[0]
    assert (
        np.max(np.abs(np.diff(distance) - step * (velocity[1:] + velocity[:-1]) / 2)) <= acceleration * step**2 + 1e-9
    )
    assert np.max(np.abs(np.diff(velocity))) <= acceleration * step + 1e-9
    assert distance[0] == waypoints[0]
    assert distance[-1] == pytest.approx(waypoints[-1])
    for waypoint in waypoints:
        assert np.min(np.abs(distance - waypoint)) <= speed * step


def test_standing_visits_each_distance_for_its_sweeps():
    """Distances one after another; the last one is kept."""
    standing = Standing([10.0, 20.0], sweeps=3, move_time=5.0)
    index = np.arange(8)
    assert standing.state(index, index * 1.0)[0].tolist() == [10.0] * 3 + [20.0] * 5
    assert standing.moves(index).tolist() == [0.0] * 3 + [5.0] * 5


def test_profile_interpolates():
    """Between its times linear, outside constant."""
    profile = Profile([1.0, 3.0], [10.0, 20.0])
    assert profile.at(np.array([0.0, 10.0, 15.0, 99.0])).tolist() == [1.0, 1.0, 2.0, 3.0]


def test_time_division_gives_every_pair_its_turn():
    """Pairs follow each other, numbers count through, both stations of a measurement have the same number."""
    timeline = Timeline(read_scenario(CONFIG / 'tdma.yaml'))
    slots = timeline.slots(9)
    assert slots.pair.tolist() == [0, 1, 2] * 3
    assert np.allclose(np.diff(slots.time), 0.02)
    by_number = {}
    for event in timeline.render(slots):
        if isinstance(event.content, IfSweep):
            by_number.setdefault(event.content.sweep_id, []).append((event.content.station, event.content.peer))
    assert by_number[4] == [('master', 'slave_2'), ('slave_2', 'master')]
    assert all(len(stations) == 2 for stations in by_number.values())


def unequal(**first):
    """The scenario of one master and three slaves with a demand of its first pair."""
    mapping = yaml.safe_load((CONFIG / 'tdma.yaml').read_text())
    mapping['pairs'][0] |= first
    return scenario_from_mapping(mapping, 'unequal')


def test_pair_with_a_rate_has_more_slots_and_every_sweep_its_number():
    """25 of 50 slots a second for the first pair; the others share the rest. Numbers of sweeps count through."""
    scenario = unequal(rate=25.0, priority=1)
    timeline = Timeline(scenario)
    slots = timeline.slots(1000)
    assert np.bincount(slots.pair).tolist() == [500, 250, 250]
    assert slots.sweep_id.tolist() == list(range(1000))
    assert np.allclose(np.diff(slots.time), 0.02)
    for pair in range(3):
        assert scenario.schedule.before(pair, 1000) == np.count_nonzero(slots.pair == pair)
    heard = [e.content.peer for e in timeline.render(slots[:8]) if e.topic == '/master/if_samples']
    assert heard == [scenario.pairs[p].second for p in slots.pair[:8]]


def test_standing_pair_takes_all_its_sweeps_whatever_its_share():
    """1000 sweeps at 300 m for the second pair, with half as many slots as the first."""
    scenario = unequal(rate=25.0)
    timeline = Timeline(scenario)
    times, own = -1.0, 0
    while len(slots := timeline.slots(500)):
        assert (np.diff(slots.time) > 0).all() and slots.time[0] > times
        times = float(slots.time[-1])
        own += int(np.count_nonzero(slots.pair == 1))
        timeline.advance(len(slots))
        for _ in range(3):
            timeline.due_mode_changes()
    assert timeline.finished and own >= 1000


def test_impossible_demands_are_known():
    plan = unequal(rate=70.0).schedule
    assert plan.falls_short(0) and not plan.falls_short(1)
    with pytest.raises(ConfigurationError, match='rate'):
        unequal(rate=-1.0)


def test_mode_changes_with_distance_and_takes_its_time():
    """Beyond the limit both stations get new settings before the first sweep that uses them, after a pause."""
    scenario = simulated(minimal(timing={'mode_change_duration': 0.2, 'sweep_interval': 0.02}))
    stamps, modes = [], {}
    for event in events(Timeline(scenario)):
        if event.topic.endswith('sweep_config'):
            modes[event.content.station] = (event.content.mode, event.content.start_delay, event.stamp)
        elif event.topic == '/a/if_samples':
            mode, start_delay, stamp = modes['a']
            assert stamp < event.stamp
            assert mode == choose_mode(None, 100.0 if event.sweep_id < 3 else 700.0, scenario.mode)
            assert start_delay == scenario.mode.start_delay(mode)
            stamps.append(event.stamp)
    assert modes['a'][:2] == modes['b'][:2] == (Mode.LONG_DISTANCE, 0.6e-6)
    assert len(stamps) == 6
    gaps = np.diff(stamps) / 1e9
    assert gaps[2] == pytest.approx(0.02 + 10.0 + 0.2)  # interval, move, change of mode
    assert np.allclose(np.delete(gaps, 2), 0.02)


def test_rendering_does_not_depend_on_the_block():
    """The same events whatever number of sweeps is rendered at once."""

    def rendered(block):
        rows = []
        for event in events(Timeline(simulated(minimal())), block):
            values = dataclasses.asdict(event.content)
            samples = values.pop('samples', np.zeros(0))
            rows.append((event.topic, event.stamp, values, samples.tobytes()))
        return rows

    assert repr(rendered(1)) == repr(rendered(5)) == repr(rendered(64))


def test_discarded_block_is_rendered_again():
    """Rendering does not move on: what a mode request cuts off comes again, with the same samples."""
    timeline = Timeline(simulated(minimal()), mode_by_range=False)
    before = [e.content.samples for e in timeline.render(timeline.slots(3)) if e.topic == '/a/if_samples']
    timeline.advance(1)
    again = [e.content.samples for e in timeline.render(timeline.slots(2)) if e.topic == '/a/if_samples']
    assert np.array_equal(before[1], again[0])
    assert np.array_equal(before[2], again[1])


def measured(**changes):
    """Return the conditions of the first sweep after all effects have acted."""
    scenario = simulated(minimal(**changes))
    timeline = Timeline(scenario)
    m = timeline.measurements(timeline.slots(1), 0)
    for effect in scenario.effects:
        effect.prepare(m)
    return m


def test_effects_act_as_their_names_say():
    """Each hook changes what the registry of effects says, by that much, at that station."""
    warm = {'a': {'alpha': 1.000006, 'board_temperature': 35.0}, 'b': {}}
    nominal = measured(stations=warm)
    cases = {
        'reference_clock_offset': ({'station': 'a', 'deviation': 12.0}, lambda m: m.stations[0].alpha[0], 12e-6),
        'reference_clock_temperature': ({'station': 'a', 'slope': -0.35}, lambda m: m.stations[0].alpha[0], -3.5e-6),
        'sample_clock_offset': ({'station': 'a', 'deviation': 7.0}, lambda m: m.stations[0].sample_clock[0], 7e-6),
        'delay_offset': ({'delay': 2.5}, lambda m: m.paths[0].delay[0], 2.5e-9),
        'delay_temperature': ({'station': 'a', 'slope': 6.0}, lambda m: m.paths[0].delay[0], 60e-12),
        'noise_floor': ({'station': 'b', 'excess': 3.0}, lambda m: m.stations[1].noise_density[0], 3.0),
        'amplitude_loss': ({'loss': 1.0, 'specific': 20.0}, lambda m: m.stations[1].received_power[0], -3.0),
    }
    for name, (parameters, value, change) in cases.items():
        m = measured(stations=warm, effects=[{'effect': name, **parameters}])
        assert value(m) - value(nominal) == pytest.approx(change, rel=1e-4), name
    clocks = measured(effects=[{'effect': 'reference_clock_offset', 'station': 'a', 'deviation': 12.0}], stations=warm)
    assert clocks.stations[0].sample_clock[0] - nominal.stations[0].sample_clock[0] == pytest.approx(12e-6, rel=1e-4)
    echo = measured(effects=[{'effect': 'echo', 'excess_range': 7.5, 'relative_power': -24}])
    excess = 7.5 * echo.refractive_index[0] / 299792458.0
    assert echo.paths[1].delay[0] - echo.paths[0].delay[0] == pytest.approx(excess)
    assert echo.paths[1].amplitude[0] == pytest.approx(10 ** (-24 / 20))


def samples(effects):
    """Return station a's noise-free analogue IF of the first sweep."""
    scenario = simulated(minimal(effects=effects))
    timeline = Timeline(scenario)
    return synthesise(timeline.measurements(timeline.slots(1), 0), 1, scenario.effects, noise=False, quantised=False)[
        0
    ][0]


def test_effects_on_samples():
    """Leakage adds a constant, a spur a line of its level and frequency, an echo a line of its power at its delay."""
    clean = samples([])
    leakage = samples([{'effect': 'tx_leakage', 'station': 'a', 'level': -30.0}]) - clean
    assert np.allclose(leakage[:2040], 8192 * 10**-1.5, rtol=1e-5)
    spur = samples([{'effect': 'spur', 'station': 'a', 'frequency': 300e3, 'level': -40.0}]) - clean
    tone = np.exp(-2j * np.pi * 300e3 / 2.048e6 / 1.000006 * np.arange(2048))
    assert 2 * abs(np.mean(spur * tone)) == pytest.approx(81.92, rel=1e-3)
    echo = samples([{'effect': 'echo', 'excess_range': 300.0, 'relative_power': -20.0}]) - clean
    assert np.std(echo) / np.std(clean) == pytest.approx(0.1, rel=0.01)
    other = samples([{'effect': 'spur', 'station': 'b', 'frequency': 300e3, 'level': -40.0}])
    assert np.array_equal(other, clean)


def test_every_effect_declares_its_parameters():
    """Each has unit, description and bounds; names are unique and those of the registry."""
    for name, cls in Effect.registry.items():
        assert cls.name == name
        assert cls.of in ('station', 'path', 'reference')
        assert cls.__doc__
        assert declared_parameters(cls)


def test_pair_needs_a_trajectory():
    """None would end in an error about an attribute, far from its cause."""
    with pytest.raises(TypeError, match='trajectory'):
        PairSettings('master', 'slave')
