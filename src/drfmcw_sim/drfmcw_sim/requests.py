"""What the simulated hardware is asked for on sweep_request: modes until they hold, rates until others are asked."""

import math
import threading

from drfmcw_physics.schedule import Demand
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode, SweepRequest

from .scenario import Scenario
from .timeline import Timeline


class Requests:
    """The newest request of each pair; taken in one thread, looked up in another."""

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

    def take(self, request: SweepRequest) -> None:
        """Take in what a pair is asked for.

        Raises:
            ConfigurationError: there is no such pair, or its sweeps are shorter than T_off.
        """
        names = {request.station, request.peer}
        pair = next((i for i, p in enumerate(self._scenario.pairs) if {p.first, p.second} == names), None)
        if pair is None:
            raise ConfigurationError(f"no pair of '{request.station}' and '{request.peer}'")
        if request.asks_mode and request.start_delay >= self._scenario.waveform.ramp_duration:
            raise ConfigurationError(f'start_delay = {request.start_delay:g} s is not shorter than the ramp')
        mode, rated = Mode(request.mode), request.rate > 0.0
        with self._lock:
            if request.asks_mode and self._takes_modes and not self._scenario.pairs[pair].hears_itself:
                self._modes[pair] = (mode, request.start_delay or self._scenario.mode.start_delay(mode))
            self._demands[pair] = Demand(*request.turns) if rated else self._scenario.schedule.demands[pair]

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
