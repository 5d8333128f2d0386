"""Several slaves, unequal: a recording shows who took turns how, and a silent slave costs the others nothing."""

import numpy as np
import pytest
import yaml
from checkout import CONFIG
from test_graph import site

from drfmcw_bringup.run import pair_names
from drfmcw_fusion.offline import replay_recording
from drfmcw_fusion.replayed.verification import compare, recorded_ranges
from drfmcw_ros.bag.files import BagReader
from drfmcw_ros.bag.info import describe, main
from drfmcw_ros.bag.writing import BagWriter
from drfmcw_sim.recording import write_recording
from drfmcw_sim.scenario import read_scenario

INTERVAL = 0.05  # of a slot [s]


@pytest.fixture
def unequal(tmp_path):
    """A scenario in which the first of three slaves asks for half of the slots."""
    mapping = yaml.safe_load((CONFIG / 'tdma.yaml').read_text())
    mapping['pairs'][0] |= {'rate': 0.5 / INTERVAL, 'priority': 1}
    mapping['pairs'][1]['standing']['sweeps'] = 1_000_000
    mapping['timing'] = {'sweep_interval': INTERVAL}
    path = tmp_path / 'unequal.yaml'
    path.write_text(yaml.safe_dump(mapping))
    return path


@pytest.fixture
def recording(unequal, tmp_path):
    """A short recording of that scenario."""
    mapping = yaml.safe_load(unequal.read_text())
    mapping['pairs'][1]['standing']['sweeps'] = 20
    for pair in (0, 2):
        mapping['pairs'][pair]['drive']['waypoints'] = [90, 91]
    unequal.write_text(yaml.safe_dump(mapping))
    write_recording(read_scenario(unequal), tmp_path / 'recording')
    return tmp_path / 'recording'


def test_info_shows_who_took_turns_how(recording, capsys):
    first, second, third = describe(str(recording))['schedule']
    assert [(t['asked'], t['granted'], t['priority'], t['since']) for t in (first, second, third)] == [
        (None, 10.0, 1, None),
        (None, 5.0, 0, None),
        (None, 5.0, 0, None),
    ]
    assert [t['pair'] for t in (first, second, third)] == ['master/slave_1', 'master/slave_2', 'master/slave_3']
    assert first['rate'] == pytest.approx(0.5 / INTERVAL, rel=0.01)
    assert second['rate'] == pytest.approx(0.25 / INTERVAL, rel=0.01)
    assert first['sweeps'] == pytest.approx(2 * second['sweeps'], abs=2)
    assert all(t['answers'] == t['sweeps'] for t in (first, second, third))
    assert main([str(recording)]) == 0
    said = capsys.readouterr().out
    assert 'granted' in said and 'longest' in said and 'note: turns since' not in said


def test_info_of_a_recording_from_before_rates_were_stated(recording, tmp_path):
    """It lacks the topic: what arrived is counted all the same, and nothing is made up."""
    old = tmp_path / 'old'
    with BagReader(str(recording)) as bag, BagWriter(str(old)) as writer:
        for topic, time, kind, raw in bag.raw_messages():
            if not topic.endswith('/sweep_schedule'):
                writer.write(topic, kind, time, raw)
    for entry, known in zip(describe(str(old))['schedule'], describe(str(recording))['schedule'], strict=True):
        assert entry == {**known, 'granted': None, 'priority': None}
    assert main([str(old)]) == 0


@pytest.mark.graph
def test_silent_slave_costs_its_own_slots_only(unequal, tmp_path):
    """One slave's station dies: the others keep every slot they had, and diagnostics say who is missing."""
    scenario = read_scenario(unequal)
    pairs = pair_names(scenario)
    with site(tmp_path, pairs) as live:
        live.start(unequal, {})

        def numbers(pair, since=0):
            return [a.sweep_id for a in list(live.monitor.arrivals) if a.pair == pair and a.sweep_id >= since]

        live.wait(lambda: min(len(numbers(p)) for p in pairs) >= 10, '10 ranges of each pair')
        live.graph.stop('station_slave_2')
        silent = max(a.sweep_id for a in list(live.monitor.arrivals))
        live.wait(lambda: len(numbers(pairs[2], silent)) >= 30, '30 further ranges of the third pair')
        assert len(numbers(pairs[1], silent)) <= 3  # what was under way
        for pair, slots in ((0, 2), (2, 4)):
            own = np.diff(numbers(pairs[pair], silent))
            assert np.median(own) == slots  # sweep numbers count slots
            assert (own == slots).mean() > 0.8  # a change of mode may take a sweep
        live.wait(
            lambda: any(
                'no range' in s.message for (_, n), s in live.diagnostics.items() if n.endswith(f'Range {pairs[1]}')
            ),
            'the missing pair',
        )
        live.wait(lambda: live.value('/simulator: Scenario', f'schedule of {pairs[0]}').startswith('10 Hz'), 'the plan')


@pytest.mark.graph
def test_rates_change_while_everything_runs(unequal, tmp_path):
    """Asked of fusion, granted by the hardware, kept by the sweeps; a pair that never had a range is no exception."""
    scenario = read_scenario(unequal)
    pairs = pair_names(scenario)
    recording, patient = tmp_path / 'recording', tmp_path / 'patient.yaml'
    # a busy machine makes no sweep late
    patient.write_text(yaml.safe_dump({'/fusion': {'ros__parameters': {'pair_time_limit': 60.0}}}))
    with site(tmp_path, pairs) as live:
        live.start(unequal, {}, record=recording, file=patient)

        def numbers(pair, since=0):
            return [a.sweep_id for a in list(live.monitor.arrivals) if a.pair == pair and a.sweep_id >= since]

        def shown(pair):
            name = f'/fusion: Range {pair}'
            return tuple(live.value(name, f'ranges per second{what}') for what in (' asked for', ' granted'))

        live.wait(lambda: min(len(numbers(p)) for p in pairs) >= 10, '10 ranges of each pair')
        live.wait(lambda: [shown(p) for p in pairs] == [('none', r) for r in ('10', '5', '5')], "the scenario's rates")
        live.graph.stop('station_slave_2')
        assert live.set_parameter('/fusion', 'switch_mode', False)[0]
        assert live.set_parameter('/fusion', 'priorities', [0, 0, 1])[0]
        assert live.set_parameter('/fusion', 'rates', [2.0, 6.0, 12.0])[0]
        wanted = [(rate, rate) for rate in ('2', '6', '12')]
        live.wait(lambda: [shown(p) for p in pairs] == wanted, 'the rates asked for')
        changed = max(a.sweep_id for a in list(live.monitor.arrivals)) + 1
        live.wait(lambda: len(numbers(pairs[2], changed)) >= 60, '60 further ranges of the third pair')
        assert len(numbers(pairs[1], changed)) == 0
        for pair, share in ((0, 0.1), (2, 0.6)):
            own = numbers(pairs[pair], changed)
            assert (len(own) - 1) / (own[-1] - own[0]) == pytest.approx(share, rel=0.1)  # sweep numbers count slots
        live.wait(
            lambda: live.value('/simulator: Scenario', f'schedule of {pairs[1]}').startswith('6 Hz'),
            'the share of the pair that does not answer',
        )
        for name, wrong in (('rates', [1.0] * 4), ('rates', [-1.0]), ('priorities', [5000])):
            accepted, reason = live.set_parameter('/fusion', name, wrong)
            assert not accepted and reason.startswith(name)
        live.graph.stop('recorder')
        first, second, third = describe(str(recording))['schedule']
        assert [(t['asked'], t['granted'], t['priority']) for t in (first, second, third)] == [
            (2.0, 2.0, 0),
            (6.0, 6.0, 0),
            (12.0, 12.0, 1),
        ]
        assert third['rate'] == pytest.approx(12.0, rel=0.1) and first['since'] == third['since']
        assert second['sweeps'] > 0  # the hardware of the pair goes on
        with BagReader(str(recording)) as bag:
            found = compare(recorded_ranges(bag), replay_recording(str(recording)).results)
        assert (found.different, found.only_recorded) == (0, 0) and found.identical > 80
        assert live.set_parameter('/fusion', 'rates', [0.0])[0]
        live.wait(lambda: [shown(p) for p in pairs] == [('none', r) for r in ('10', '5', '5')], "the scenario's rates")
