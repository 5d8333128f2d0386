"""Sweeps that overtook the settings they need."""

import math
from collections.abc import Sequence

from .processor import StationProcessor
from .records import Sweep

_EARLY_LIMIT = 3.0  # that sweeps wait for settings and calibrations they overtook [s]
_EARLY_COUNT = 4000  # and how many of them
_EARLY_BYTES = 1 << 28  # of samples, at most


class EarlySweeps:
    """Sweeps that came before the settings and calibrations they need.

    Topics have no order among each other: after a start, sweeps may overtake latched settings.
    """

    def __init__(self, processor: StationProcessor) -> None:
        """Start without any; `processor` knows which settings have arrived."""
        self._processor = processor
        self._waiting: list[Sweep] = []
        self._since = math.inf

    def release(self, sweeps: Sequence[Sweep], now: float) -> list[Sweep]:
        """Return the sweeps to process now; those that waited too long are among them, to be dropped and counted.

        Args:
            sweeps: that have just come.
            now: on any clock that runs on [s].
        """
        ready: list[Sweep] = []
        waiting: list[Sweep] = []
        for sweep in [*self._waiting, *sweeps]:
            (ready if self._processor.has_settings(sweep) else waiting).append(sweep)
        self._since = min(self._since, now) if waiting else math.inf
        crowded = len(waiting) > _EARLY_COUNT or sum(2 * len(sweep.samples) for sweep in waiting) > _EARLY_BYTES
        if crowded or now - self._since > _EARLY_LIMIT:
            ready, waiting = sorted([*waiting, *ready], key=lambda s: s.sweep_id), []
            self._since = math.inf
        self._waiting = waiting
        return ready
