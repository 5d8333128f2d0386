"""The time division changes while it runs: nobody starves, everything is counted on, requests hold."""

import math

import numpy as np
import pytest
from test_scenario import unequal

from drfmcw_physics.rules.schedule import Demand, Share
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode
from drfmcw_sim.requests import Requests
from drfmcw_sim.timeline import Timeline


def changed(timeline, demands, block=8):
    """Ask for another schedule; return the turns until it begins, and what is published then."""
    timeline.change_schedule(demands)
    turns, before = [], timeline.schedule
    while (published := timeline.due_schedule_change()) == [] and timeline.schedule is before:
        slots = timeline.slots(block)
        timeline.advance(len(slots))
        turns += slots.pair.tolist()
    return turns, published


def test_schedule_changes_while_it_runs():
    """Each pair keeps its place on its way, sweeps are numbered on, and what is published states the rate granted."""
    timeline = Timeline(unequal(rate=25.0, priority=1))
    shares = [e.content for e in timeline.opening() if e.topic.endswith('/sweep_schedule')]
    opening = {(share.station, share.peer): share for share in shares}
    assert opening['master', 'slave_1'].rate == 25.0 and opening['slave_1', 'master'].priority == 1
    assert opening['slave_3', 'master'].rate == 12.5 and opening['slave_3', 'master'].priority == 0
    before = timeline.slots(11)
    timeline.advance(11)
    demands = [Demand(5.0), Demand(25.0, 3), Demand()]
    turns, published = changed(timeline, demands)
    assert turns == []  # everybody has had a slot
    after = timeline.slots(500)
    assert after.sweep_id.tolist() == list(range(11, 511)) and after.time[0] - before.time[-1] == pytest.approx(0.02)
    assert np.bincount(after.pair).tolist() == [50, 250, 200]
    assert {e.topic.rpartition('/')[2] for e in published} == {'sweep_schedule'}  # settings stay as they are
    granted = {(e.content.station, e.content.peer): (e.content.rate, e.content.priority) for e in published}
    assert granted['slave_2', 'master'] == granted['master', 'slave_2'] == (25.0, 3)
    assert granted['master', 'slave_1'] == (5.0, 0) and granted['master', 'slave_3'] == (20.0, 0)
    stamps = {timeline.stamp(time) for time in after.time}
    assert all(timeline.stamp(before.time[-1]) < e.stamp < min(stamps) for e in published)
    for pair in range(3):  # as if it had always been so, for whoever counts sweeps of a pair
        own = np.concatenate([before.pair, after.pair]) == pair
        assert timeline.schedule.before(pair, 511) == own.sum()
    _, published = changed(timeline, [Demand(5.0), Demand(25.0, 3), Demand(20.0)])
    assert published == []  # the same rates, and nobody to say it to
    rendered = [e.content for e in timeline.render(after[:8]) if e.topic == '/master/if_samples']
    assert [s.peer for s in rendered] == [timeline.scenario.pairs[p].second for p in after.pair[:8]]


def test_schedule_waits_until_everybody_had_a_slot():
    """Each request comes before the pair of one slot in a thousand had its turn: it has it all the same."""
    scenario = unequal(rate=49.9)
    timeline = Timeline(scenario)
    turns, _ = changed(timeline, [Demand(49.8), Demand(), Demand()])
    assert turns == []  # nothing is over yet
    for rate in (49.7, 49.8, 49.9):
        timeline.advance(len(timeline.slots(1)))
        turns, _ = changed(timeline, [Demand(rate), Demand(), Demand()])
        assert {1, 2} <= set(turns)
    with pytest.raises(ConfigurationError, match='1 demands for 3 pairs'):
        timeline.change_schedule([Demand()])


def test_standing_pair_takes_all_its_sweeps_although_its_share_changes():
    timeline = Timeline(unequal(rate=25.0))
    own = 0
    for demands in ([Demand(25.0)] + [Demand()] * 2, [Demand()] * 3, [Demand(), Demand(40.0), Demand()]) * 20:
        slots = timeline.slots(97)
        own += int(np.count_nonzero(slots.pair == 1))
        timeline.advance(len(slots))
        if len(slots):
            own += changed(timeline, demands)[0].count(1)
        for _ in range(3):
            timeline.due_mode_changes()
    assert timeline.sweep_count >= timeline.next_sweep_id
    while len(slots := timeline.slots(500)):
        own += int(np.count_nonzero(slots.pair == 1))
        timeline.advance(len(slots))
        for _ in range(3):
            timeline.due_mode_changes()
    assert timeline.finished and own >= 1000


@pytest.fixture
def requests():
    return Requests(unequal(rate=25.0, priority=1), modes=True)


def asked(peer, **turns):
    return Share('master', peer, **turns)


def test_rates_hold_until_others_are_asked_for(requests):
    own = requests.demands()
    assert own[0] == Demand(25.0, 1)
    requests.take_turns(asked('slave_2', rate=10.0, priority=2))
    assert requests.demands()[1] == Demand(10.0, 2) and requests.demands()[0] == own[0]
    requests.take_turns(asked('slave_2', rate=12.0))
    assert requests.demands()[1] == Demand(12.0)
    requests.take_turns(asked('slave_2', priority=5))  # without a rate: the scenario's own
    assert requests.demands() == own
    assert requests.modes(Timeline(unequal())) == {}


@pytest.mark.parametrize('start_delay', [0.0, math.nan])
def test_modes_are_asked_for_until_they_hold(requests, start_delay):
    """A T_off of 0 or NaN is the scenario's own; rates stay as they are, and modes are kept by requests of rates."""
    timeline = Timeline(unequal())
    late, own = timeline.scenario.mode.start_delay(Mode.LONG_DISTANCE), requests.demands()
    requests.take_mode('master', 'slave_1', Mode.LONG_DISTANCE, start_delay)
    assert requests.demands() == own
    requests.take_turns(asked('slave_1', rate=11.0))
    assert requests.modes(timeline) == {0: (Mode.LONG_DISTANCE, late)}
    timeline.change_mode(0, Mode.LONG_DISTANCE)
    assert requests.modes(timeline) == {} and requests.demands()[0] == Demand(11.0)
    by_range = Requests(timeline.scenario, modes=False)
    by_range.take_mode('master', 'slave_1', Mode.SHORT_DISTANCE, 0.0)
    assert by_range.modes(timeline) == {}


@pytest.mark.parametrize(
    ('peer', 'mode', 'start_delay', 'reason'),
    [
        ('nobody', 0, 0.0, "no pair of 'master' and 'nobody'"),
        ('slave_1', 7, 0.0, 'mode = 7'),
        ('slave_1', 0, 0.5, 'not shorter than the ramp'),
    ],
)
def test_requests_of_modes_that_cannot_be_are_refused(requests, peer, mode, start_delay, reason):
    with pytest.raises(ConfigurationError, match=reason):
        requests.take_mode('master', peer, mode, start_delay)


def test_requests_of_rates_of_other_pairs_are_refused(requests):
    with pytest.raises(ConfigurationError, match="no pair of 'master' and 'nobody'"):
        requests.take_turns(asked('nobody', rate=5.0))
