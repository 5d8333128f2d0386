"""What every source of sweeps shares: a thread, a registered name, and ROS parameters of its own.

A source either delivers frames (the digitiser sends no settings: the node's parameters `sweep.*` and `calibration.*`
hold), or it delivers sweeps together with the settings and calibrations that hold for them.
"""

import dataclasses
import threading
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from .feed import Request, TurnsRequest

POLL = 0.2
"""Interval at which a source's thread checks whether it shall end [s]."""

BATCH = 64
"""Largest number of sweeps delivered at once."""


@dataclasses.dataclass(frozen=True)
class NoSettings:
    """Settings of a source that has none."""


class Source:
    """A thread that delivers; a subclass gives its name, ``class TcpSource(Source, name='tcp')``, and fills in `_run`.

    `_run` calls `_deliver` with lists of `Frame`, or of `Sweep`, `SweepSettings` and `Calibration`, in order, and
    returns soon after `_ended` is set.
    """

    registry: ClassVar[dict[str, type['Source']]] = {}
    name: ClassVar[str] = ''
    settings: ClassVar[type] = NoSettings
    """Frozen dataclass of declared parameters; each becomes a ROS parameter of the station node."""

    brings_settings: ClassVar[bool] = False
    """True where the settings of the sweeps come with them."""

    def __init_subclass__(cls, name: str, **kwargs: Any) -> None:
        """Register the source under its name."""
        super().__init_subclass__(**kwargs)
        cls.name = name
        Source.registry[name] = cls

    def __init__(
        self,
        station: str,
        settings: Any,
        deliver: Callable[[Sequence[Any]], None],
        failed: Callable[[Exception], None],
    ) -> None:
        """Set up without starting.

        Args:
            station: whose sweeps are delivered.
            settings: instance of the class `settings`.
            deliver: called in the source's thread with each list of what came.
            failed: called once, with the exception that ended the thread.

        Raises:
            ConfigurationError: the settings cannot be used.
        """
        self._deliver, self._failed = deliver, failed
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._guarded, name=type(self).__name__, daemon=True)
        self.connected = False
        """True while data can come."""

    def start(self) -> None:
        """Begin to deliver."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._ended.set()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(timeout=5.0)

    def address(self) -> str:
        """Return the address at which the source listens for the hardware, '' for none."""
        return ''

    def counts(self) -> dict[str, int]:
        """Return how often each kind of damage occurred since start, for diagnostics."""
        return {}

    def caution(self) -> str:
        """Return what is unsafe about the source's settings, '' for nothing; for diagnostics."""
        return ''

    def trouble(self) -> str:
        """Return why something from outside was refused last, '' where nothing was; for diagnostics."""
        return ''

    def request(self, request: Request | TurnsRequest) -> bool:
        """Pass a request to the hardware, one for turns also later; return False where that is impossible."""
        return False

    def _guarded(self) -> None:
        try:
            self._run()
        except Exception as error:  # the node decides what the end of its source means
            self._failed(error)
        finally:
            self.connected = False

    def _run(self) -> None:
        """Deliver until `_ended` is set or nothing is left."""
        raise NotImplementedError
