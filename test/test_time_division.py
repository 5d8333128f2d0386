"""Several slaves, unequal: a recording shows who took turns how, and a silent slave costs the others nothing."""

import numpy as np
import pytest
import yaml
from checkout import CONFIG
from test_graph import site

from drfmcw_bringup.run import pair_names
from drfmcw_ros.bag.info import describe, main
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


def test_info_shows_who_took_turns_how(unequal, tmp_path, capsys):
    mapping = yaml.safe_load(unequal.read_text())
    mapping['pairs'][1]['standing']['sweeps'] = 20
    for pair in (0, 2):
        mapping['pairs'][pair]['drive']['waypoints'] = [90, 91]
    unequal.write_text(yaml.safe_dump(mapping))
    recording = tmp_path / 'recording'
    write_recording(read_scenario(unequal), recording)
    first, second, third = describe(str(recording))['schedule']
    assert [t['pair'] for t in (first, second, third)] == ['master/slave_1', 'master/slave_2', 'master/slave_3']
    assert first['rate'] == pytest.approx(0.5 / INTERVAL, rel=0.01)
    assert second['rate'] == pytest.approx(0.25 / INTERVAL, rel=0.01)
    assert first['sweeps'] == pytest.approx(2 * second['sweeps'], abs=2)
    assert all(t['answers'] == t['sweeps'] for t in (first, second, third))
    assert main([str(recording)]) == 0
    assert 'longest wait' in capsys.readouterr().out


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
