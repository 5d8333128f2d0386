"""What fusion asks of the stations: the mode that the distance needs, and each pair's share of the time division."""

import dataclasses
from collections.abc import Callable, Mapping

from drfmcw_physics.rules.mode import ModeSettings, choose_mode
from drfmcw_physics.rules.schedule import NO_TURNS, Share, Turns
from drfmcw_physics.sweep import Mode, SweepSettings

from .pipeline import RangeResult

_REQUEST_INTERVAL = 2.0  # after which a mode that the stations have not taken up is requested again [s]

Pair = tuple[str, str]


class ModeRequests:
    """Decides which mode is asked of which pair, and when."""

    def __init__(
        self, settings_of: Callable[[str, str, int], SweepSettings | None], publish: Callable[[SweepSettings], None]
    ) -> None:
        """Begin with nothing asked.

        Args:
            settings_of: returns the settings of a station for a peer at a stamp [ns], None where none are known.
            publish: sends a request, which has the form of settings.
        """
        self._settings_of, self._publish = settings_of, publish
        self._asked: dict[Pair, tuple[Mode, float]] = {}  # and not in use yet; when [s]

    def ask(self, result: RangeResult, settings: ModeSettings, now: float) -> Mode | None:
        """Ask both stations of a pair, once per change, for the mode that its distance needs.

        Args:
            result: a range of the pair.
            settings: at which distances the mode changes.
            now: on any clock that runs on [s].

        Returns:
            The mode, None where nothing was asked.
        """
        pair = (result.first_station, result.second_station)
        if pair[0] == pair[1]:
            return None
        # the requested mode counts as the mode in use until the stations have changed: one request, not one per sweep,
        # and another where they have not changed for a while
        current, asked = self._asked.get(pair, (Mode(result.mode), now))
        wanted = choose_mode(current, result.range, settings)
        if wanted == current and (wanted == result.mode or now - asked < _REQUEST_INTERVAL):
            if wanted == result.mode:
                self._asked.pop(pair, None)
            return None
        self._asked[pair] = (wanted, now)
        for station, peer in (pair, pair[::-1]):
            sweep = self._settings_of(station, peer, result.stamp)
            if sweep is not None:
                delay = settings.start_delay(wanted)
                self._publish(dataclasses.replace(sweep, mode=int(wanted), start_delay=delay, stamp=result.stamp))
        return wanted


class TurnRequests:
    """Asks for the rate and priority of each pair, once per change, whether it has ranges or not."""

    def __init__(self, publish: Callable[[Share], None]) -> None:
        """Begin with nothing asked; `publish` sends a request."""
        self._publish = publish
        self._asked: dict[Pair, Turns] = {}

    def ask(self, turns: Mapping[Pair, Turns], stamp: int) -> None:
        """Ask both stations of each pair for what changes from the last call on; at first, nothing is asked.

        Args:
            turns: of each pair; `NO_TURNS`: the hardware's own.
            stamp: of the requests [ns].
        """
        for pair, wanted in turns.items():
            if self._asked.get(pair, NO_TURNS) == wanted:
                continue
            self._asked[pair] = wanted
            for station, peer in dict.fromkeys((pair, pair[::-1])):
                self._publish(Share(station, peer, *wanted, stamp))
