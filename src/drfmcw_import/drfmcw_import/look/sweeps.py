"""The sweeps of a recording, station by station, as many as memory should hold."""

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.bag.files import BagError, BagReader
from drfmcw_ros.graph.messages import from_message, stamp_ns
from drfmcw_ros.graph.topics import split_station_topic

from ..formats.base import Numbers

_MOST = 1 << 24  # numbers of one station kept at most

_Key = tuple[str, str]


@dataclasses.dataclass(frozen=True)
class StationSweeps:
    """Sweeps of one station at one setting, evenly picked from all where there are too many."""

    sweep: SweepSettings
    samples: Numbers  # (n, N, 1 or 2) codes
    stamps: Numbers  # (n,) [ns]
    sweep_id: Numbers  # (n,)
    full_scale: float  # [LSB]
    recorded: int  # sweeps of this station in the recording, of all settings
    of_setting: int  # of those read, how many were taken at this setting
    read: int  # read
    settings: int  # different settings in the recording

    @property
    def iq(self) -> bool:
        """True for a quadrature receiver."""
        return bool(self.samples.shape[2] == 2)

    @property
    def signal(self) -> Numbers:
        """(n, N) complex or real samples relative to full scale."""
        scaled = self.samples.astype(float) / self.full_scale
        return scaled[..., 0] + 1j * scaled[..., 1] if self.iq else scaled[..., 0]

    @property
    def time(self) -> Numbers:
        """Start of each sweep since the first one, (n,) [s]."""
        return np.asarray((self.stamps - self.stamps[0]) * 1e-9)


class Settings:
    """Sweep settings of a recording, looked up by stamp as the nodes do."""

    def __init__(self, bag: BagReader) -> None:
        """Read all settings."""
        topics = {t for t in bag.topics if split_station_topic(t)[1] == 'sweep_config'}
        self._known: dict[_Key, list[SweepSettings]] = {}
        for _, _, message in bag.messages(topics):
            sweep = from_message(message, SweepSettings)
            self._known.setdefault((sweep.station, sweep.peer), []).append(sweep)
        for sweeps in self._known.values():
            sweeps.sort(key=lambda s: s.stamp)

    def at(self, station: str, peer: str, stamp: int) -> SweepSettings | None:
        """Return the newest settings that are not later than a sweep, None where there are none."""
        earlier = [s for s in self._known.get((station, peer), []) if s.stamp <= stamp]
        return earlier[-1] if earlier else None


def stations(bag: BagReader) -> list[str]:
    """Return the stations whose samples are recorded.

    Raises:
        BagError: there are none.
    """
    found = sorted(split_station_topic(t)[0] for t in bag.topics if split_station_topic(t)[1] == 'if_samples')
    if not found:
        raise BagError(f"{bag.path}: holds no '/<station>/if_samples'; topics: {', '.join(sorted(bag.topics))}")
    return found


def messages(bag: BagReader, station: str, step: int = 1) -> Iterator[Any]:
    """Yield every `step`-th IfSamples message of a station."""
    for _, _, message in itertools.islice(bag.messages({f'/{station}/if_samples'}), 0, None, step):
        yield message


def read_sweeps(path: Path | str) -> list[StationSweeps]:
    """Return the sweeps of each station at the setting that most of them have.

    Raises:
        BagError: the recording cannot be read, or lacks samples or the settings of a station.
    """
    with BagReader(path) as bag:
        settings = Settings(bag)
        return [_of_station(bag, name, settings) for name in stations(bag)]


def _of_station(bag: BagReader, station: str, settings: Settings) -> StationSweeps:
    count = next(c.msgcount for c in bag.connections if c.topic == f'/{station}/if_samples')
    first = next(messages(bag, station), None)
    if first is None:
        raise BagError(f"{bag.path}: topic '/{station}/if_samples' has no messages")
    step = max(1, -(-count * len(first.samples) // _MOST))
    taken: dict[str, list[Any]] = {}
    kinds: dict[str, SweepSettings] = {}
    read = 0
    for message in messages(bag, station, step):
        read += 1
        sweep = settings.at(station, message.peer, stamp_ns(message.header.stamp))
        if sweep is None:
            continue
        plain = dataclasses.replace(sweep, stamp=0)
        # as text, because NaN equals nothing
        key = repr((plain, len(message.samples), message.iq, message.full_scale))
        kinds.setdefault(key, sweep)
        taken.setdefault(key, []).append(message)
    if not taken:
        raise BagError(f"{bag.path}: no settings (topic '/{station}/sweep_config') for the sweeps of '{station}'")
    best = max(taken, key=lambda k: len(taken[k]))
    chosen = taken[best]
    return StationSweeps(
        sweep=kinds[best],
        samples=np.stack([np.asarray(m.samples) for m in chosen]).reshape(len(chosen), -1, 2 if chosen[0].iq else 1),
        stamps=np.array([stamp_ns(m.header.stamp) for m in chosen], np.int64),
        sweep_id=np.array([m.sweep_id for m in chosen], np.int64),
        full_scale=float(chosen[0].full_scale),
        recorded=count,
        of_setting=len(chosen),
        read=read,
        settings=len(taken),
    )
