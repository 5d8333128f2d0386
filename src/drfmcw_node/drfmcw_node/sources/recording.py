"""Source `recording`: one station's sweeps from a rosbag2 recording."""

import dataclasses
import time
from typing import Any

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.history import History
from drfmcw_physics.rules.schedule import Share
from drfmcw_physics.settings import ConfigurationError, parameter
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.bag.files import BagError, BagReader
from drfmcw_ros.graph.messages import from_message

from ..processing.records import Sweep
from .source import BATCH, Source

_KINDS: dict[str, type] = {
    'if_samples': Sweep,
    'sweep_config': SweepSettings,
    'sweep_schedule': Share,
    'calibration': Calibration,
}


@dataclasses.dataclass(frozen=True)
class RecordingSettings:
    """Which recording is played, and how fast."""

    recording: str = parameter('', structural=True, description='path of the rosbag2 recording, of source recording')
    recording_rate: float = parameter(
        1.0, structural=True, bounds=(0.0, 1e6), description='times as fast as recorded; 0: as fast as possible'
    )


class RecordingSource(Source, name='recording'):
    """Plays one station's sweeps from a recording, with the recorded settings and calibrations."""

    settings = RecordingSettings
    brings_settings = True

    def __init__(self, station: str, settings: RecordingSettings, **kwargs: Any) -> None:
        """Open the recording; arguments as for `Source`.

        Raises:
            ConfigurationError: no recording is named.
            BagError: it is not readable, or lacks what is needed.
        """
        super().__init__(station, settings, **kwargs)
        if not settings.recording:
            raise ConfigurationError('recording: give the path of the recording that source recording plays')
        self._path, self._station, self._rate = settings.recording, station, settings.recording_rate
        with BagReader(self._path) as bag:
            for name in ('if_samples', 'sweep_config', 'calibration'):
                bag.require(f'/{station}/{name}')

    def _run(self) -> None:
        self.connected = True
        start, first = time.monotonic(), None
        with BagReader(self._path) as bag:
            topics = [t for t in bag.topics if t.endswith('/calibration')]
            topics += [f'/{self._station}/{name}' for name in ('sweep_config', 'sweep_schedule', 'if_samples')]
            pending: list[Any] = []
            for topic, _, message in bag.messages(topics):
                item = _converted(topic, message)
                if isinstance(item, Sweep) and self._rate > 0.0:
                    first = item.stamp if first is None else first
                    due = start + (item.stamp - first) * 1e-9 / self._rate - time.monotonic()
                    if due > 0.0:
                        self._hand_over(pending)
                        if self._ended.wait(due):
                            return
                pending.append(item)
                if len(pending) >= BATCH:
                    self._hand_over(pending)
                if self._ended.is_set():
                    return
            self._hand_over(pending)

    def _hand_over(self, pending: list[Any]) -> None:
        if pending:
            self._deliver(list(pending))
            pending.clear()


def recorded_frames(path: str, station: str) -> tuple[SweepSettings, list[tuple[Sweep, SweepSettings]]]:
    """Return (first settings, sweeps with the settings that hold for them) of one station in a recording.

    Raises:
        BagError: not readable, or without the station's sweeps or settings.
    """
    settings: dict[str, SweepSettings] = {}
    sweeps: list[tuple[Sweep, SweepSettings]] = []
    first: SweepSettings | None = None
    with BagReader(path) as bag:
        for name in ('if_samples', 'sweep_config'):
            bag.require(f'/{station}/{name}')
        for topic, _, message in bag.messages([f'/{station}/sweep_config', f'/{station}/if_samples']):
            item = _converted(topic, message)
            if isinstance(item, SweepSettings):
                settings[item.peer] = item
                first = first or item
            elif item.peer in settings:
                sweeps.append((item, settings[item.peer]))
    if first is None or not sweeps:
        raise BagError(f'{path}: no sweeps of {station} with settings')
    return first, sweeps


def recorded_shares(path: str, station: str) -> dict[str, History[Share]]:
    """Return what the time division granted to one station in a recording, by peer; empty where it states nothing.

    Raises:
        BagError: not readable.
    """
    shares: dict[str, History[Share]] = {}
    with BagReader(path) as bag:
        for topic, _, message in bag.messages([f'/{station}/sweep_schedule']):
            share = _converted(topic, message)
            shares.setdefault(share.peer, History()).add(share.stamp, share)
    return shares


def _converted(topic: str, message: Any) -> Any:
    return from_message(message, _KINDS[topic.rsplit('/', 1)[-1]])
