"""Time division: rates are granted, in order of priority, evenly, and nobody starves."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drfmcw_physics.rules.schedule import Demand, schedule

SLOT = 0.02
ONE_DEMAND = st.builds(Demand, rate=st.one_of(st.just(math.nan), st.floats(0.1, 60.0)), priority=st.integers(-2, 2))
DEMANDS = st.lists(ONE_DEMAND, min_size=1, max_size=8)


def test_pairs_without_rates_take_turns():
    assert schedule([Demand()] * 4, SLOT).frame == (0, 1, 2, 3)


@settings(deadline=None, max_examples=50)  # frames have up to 1000 slots
@given(DEMANDS)
def test_everybody_has_a_slot_and_slots_are_counted_right(demands):
    made = schedule(demands, SLOT)
    assert set(made.frame) == set(range(len(demands)))
    numbers = np.arange(2 * len(made.frame) + 3)
    pairs, index = made.pair(numbers), made.index(numbers)
    for pair in range(len(demands)):
        own = pairs == pair
        assert index[own].tolist() == list(range(own.sum()))
        assert made.before(pair, numbers).tolist() == [int((pairs[:n] == pair).sum()) for n in numbers]
        gaps = np.diff(np.flatnonzero(own)) * SLOT
        assert (gaps <= made.longest_wait(pair) + 1e-9).all()
        assert made.longest_wait(pair) < 2.0 * made.interval(pair) + SLOT
    assert sum(made.rate(pair) for pair in range(len(demands))) == pytest.approx(1.0 / SLOT)


@settings(deadline=None, max_examples=100)
@given(DEMANDS)
def test_rates_that_fit_are_granted_and_others_by_priority(demands):
    """Nobody falls short while a pair of lower priority has more than its one slot in a thousand."""
    made = schedule(demands, SLOT)
    asked = sum(d.rate for d in demands if not math.isnan(d.rate))
    if asked < 0.98 / SLOT and len(demands) < 10:
        assert not any(made.falls_short(pair) for pair in range(len(demands)))
    for pair, demand in enumerate(demands):
        if made.falls_short(pair):
            for other, lower in enumerate(demands):
                if math.isnan(lower.rate) or lower.priority < demand.priority:
                    assert made.rate(other) <= 1.01 / SLOT / 1000 + 1e-9


def test_slots_of_a_pair_are_spread_evenly():
    made = schedule([Demand(25.0), Demand(12.5), Demand(12.5)], SLOT)
    assert made.frame == (0, 1, 0, 2)
    assert made.longest_wait(0) == pytest.approx(2 * SLOT)


def test_low_priority_gives_way():
    made = schedule([Demand(40.0, 0), Demand(40.0, 5)], SLOT)
    assert made.rate(1) == pytest.approx(40.0, rel=2e-3) and not made.falls_short(1)
    assert made.rate(0) == pytest.approx(10.0, rel=1e-2) and made.falls_short(0)


@settings(deadline=None, max_examples=50)
@given(st.data())
def test_a_schedule_that_follows_counts_on(data):
    """However often and however early the demands change: no sweep is counted twice, and nobody starves."""
    count = data.draw(st.integers(1, 5))
    demands = st.lists(ONE_DEMAND, min_size=count, max_size=count)
    made, number = schedule(data.draw(demands), SLOT), 0
    turns = np.zeros(0, int)
    for _ in range(data.draw(st.integers(1, 4))):
        end = made.change(number + data.draw(st.integers(0, 50)))
        slots = np.arange(number, end)
        turns = np.concatenate([turns, made.pair(slots)])
        for pair in range(count):
            own = turns == pair
            assert made.before(pair, slots).tolist() == [int(own[:n].sum()) for n in slots]
            assert made.index(slots[turns[number:] == pair]).tolist() == list(range(own[:number].sum(), own.sum()))
            assert end == number or (made.pair(slots) == pair).any()
            sweeps = int(made.before(pair, end)) + 7
            reached = made.slots_until(pair, sweeps)
            assert made.before(pair, reached) >= sweeps > made.before(pair, reached - len(made.frame))
            assert made.in_whole_frames(pair, reached) == made.before(pair, reached)
        made, number = made.followed_by(data.draw(demands), end), end
    assert made.start == number and sum(made.done) == number


def test_a_schedule_gives_way_once_everybody_had_a_slot():
    made = schedule([Demand(25.0), Demand(12.5), Demand(12.5)], SLOT)  # turns 0 1 0 2
    assert made.change(0) == 0 and made.change(1) == 4 and made.change(17) == 17
    after = made.followed_by([Demand(12.5), Demand(25.0), Demand(12.5)], 17)
    assert after.done == (9, 4, 4) and after.change(18) == 21
