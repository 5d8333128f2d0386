"""Source `recording`: one station's sweeps out of a rosbag2 recording."""

import time
from typing import Any

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.bag.files import BagError, BagReader
from drfmcw_ros.messages import from_message

from ..processing.records import Sweep
from .source import BATCH, Source

_KINDS = {'if_samples': Sweep, 'sweep_config': SweepSettings, 'calibration': Calibration}


class RecordingSource(Source):
    """Plays one station's sweeps from a recording, with the settings and calibrations that stand in it."""

    def __init__(self, path: str, station: str, rate: float, **kwargs: Any) -> None:
        """Open the recording.

        Args:
            path: of the rosbag2 recording.
            station: whose sweeps are played.
            rate: times as fast as recorded; 0 as fast as the station can.
            kwargs: as `Source`.

        Raises:
            BagError: not readable, or without what is needed.
        """
        super().__init__(**kwargs)
        self._path, self._station, self._rate = path, station, rate
        with BagReader(path) as bag:
            for name in ('if_samples', 'sweep_config', 'calibration'):
                bag.require(f'/{station}/{name}')

    def _run(self) -> None:
        self.connected = True
        start = time.monotonic()
        with BagReader(self._path) as bag:
            topics = [t for t in bag.topics if t.endswith('/calibration')]
            topics += [f'/{self._station}/{name}' for name in ('sweep_config', 'if_samples')]
            pending: list[Any] = []
            first = None
            for topic, _, message in bag.messages(topics):
                item = from_message(message, _KINDS[topic.rsplit('/', 1)[-1]])
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
    with BagReader(path) as bag:
        for name in ('if_samples', 'sweep_config'):
            bag.require(f'/{station}/{name}')
        settings, sweeps, first = {}, [], None
        for topic, _, message in bag.messages([f'/{station}/sweep_config', f'/{station}/if_samples']):
            item = from_message(message, _KINDS[topic.rsplit('/', 1)[-1]])
            if isinstance(item, SweepSettings):
                settings[item.peer] = item
                first = first or item
            elif item.peer in settings:
                sweeps.append((item, settings[item.peer]))
    if first is None or not sweeps:
        raise BagError(f'{path}: no sweeps of {station} with settings')
    return first, sweeps
