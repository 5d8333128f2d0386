"""What the simulated hardware is asked for: modes until they hold, rates until others are asked for."""

import math
import threading

from drfmcw_physics.rules.schedule import Demand, Share
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode

from .scenario import Scenario
from .timeline import Timeline


class Requests:
    """The newest requests of each pair; taken in one thread, looked up in another."""

    def __init__(self, scenario: Scenario, modes: bool) -> None:
        """Begin with the scenario's own rates.

        Args:
            scenario: whose pairs are asked.
            modes: False where nobody but the scenario changes the mode.
        """
        self._scenario, self._takes_modes = scenario, modes
        self._lock = threading.Lock()
        self._modes: dict[int, tuple[Mode, float]] = {}  # and T_off [s], by pair
        self._demands = list(scenario.schedule.demands)

    def take_mode(self, station: str, peer: str, mode: int, start_delay: float) -> None:
        """Take in the mode and T_off [s] that a pair is asked for; T_off 0 or NaN: the scenario's.

        Raises:
            ConfigurationError: there is no such pair or mode, or its sweeps are shorter than T_off.
        """
        pair = self._pair(station, peer)
        if not self._takes_modes:
            return
        if mode not in tuple(Mode):
            raise ConfigurationError(f'mode = {mode} is none')
        own = not start_delay > 0.0
        if not own and start_delay >= self._scenario.waveform.ramp_duration:
            raise ConfigurationError(f'start_delay = {start_delay:g} s is not shorter than the ramp')
        with self._lock:
            self._modes[pair] = (Mode(mode), self._scenario.mode.start_delay(Mode(mode)) if own else start_delay)

    def take_turns(self, asked: Share) -> None:
        """Take in the rate and priority that a pair asks for; without a rate the scenario's hold.

        Raises:
            ConfigurationError: there is no such pair.
        """
        pair = self._pair(asked.station, asked.peer)
        with self._lock:
            self._demands[pair] = Demand(*asked.turns) if asked.rate > 0.0 else self._scenario.schedule.demands[pair]

    def _pair(self, station: str, peer: str) -> int:
        names = {station, peer}
        for number, pair in enumerate(self._scenario.pairs):
            if {pair.first, pair.second} == names:
                return number
        raise ConfigurationError(f"no pair of '{station}' and '{peer}'")

    def demands(self) -> list[Demand]:
        """Return what each pair asks of the time division: by request, else as the scenario has it."""
        with self._lock:
            return list(self._demands)

    def modes(self, timeline: Timeline) -> dict[int, tuple[Mode, float]]:
        """Return, by pair, mode and T_off [s] that are asked for and not in use; forget those that are."""
        with self._lock:
            for pair, (mode, delay) in list(self._modes.items()):
                now = timeline.sweep_settings(pair)[0]
                if now.mode == mode and math.isclose(now.start_delay, delay):
                    del self._modes[pair]
            return dict(self._modes)
