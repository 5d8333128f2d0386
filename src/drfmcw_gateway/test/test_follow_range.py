"""What the example controller decides: it drives with a valid range only, and stops without one in time."""

import dataclasses
import math

import pytest

from drfmcw_gateway.follow_range import FollowerSettings, Speed, decide
from drfmcw_gateway.reading import Estimate, PairState

GOOD = Estimate(1, 0, 100.0, 1e-3, 0.5, 0.01, 0, 10**18)


def decision(silence=0.0, age=0.0, **changes):
    estimate = dataclasses.replace(GOOD, **changes)
    settings = FollowerSettings()
    state = PairState(settings.timeout, settings.age_limit)
    state.take(estimate, 0.0)
    return decide(state.reading(silence, estimate.stamp + round(age * 1e9), margin=settings.period), settings)


@pytest.mark.parametrize(
    ('changes', 'speed'),
    [
        ({}, Speed.DRIVE),
        ({'flags': 128}, Speed.CREEP),
        ({'flags': 64, 'velocity': math.nan}, Speed.CREEP),
        ({'velocity': math.nan}, Speed.CREEP),
        ({'protection_level': 0.2}, Speed.CREEP),
        ({'protection_level': math.inf}, Speed.CREEP),
        ({'flags': 1}, Speed.STOP),
        ({'flags': 160}, Speed.STOP),
        ({'range': math.nan}, Speed.STOP),
        ({'age': 2.0}, Speed.STOP),
        ({'age': -2.0}, Speed.STOP),
    ],
)
def test_crane_moves_as_far_as_the_range_is_good(changes, speed):
    assert decision(**changes).speed == speed


def test_crane_stops_within_the_time_out_and_not_long_before():
    settings = FollowerSettings()
    assert decision(silence=settings.timeout - settings.period).speed == Speed.STOP
    assert decision(silence=0.5 * settings.timeout).speed == Speed.DRIVE


def test_crane_does_not_move_before_the_first_range():
    assert decide(PairState(0.2, 1.0).reading(0.0, 0), FollowerSettings()).speed == Speed.STOP
