"""What fusion asks of the stations: rates as soon as it knows whom to ask, modes as the distance needs them."""

import dataclasses
import math

import pytest

from drfmcw_fusion.fusion import PairSettings
from drfmcw_fusion.requesting import NO_TURNS, Requests
from drfmcw_physics.mode import ModeSettings
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode, Role, SweepSettings

PAIR = ('master', 'slave')
MODE = ModeSettings()
FAR, NEAR = 900.0, 50.0


@dataclasses.dataclass
class Ranged:
    """What a request looks at of a range."""

    range: float
    mode: Mode = Mode.SHORT_DISTANCE
    first_station: str = PAIR[0]
    second_station: str = PAIR[1]
    stamp: int = 10


class Stations:
    """Settings that are known, and what is asked for."""

    def __init__(self):
        self.known, self.sent = {}, []
        self.requests = Requests(lambda *names: self.known.get(names), self.sent.append)

    def announce(self, station, peer, mode=Mode.SHORT_DISTANCE):
        role = Role.FIRST if station <= peer else Role.SECOND
        self.known[station, peer] = SweepSettings(station, peer, role=role, mode=mode, stamp=5)

    def asked(self):
        """What was asked for since the last call: station, peer, mode, T_off, rate, priority."""
        found = [(s.station, s.peer, s.mode, s.start_delay, s.rate, s.priority) for s in self.sent]
        self.sent.clear()
        return found


@pytest.fixture
def stations():
    return Stations()


@pytest.fixture
def known(stations):
    for names in (PAIR, PAIR[::-1]):
        stations.announce(*names)
    return stations


def rates(found):
    """Station, rate and priority of requests that ask for no mode."""
    assert all(math.isnan(start_delay) for _, _, _, start_delay, _, _ in found)
    return [(station, rate, priority) for station, _, _, _, rate, priority in found]


def test_rates_are_asked_for_once_a_station_is_known(stations):
    """Without any range: a pair that does not answer yet gets its slots all the same."""
    turns = {PAIR: (25.0, 2)}
    stations.requests.ask_turns(turns)
    assert stations.asked() == []
    stations.announce(*PAIR)
    stations.requests.ask_turns(turns)
    assert rates(stations.asked()) == [('master', 25.0, 2)]
    stations.announce(*PAIR[::-1])
    for _ in range(3):
        stations.requests.ask_turns(turns)
    assert rates(stations.asked()) == [('slave', 25.0, 2)]


def test_rates_that_change_are_asked_for_again_and_none_is_a_wish_too(known):
    both = ('master', 'slave')
    known.requests.ask_turns({PAIR: NO_TURNS})
    assert known.asked() == []  # whoever never asked leaves the hardware alone
    for turns in ((25.0, 0), (25.0, 1), (5.0, 1), NO_TURNS):
        known.requests.ask_turns({PAIR: turns})
        assert rates(known.asked()) == [(name, *turns) for name in both]


def test_a_station_that_hears_itself_is_asked_once(stations):
    stations.announce('radar', 'radar')
    stations.requests.ask_turns({('radar', 'radar'): (10.0, 0)})
    assert rates(stations.asked()) == [('radar', 10.0, 0)]
    alone = Ranged(FAR, first_station='radar', second_station='radar')
    assert stations.requests.ask_mode(alone, MODE, (10.0, 0), 0.0) is None and stations.asked() == []


def test_requests_of_modes_keep_the_rates_and_the_other_way_round(known):
    """Each replaces the one before on a latched topic: what it left out would be forgotten."""
    known.requests.ask_turns({PAIR: (25.0, 2)})
    known.asked()
    assert known.requests.ask_mode(Ranged(FAR), MODE, (25.0, 2), 0.0) == Mode.LONG_DISTANCE
    late = MODE.start_delay(Mode.LONG_DISTANCE)
    assert [r[2:] for r in known.asked()] == [(Mode.LONG_DISTANCE, late, 25.0, 2)] * 2
    known.requests.ask_turns({PAIR: (12.5, 2)})  # before the stations have changed
    assert [r[2:] for r in known.asked()] == [(Mode.LONG_DISTANCE, late, 12.5, 2)] * 2
    for names in (PAIR, PAIR[::-1]):
        known.announce(*names, mode=Mode.LONG_DISTANCE)
    assert known.requests.ask_mode(Ranged(FAR, Mode.LONG_DISTANCE), MODE, (12.5, 2), 1.0) is None
    known.requests.ask_turns({PAIR: (25.0, 2)})
    assert rates(known.asked()) == [('master', 25.0, 2), ('slave', 25.0, 2)]


def test_modes_are_asked_for_again_where_nothing_happens(known):
    assert known.requests.ask_mode(Ranged(NEAR), MODE, NO_TURNS, 0.0) is None
    assert known.requests.ask_mode(Ranged(FAR), MODE, NO_TURNS, 1.0) == Mode.LONG_DISTANCE
    assert known.requests.ask_mode(Ranged(FAR), MODE, NO_TURNS, 2.0) is None
    assert known.requests.ask_mode(Ranged(FAR), MODE, NO_TURNS, 4.0) == Mode.LONG_DISTANCE
    assert len(known.asked()) == 4


def test_rates_belong_to_the_pairs_in_their_order():
    settings = PairSettings(['a/b', 'a/c', 'a/d'], rates=[0.0, 12.5], priorities=[7, 2, 9])
    assert settings.turns == {('a', 'b'): NO_TURNS, ('a', 'c'): (12.5, 2), ('a', 'd'): NO_TURNS}
    for wrong in ({'rates': [1.0, 2.0]}, {'priorities': [1, 2]}):
        with pytest.raises(ConfigurationError, match=f'{next(iter(wrong))}: 2 values for 1 pair'):
            PairSettings(['a/b'], **wrong)
