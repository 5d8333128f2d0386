"""The newest of everything, with its age by the host's own clock, shared between the ROS thread and the pages."""

import collections
import dataclasses
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from drfmcw_fusion.offline import Reference
from drfmcw_fusion.replayed.statistics import reference_at
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.commands.versions import SOFTWARE

from .freshness import Arrivals
from .history import History
from .readings import LOG_LEVELS, Diagnostic, Health, Line, LogLine, RangeReading, SiteReading, SpectrumReading
from .verdicts import Verdicts

SERIES = ('range', 'error', 'std', 'rate')
"""Histories of a pair: range [m], error against the reference [m], standard deviation [m], ranges per second."""

_KEEP_EVERY = 0.25  # between two additions to the histories, which cost the same for one value as for many [s]
_RATE_TIME = 1.0  # over which the rate is counted [s]
_REFERENCE_WAIT = 0.5  # of a range for the reading after it [s]
_READINGS = 4000  # of the reference
_JUMP = 10_000_000_000  # back in time, of a site that begins again [ns]
_PENDING = 4000  # ranges that wait for the reference
_DIAGNOSTIC_HOLD = 30.0  # after which a line of /diagnostics that is not repeated goes [s]
_DIAGNOSTIC_LINES = 500
_LOG_LINES = 100  # kept of errors, of warnings and of all others: a node that says much displaces no error
_CLOCK_STATUSES = 10  # of a station, whose least difference is taken: that of the shortest way
_LARGEST = 64  # pairs, stations, and peers of one


@dataclasses.dataclass
class Pair:
    """What is known about one pair of stations."""

    newest: RangeReading | None = None
    seen: Arrivals = dataclasses.field(default_factory=Arrivals)
    count: int = 0
    error: float = math.nan  # newest error against the reference [m]
    histories: dict[str, History] = dataclasses.field(default_factory=lambda: {name: History() for name in SERIES})
    arrivals: collections.deque[tuple[float, int]] = dataclasses.field(default_factory=collections.deque)
    pending: collections.deque[tuple[float, int, int, float]] = dataclasses.field(
        default_factory=lambda: collections.deque(maxlen=_PENDING)
    )  # (monotonic [s], received [ns], stamp [ns], range [m])
    new: list[tuple[int, float, float]] = dataclasses.field(default_factory=list)
    """Received [ns], range [m] and standard deviation [m] of what is not in the histories yet."""
    kept: float = -math.inf  # when the histories were added to [s]

    def rate(self, now: float) -> float:
        """Return ranges per second over the last second before `now` (monotonic [s])."""
        while self.arrivals and self.arrivals[0][0] < now - _RATE_TIME:
            self.arrivals.popleft()
        return sum(count for _, count in self.arrivals) / _RATE_TIME


@dataclasses.dataclass
class Station:
    """What is known about one station; results and settings by peer."""

    health: Health | None = None
    health_received: float = -math.inf  # monotonic [s]
    differences: collections.deque[float] = dataclasses.field(
        default_factory=lambda: collections.deque(maxlen=_CLOCK_STATUSES)
    )  # host's clock at the arrival minus stamp, of each status [s]
    calibration: Calibration | None = None
    calibration_stamp: int = 0  # [ns]
    settings: dict[str, SweepSettings] = dataclasses.field(default_factory=dict)
    lines: dict[str, Line] = dataclasses.field(default_factory=dict)
    lines_seen: dict[str, Arrivals] = dataclasses.field(default_factory=dict)
    spectra: dict[str, SpectrumReading] = dataclasses.field(default_factory=dict)
    spectra_seen: dict[str, Arrivals] = dataclasses.field(default_factory=dict)

    @property
    def clock_difference(self) -> float:
        """Host's clock minus the station's, too large by the shortest way of a status [s]; NaN before the first."""
        return min(self.differences, default=math.nan)

    def add_line(self, peer: str, line: Line, now: float) -> None:
        """Take a beat frequency that arrived at `now` (monotonic [s])."""
        self.lines[peer] = line
        self.lines_seen.setdefault(peer, Arrivals()).add(now)

    def add_spectrum(self, peer: str, spectrum: SpectrumReading, now: float) -> None:
        """Take a spectrum that arrived at `now` (monotonic [s])."""
        self.spectra[peer] = spectrum
        self.spectra_seen.setdefault(peer, Arrivals()).add(now)

    def forget_signals(self) -> None:
        """Drop lines and spectra: nobody listens to them any more."""
        for kept in (self.lines, self.lines_seen, self.spectra, self.spectra_seen):
            kept.clear()


class Store:
    """Everything that the pages show. Methods may be called from any thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, software: Mapping[str, str] | None = None) -> None:
        """Start empty.

        Args:
            clock: gives the host's monotonic time [s].
            software: versions and digests of the host's own packages by name.
        """
        self.clock = clock
        self.own_software = dict(software or {})
        self.lock = threading.RLock()
        self.pairs: dict[str, Pair] = {}
        self.stations: dict[str, Station] = {}
        self.site: dict[str, SiteReading] = {}  # by topic
        self.diagnostics: dict[tuple[str, str], Diagnostic] = {}
        self.verdicts: dict[str, Verdicts] = {}  # of the live diagnosis, by pair
        self.latency = math.nan  # of the newest clock difference: host time minus stamp of the newest range [s]
        self._logs = {level: collections.deque[tuple[int, LogLine]](maxlen=_LOG_LINES) for level in LOG_LEVELS}
        self._logged = 0  # lines so far
        self._references: collections.deque[tuple[int, float, str]] = collections.deque(maxlen=_READINGS)
        self._signals_wanted = -math.inf

    def pair(self, name: str) -> Pair | None:
        """Return the pair 'first/second', made where it is new; None where there are too many."""
        if name not in self.pairs and len(self.pairs) < _LARGEST:
            self.pairs[name] = Pair()
        return self.pairs.get(name)

    def station(self, name: str) -> Station | None:
        """Return the station, made where it is new; None where there are too many."""
        if name not in self.stations and len(self.stations) < _LARGEST:
            self.stations[name] = Station()
        return self.stations.get(name)

    def want_signals(self) -> None:
        """Ask for spectra and lines for the next two seconds: a browser shows them."""
        self._signals_wanted = self.clock()

    @property
    def signals_wanted(self) -> bool:
        """Whether any browser shows spectra and lines."""
        return self.clock() - self._signals_wanted < 2.0

    def add_ranges(self, name: str, readings: Sequence[RangeReading], received: Sequence[int]) -> None:
        """Take a pair's ranges in order of arrival; `received` is when each one did [ns]."""
        now = self.clock()
        with self.lock:
            pair = self.pair(name)
            if pair is None:
                return
            if readings:
                arrived = now - max(0.0, (time.time_ns() - received[-1]) * 1e-9)
                pair.seen.add(arrived)
                pair.newest = readings[-1]
                pair.count += len(readings)
                pair.arrivals.append((now, len(readings)))
                pair.new.extend((t, r.range, r.range_std) for t, r in zip(received, readings, strict=True))
                self.latency = (received[-1] - readings[-1].stamp) * 1e-9
                if self._references:
                    pair.pending.extend((now, t, r.stamp, r.range) for t, r in zip(received, readings, strict=True))
            if now - pair.kept >= _KEEP_EVERY:
                pair.kept = now
                self._keep(pair, now)
                self._compare(name, pair, now)

    def _keep(self, pair: Pair, now: float) -> None:
        """Add what is new to the histories."""
        if pair.new:
            times, ranges, stds = zip(*pair.new, strict=True)
            pair.histories['range'].add(np.array(times, dtype=np.int64), np.array(ranges))
            pair.histories['std'].add(np.array(times, dtype=np.int64), np.array(stds))
            pair.new.clear()
        if pair.newest is not None:
            pair.histories['rate'].add(np.array([time.time_ns()]), np.array([pair.rate(now)]))

    def _compare(self, name: str, pair: Pair, now: float) -> None:
        """Compare ranges with the reference once the reading after them has had time to arrive."""
        due = []
        while pair.pending and now - pair.pending[0][0] >= _REFERENCE_WAIT:
            due.append(pair.pending.popleft())
        if not due:
            return
        stamps, ranges, frames = (np.array(column) for column in zip(*self._references, strict=True))
        order = np.argsort(stamps, kind='stable')
        reference = Reference(stamps[order], ranges[order], np.zeros(len(order)), frames[order]).of(name)
        errors = np.array([d[3] for d in due]) - reference_at(reference, np.array([d[2] for d in due]))
        pair.histories['error'].add(np.array([d[1] for d in due]), errors)
        finite = errors[np.isfinite(errors)]
        pair.error = float(finite[-1]) if len(finite) else math.nan

    def add_reference(self, stamp: int, distance: float, frame: str) -> None:
        """Take a reading of the reference instrument: stamp [ns], distance [m]."""
        with self.lock:
            if self._references and stamp < self._references[-1][0] - _JUMP:
                self._references.clear()  # a simulation began again
            self._references.append((stamp, distance, frame))

    def add_health(self, name: str, health: Health, stamp: int, received: int) -> None:
        """Take a station's status: when it was sent by the station's clock and came by the host's [ns]."""
        with self.lock:
            station = self.stations[name]
            station.health, station.health_received = health, self.clock()
            station.differences.append((received - stamp) * 1e-9)

    def age(self, pair: Pair) -> float:
        """Return the time since the pair's newest range arrived [s], infinite before the first."""
        return pair.seen.age(self.clock())

    def is_stale(self, pair: Pair) -> bool:
        """Return whether the pair's newest range is no longer current: older than 0.25 s and than is usual here."""
        return pair.seen.is_stale(self.clock())

    def weather_age(self, topic: str) -> float:
        """Return how long ago a reading was taken [s]: by its stamp and the newest range's where both state a time.

        The middleware hands out old readings as well; NaN where there is none.
        """
        reading = self.site.get(topic)
        if reading is None:
            return math.nan
        age = self.clock() - reading.received
        newest = min(self.pairs.values(), key=self.age, default=None)
        if newest is not None and newest.newest is not None and reading.stamp:
            age = max(age, (newest.newest.stamp - reading.stamp) * 1e-9 + self.age(newest))
        return age

    def chosen(self, name: str) -> str:
        """Return the pair to show: of that name, else the first that is current, else the first; '' for none."""
        if name in self.pairs:
            return name
        names = sorted(self.pairs)
        return next((n for n in names if not self.is_stale(self.pairs[n])), names[0] if names else '')

    def add_logs(self, lines: Sequence[LogLine]) -> None:
        """Take lines of /rosout in order of arrival."""
        with self.lock:
            for line in lines:
                self._logged += 1
                self._logs[max((f for f in LOG_LEVELS if f <= line.level), default=0)].append((self._logged, line))

    def newest_logs(self, level: int) -> list[LogLine]:
        """Return the kept lines of at least this level (one of LOG_LEVELS), the newest first."""
        with self.lock:
            kept = [entry for low, lines in self._logs.items() if low >= level for entry in lines]
        return [line for _, line in sorted(kept, key=lambda entry: -entry[0])]

    def add_diagnostic(self, found: Diagnostic) -> None:
        """Take one line of /diagnostics."""
        with self.lock:
            key = (found.hardware, found.name)
            if key in self.diagnostics or len(self.diagnostics) < _DIAGNOSTIC_LINES:
                self.diagnostics[key] = found
            pair = found.watched
            if pair and (pair in self.verdicts or len(self.verdicts) < _LARGEST):
                self.verdicts.setdefault(pair, Verdicts()).add(found.level, time.time())

    def software(self, station: str) -> tuple[str, list[str]]:
        """Return (release that a station's node runs, packages whose code is not the host's); '' where it says none."""
        with self.lock:
            named = [d for d in self.diagnostics.values() if d.name.endswith(f': {SOFTWARE}')]
        own = [d for d in named if d.name == f'/{station}/station: {SOFTWARE}']
        found = [*own, *(d for d in named if d.hardware == station)]
        if not found:
            return '', []
        differing = [key for key, value in found[0].values if self.own_software.get(key, value) != value]
        return found[0].message, differing

    def current_diagnostics(self) -> list[Diagnostic]:
        """Return the lines of the last 30 s, the worst first."""
        now = self.clock()
        with self.lock:
            for key in [k for k, d in self.diagnostics.items() if now - d.received > _DIAGNOSTIC_HOLD]:
                del self.diagnostics[key]
            return sorted(self.diagnostics.values(), key=lambda d: (-d.level, d.name, d.hardware))
