"""What fusion asks of the stations: rates whether there are ranges or not, modes as the distance needs them."""

import dataclasses

import pytest

from drfmcw_fusion.fusion import PairSettings
from drfmcw_fusion.requesting import ModeRequests, TurnRequests
from drfmcw_physics.rules.mode import ModeSettings
from drfmcw_physics.rules.schedule import NO_TURNS
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


class Asked:
    """The requests of both kinds, and what was sent."""

    def __init__(self):
        self.known, self.sent = {}, []
        self.modes = ModeRequests(lambda station, peer, stamp: self.known.get((station, peer)), self.sent.append)
        self.turns = TurnRequests(self.sent.append)
        for station, peer in (PAIR, PAIR[::-1]):
            role = Role.FIRST if station == PAIR[0] else Role.SECOND
            self.known[station, peer] = SweepSettings(station, peer, role=role, stamp=5)

    def since(self):
        """What was sent since the last call."""
        found = list(self.sent)
        self.sent.clear()
        return found

    def rates(self):
        """Station, peer, rate, priority of what was sent since the last call."""
        return [(s.station, s.peer, s.rate, s.priority) for s in self.since()]


@pytest.fixture
def asked():
    return Asked()


def test_rates_are_asked_for_once_of_both_stations(asked):
    """Without settings or ranges: a pair that does not answer yet gets its slots all the same."""
    asked.known.clear()
    for _ in range(3):
        asked.turns.ask({PAIR: (25.0, 2)}, 7)
    assert {s.stamp for s in asked.sent} == {7}
    assert asked.rates() == [('master', 'slave', 25.0, 2), ('slave', 'master', 25.0, 2)]


def test_rates_that_change_are_asked_for_again_and_none_is_a_wish_too(asked):
    asked.turns.ask({PAIR: NO_TURNS}, 7)
    assert asked.rates() == []  # whoever never asked leaves the hardware alone
    for turns in ((25.0, 0), (25.0, 1), (5.0, 1), NO_TURNS):
        asked.turns.ask({PAIR: turns}, 7)
        assert asked.rates() == [('master', 'slave', *turns), ('slave', 'master', *turns)]


def test_a_station_that_hears_itself_is_asked_once(asked):
    asked.turns.ask({('radar', 'radar'): (10.0, 0)}, 7)
    assert asked.rates() == [('radar', 'radar', 10.0, 0)]
    asked.known['radar', 'radar'] = SweepSettings('radar', 'radar')
    alone = Ranged(FAR, first_station='radar', second_station='radar')
    assert asked.modes.ask(alone, MODE, 0.0) is None and asked.since() == []


def test_a_request_of_a_mode_has_the_form_of_settings(asked):
    assert asked.modes.ask(Ranged(FAR), MODE, 0.0) == Mode.LONG_DISTANCE
    late = MODE.start_delay(Mode.LONG_DISTANCE)
    expected = [
        dataclasses.replace(asked.known[names], mode=Mode.LONG_DISTANCE, start_delay=late, stamp=10)
        for names in (PAIR, PAIR[::-1])
    ]
    assert asked.since() == expected
    del asked.known[PAIR[::-1]]
    assert asked.modes.ask(Ranged(FAR), MODE, 5.0) == Mode.LONG_DISTANCE
    assert asked.since() == expected[:1]  # whose settings are unknown


def test_modes_are_asked_for_again_where_nothing_happens(asked):
    assert asked.modes.ask(Ranged(NEAR), MODE, 0.0) is None
    assert asked.modes.ask(Ranged(FAR), MODE, 1.0) == Mode.LONG_DISTANCE
    assert asked.modes.ask(Ranged(FAR), MODE, 2.0) is None
    assert asked.modes.ask(Ranged(FAR), MODE, 4.0) == Mode.LONG_DISTANCE
    assert asked.modes.ask(Ranged(FAR, Mode.LONG_DISTANCE), MODE, 5.0) is None
    assert len(asked.since()) == 4


def test_rates_belong_to_the_pairs_in_their_order():
    settings = PairSettings(['a/b', 'a/c', 'a/d'], rates=[0.0, 12.5], priorities=[7, 2, 9])
    assert settings.turns == {('a', 'b'): NO_TURNS, ('a', 'c'): (12.5, 2), ('a', 'd'): NO_TURNS}
    for wrong in ({'rates': [1.0, 2.0]}, {'priorities': [1, 2]}):
        with pytest.raises(ConfigurationError, match=f'{next(iter(wrong))}: 2 values for 1 pair'):
            PairSettings(['a/b'], **wrong)
