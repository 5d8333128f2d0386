"""The newest sweeps of one pair of stations with what is known around them, in bounded memory."""

import bisect
import dataclasses
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from drfmcw_node.processing.records import Sweep
from drfmcw_physics.settings import parameter

from ..recording.conditions import Conditions
from ..recording.dataset import PAIRING, Dataset, assembled
from .limits import WINDOW


@dataclasses.dataclass(frozen=True)
class WindowSettings:
    """Which sweeps are looked at together."""

    sweeps: int = parameter(
        336, bounds=(24, 5000), description='sweep pairs looked at together; the oldest leave first'
    )
    burst: int = parameter(24, bounds=(3, 1000), description='consecutive sweep pairs that are taken at a time')
    interval: float = parameter(
        5.0, unit='s', bounds=(0.0, 3600.0), description='between the beginnings of bursts; 0 takes every sweep'
    )
    memory: float = parameter(
        64.0, unit='MB', bounds=(1.0, 4096.0), description='of samples that are kept; the oldest leave first'
    )


@dataclasses.dataclass(eq=False)
class _Entry:
    """One sweep, of one station or of both."""

    stamp: int  # of the record that came first [ns]
    sweep_id: int
    records: dict[str, Sweep]  # by station
    size: int = 0  # [bytes]


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """A window at one moment, for another process."""

    pair: tuple[str, str]
    sweeps: list[Sweep]
    conditions: Conditions

    def dataset(self) -> Dataset:
        """Return what `drfmcw_diagnosis.recording.dataset.read_dataset` makes of a recording of the same messages.

        Raises:
            ConfigurationError: nothing usable, or what does not fit together.
        """
        stations = tuple(dict.fromkeys(self.conditions.ordered(self.pair) or self.pair))
        return assembled(f'the live window of {" and ".join(stations)}', self.conditions, stations, self.sweeps)


class Window:
    """Takes messages as they come and keeps the newest sweeps."""

    def __init__(self, pair: str, settings: WindowSettings | None = None) -> None:
        """Start empty; `pair` is 'first/second'."""
        first, second = pair.split('/')
        self.pair = (first, second)
        self._conditions = Conditions(WINDOW.conditions)
        self._settings = settings or WindowSettings()
        self.received = 0
        """Records of the pair's sweeps that have come, kept or not."""
        self._entries: list[_Entry] = []  # by stamp
        self._by_id: dict[int, _Entry] = {}
        self.size = 0
        """Of the samples kept [bytes]."""

        self._burst_start, self._burst_count = 0, 0

    def _forget_sweeps(self) -> None:
        self._entries, self._by_id, self.size = [], {}, 0
        self._burst_start, self._burst_count = 0, 0

    @property
    def settings(self) -> WindowSettings:
        """Settings; a smaller window lets sweeps leave at once."""
        return self._settings

    @settings.setter
    def settings(self, value: WindowSettings) -> None:
        self._settings = value
        self._trim()

    def __len__(self) -> int:
        """Return the number of sweeps, of which one record or both are kept."""
        return len(self._entries)

    @property
    def complete(self) -> int:
        """Number of sweeps with the records of all stations that are heard at all."""
        heard = len(self.heard)
        return sum(len(e.records) == heard for e in self._entries)

    @property
    def heard(self) -> tuple[str, ...]:
        """Stations whose records are kept."""
        return tuple(sorted({station for e in self._entries for station in e.records}))

    @property
    def newest(self) -> int:
        """Stamp of the newest sweep [ns], 0 where there is none."""
        return self._entries[-1].stamp if self._entries else 0

    def unknown(self) -> list[str]:
        """Return the topics without which nothing can be judged and from which no message has come yet."""
        return self._conditions.unknown(tuple(dict.fromkeys(self.pair)))

    def take(self, topic: str, message: Any) -> None:
        """Take in one message that is no sweep.

        Raises:
            ConfigurationError: it holds what no radar can have; nothing has changed.
        """
        self._conditions.take(topic, message)

    def add(self, sweeps: Sequence[Sweep]) -> None:
        """Take in sweeps in any order; those with other peers, between bursts, or too old are left out."""
        for sweep in sweeps:
            if {sweep.station, sweep.peer} == set(self.pair):
                self.received += 1
                self._add(sweep)

    def _add(self, sweep: Sweep) -> None:
        if sweep.stamp < self.newest - WINDOW.back:  # clocks were set, or a recording is played again
            self._forget_sweeps()
            self._conditions.keep(0, sweep.stamp + WINDOW.margin)
        entry = self._by_id.get(sweep.sweep_id)
        if entry is None or abs(entry.stamp - sweep.stamp) > PAIRING:  # the latter: numbers have begun again
            if not self._in_burst(sweep.stamp) or (entry is not None and entry.stamp > sweep.stamp):
                return
            if entry is not None:
                self._remove(entry)
            entry = _Entry(sweep.stamp, sweep.sweep_id, {})
            bisect.insort(self._entries, entry, key=lambda e: e.stamp)
            self._by_id[sweep.sweep_id] = entry
        entry.records[sweep.station] = dataclasses.replace(sweep, samples=np.asarray(sweep.samples))
        size = sum(r.samples.nbytes for r in entry.records.values())
        self.size += size - entry.size
        entry.size = size
        self._trim()

    def _in_burst(self, stamp: int) -> bool:
        """Return True where a sweep belongs to the burst that is being taken, or begins one; it is counted."""
        interval = round(self._settings.interval * 1e9)
        if stamp >= self._burst_start and self._burst_count < self._settings.burst:
            if not self._burst_count:
                self._burst_start = stamp
        elif interval == 0 or stamp >= self._burst_start + interval:
            self._burst_start, self._burst_count = stamp, 0
        else:
            return False
        self._burst_count += 1
        return True

    def _remove(self, entry: _Entry) -> None:
        del self._entries[self._entries.index(entry)]
        del self._by_id[entry.sweep_id]
        self.size -= entry.size

    def _trim(self) -> None:
        """Let the oldest leave, and what held only for them."""
        surplus = len(self._entries) - self._settings.sweeps
        kept = self.size
        count = 0
        while count < len(self._entries) and (count < surplus or kept > self._settings.memory * 1e6):
            kept -= self._entries[count].size
            count += 1
        for entry in self._entries[:count]:
            if self._by_id.get(entry.sweep_id) is entry:
                del self._by_id[entry.sweep_id]
        del self._entries[:count]
        self.size = kept
        if self._entries:
            self._conditions.keep(self._entries[0].stamp - WINDOW.margin, sys.maxsize)

    def snapshot(self) -> Snapshot:
        """Return what is kept, without sweeps whose partner may still come; valid until the next message."""
        heard = len(self.heard)
        settled = [e for e in self._entries if len(e.records) == heard or e.stamp < self.newest - PAIRING]
        sweeps = [record for e in settled for record in e.records.values()]
        return Snapshot(self.pair, sweeps, self._conditions)
