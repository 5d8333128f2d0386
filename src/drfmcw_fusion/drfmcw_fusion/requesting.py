"""What fusion asks of the stations: the mode that the distance needs, and each pair's share of the time division.

One latched topic carries both, and the newest request replaces the one before: each says everything that is asked now.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping

from drfmcw_physics.mode import ModeSettings, choose_mode
from drfmcw_physics.sweep import Mode, SweepSettings

from .pipeline import RangeResult

_REQUEST_INTERVAL = 2.0  # after which a mode that the stations have not taken up is requested again [s]

Pair = tuple[str, str]
Turns = tuple[float, int]
"""Rate [Hz] and priority; `NO_TURNS` where none is asked for."""

NO_TURNS: Turns = (0.0, 0)


class Requests:
    """Decides what is asked of which station, and when."""

    def __init__(
        self, settings_of: Callable[[str, str], SweepSettings | None], publish: Callable[[SweepSettings], None]
    ) -> None:
        """Begin with nothing asked.

        Args:
            settings_of: returns the newest settings of a station for a peer, None before there are any.
            publish: sends a request, which has the form of settings.
        """
        self._settings_of, self._publish = settings_of, publish
        self._modes: dict[Pair, tuple[Mode, float, float]] = {}  # asked and not in use: mode, T_off and when [s]
        self._turns: dict[Pair, Turns] = {}  # as sent, by station and peer

    def ask_turns(self, turns: Mapping[Pair, Turns]) -> None:
        """Ask both stations of each pair for rate and priority, once, as soon as their settings are known."""
        for pair, wanted in turns.items():
            for station, peer in dict.fromkeys((pair, pair[::-1])):
                if self._turns.get((station, peer), NO_TURNS) == wanted:
                    continue
                settings = self._settings_of(station, peer)
                if settings is None:
                    continue
                mode, start_delay, _ = self._modes.get(pair, (settings.mode, math.nan, 0.0))
                self._send(settings, mode, start_delay, wanted, settings.stamp)

    def ask_mode(self, result: RangeResult, settings: ModeSettings, turns: Turns, now: float) -> Mode | None:
        """Ask both stations of a pair, once per change, for the mode that its distance needs.

        Args:
            result: a range of the pair.
            settings: at which distances the mode changes.
            turns: of the pair.
            now: on any clock that runs on [s].

        Returns:
            The mode, None where nothing was asked.
        """
        pair = (result.first_station, result.second_station)
        if pair[0] == pair[1]:
            return None
        # the requested mode counts as the mode in use until the stations have changed: one request, not one per sweep,
        # and another where they have not changed for a while
        current, _, asked = self._modes.get(pair, (Mode(result.mode), 0.0, now))
        wanted = choose_mode(current, result.range, settings)
        if wanted == current and (wanted == result.mode or now - asked < _REQUEST_INTERVAL):
            if wanted == result.mode:
                self._modes.pop(pair, None)
            return None
        start_delay = settings.start_delay(wanted)
        self._modes[pair] = (wanted, start_delay, now)
        for station, peer in (pair, pair[::-1]):
            sweep = self._settings_of(station, peer)
            if sweep is not None:
                self._send(sweep, wanted, start_delay, turns, result.stamp)
        return wanted

    def _send(self, settings: SweepSettings, mode: int, start_delay: float, turns: Turns, stamp: int) -> None:
        rate, priority = turns
        self._turns[settings.station, settings.peer] = turns
        self._publish(
            dataclasses.replace(
                settings, mode=int(mode), start_delay=start_delay, rate=rate, priority=priority, stamp=stamp
            )
        )
