"""What all servers read: the states of all pairs, of the controller and of the gateway itself, at one instant."""

import time
from collections.abc import Callable, Sequence

from .quantities import GatewayReading, controller_state
from .reading import Controller, PairState, Reading
from .settings import GatewaySettings


class Board:
    """Written by the range topics and by the controller's heartbeat, read by the servers."""

    def __init__(
        self,
        settings: GatewaySettings,
        clock: Callable[[], int] = time.time_ns,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start without a range.

        Args:
            settings: pairs and times.
            clock: of the stamps [ns].
            now: of the arrivals; runs on [s].
        """
        self.settings = settings
        self.clock, self.now = clock, now
        self.pairs = {pair: PairState(settings.timeout, settings.age_limit) for pair in settings.pairs}
        self.controller = Controller(settings.controller_timeout)
        self._start = now()

    def change(self, settings: GatewaySettings) -> None:
        """Take times that were changed while running."""
        self.settings = settings
        for state in self.pairs.values():
            state.timeout, state.age_limit = settings.timeout, settings.age_limit
        self.controller.timeout = settings.controller_timeout

    def readings(self, pairs: Sequence[str] | None = None, margin: float = 0.0) -> dict[str, Reading]:
        """Return {pair: reading} of the pairs named (all); `margin` as in `PairState.reading`."""
        now, clock = self.now(), self.clock()
        silent = self.controller.silent(now)
        names = self.pairs if pairs is None else pairs
        return {pair: self.pairs[pair].reading(now, clock, margin, silent) for pair in names}

    def gateway(self) -> GatewayReading:
        """Return the gateway's own numbers."""
        now = self.now()
        return GatewayReading(
            len(self.pairs), now - self._start, controller_state(self.controller, now), self.controller.value
        )

    def write_heartbeat(self, value: int) -> None:
        """Take the number that the controller wrote."""
        self.controller.write(value, self.now())
