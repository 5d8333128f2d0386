"""One decision per range of a pair: valid, doubtful or refused, with its protection level."""

import collections
import dataclasses
import itertools
import math

from ..combination import PathDelay, Station
from ..tracking import UNKNOWN, Motion
from . import checks, continuity
from .checks import PASSED, Decision, Test, Verdict, refuse
from .continuity import Limits, Measured, State
from .settings import IntegritySettings

INTEGRITY_RISK = 1e-5
"""Probability that a range that passed is off by more than its protection level."""

_MISSED = 4.26  # standard deviations of a one-sided probability of INTEGRITY_RISK
_REMEMBERED = 8192  # results of a station among which a repeated one is looked for: a ring of buffers read again
_ORDERED = 32  # sweeps back in which a late one is put in order
_STABLE = 10  # sweeps that a step of T_off must last to count as one of the references
_SHORTEST_STEP = 0.5  # of the usual interval: stamps of partners that differ by more belong to two sweeps
_SET_BACK_SWEEPS = 10  # that continue each other long ago, and none newer, before the clock counts as set back
_SET_BACK_TIME = 1.0  # for which they last at least [s]
_INTERVALS = 16  # whose smallest is the usual one


@dataclasses.dataclass(frozen=True)
class Judgement:
    """What the monitor says about one sweep."""

    motion: Motion
    verdict: Verdict
    gate: float  # [m]
    scale: float

    def protection_level(self, std: float) -> float:
        """Return the bound that the error exceeds with `INTEGRITY_RISK` at most [m]; `std` as published."""
        if self.verdict.decision == Decision.REFUSED:
            return math.inf
        return self.gate + _MISSED * std


class PairMonitor:
    """Tests the sweeps of one pair."""

    def __init__(self, limits: Limits, settings: IntegritySettings) -> None:
        """Start with nothing known; `limits` are the crane's."""
        self._limits, self._settings = limits, settings
        self._state: State | None = None
        self._ordered: collections.deque[tuple[Measured, State | None]] = collections.deque(maxlen=_ORDERED)
        self._known: dict[str, dict[tuple[float, ...], None]] = {}  # in order
        self._early = (0, 0, 0)  # newest sweeps, where they are of long ago: first and last stamp, and how many
        self._stamps: collections.deque[int] = collections.deque(maxlen=_INTERVALS)
        self._excess, self._excess_stamp = math.nan, 0
        self._since_step = _STABLE
        self.failures: collections.Counter[str] = collections.Counter()
        """Number of failed tests by name, since start."""

    def judge_sweep(self, first: Station, second: Station, path: PathDelay, distance: float, unlocked: bool) -> Verdict:
        """Return the verdict of all tests that need no track.

        Args:
            first: station 1.
            second: station 2; the same where a station hears itself.
            path: their combined delay.
            distance: measured range [m].
            unlocked: a station's status says that its PLL is not locked.
        """
        if not self._settings.monitor:
            return PASSED
        stations = (first,) if first is second else (first, second)
        verdict = refuse(Test.UNLOCKED) if unlocked else PASSED
        if any([self._repeats(station) for station in stations]):  # every station's result is remembered
            verdict &= refuse(Test.REPEATED)
        for station in stations:
            verdict &= checks.noise(station, self._settings) & checks.straight(station)
        if first is second:
            return verdict
        if not self._stamps_agree(first, second):
            verdict &= refuse(Test.STAMPS)
        power = checks.powers(first, second, distance, self._settings)
        return verdict & power & self._start_delay(first, second, path, distance, power)

    def _start_delay(
        self, first: Station, second: Station, path: PathDelay, distance: float, power: Verdict
    ) -> Verdict:
        if not math.isfinite(path.delay):
            return PASSED  # without a line there is nothing to test
        verdict, excess = checks.start_delay(first, second, path, distance, self._settings)
        stamp = first.beat.stamp
        soon = abs(stamp - self._excess_stamp) * 1e-9 <= self._settings.restart_pause
        stepped = soon and abs(excess - self._excess) > 2.0 * self._settings.start_delay_tolerance
        self._since_step = 0 if stepped else self._since_step + 1
        if not soon:  # the references drift in a pause
            self._since_step = _STABLE
        self._excess, self._excess_stamp = excess, stamp
        # a line of another origin than the peer's has another power, and comes at once
        if verdict is not PASSED and (power is not PASSED or self._since_step < _STABLE):
            return refuse(Test.START_DELAY)
        return verdict

    def _repeats(self, station: Station) -> bool:
        """Return whether a station has given the very same numbers before: one buffer, read twice."""
        beat = station.beat
        numbers = (beat.frequency, beat.phase, beat.power, beat.snr)
        known = self._known.setdefault(station.sweep.station, {})
        repeated = numbers in known
        known.pop(numbers, None)  # the newest ones stand last
        known[numbers] = None
        if len(known) > _REMEMBERED:
            del known[next(iter(known))]
        return repeated

    def _stamps_agree(self, first: Station, second: Station) -> bool:
        """Return whether both results are of one sweep by their stamps, not of neighbours under one number."""
        self._stamps.append(first.beat.stamp)
        ordered = sorted(self._stamps)
        steps = [b - a for a, b in itertools.pairwise(ordered) if b > a]
        if not steps:
            return True
        late = second.beat.stamp - first.beat.stamp - round(first.sweep.start_delay * 1e9)
        return abs(late) < _SHORTEST_STEP * min(steps)

    def follow(self, measured: Measured) -> Judgement:
        """Return velocity and verdict of a sweep that passed the other tests; late ones are put in order."""
        newest = self._ordered[-1][0].stamp if self._ordered else measured.stamp - 1
        behind = (newest - measured.stamp) * 1e-9
        if behind < 0.0:
            self._early = (0, 0, 0)
            return self._advance(measured)
        if behind > self._settings.restart_pause:
            if not self._set_back(measured.stamp):
                return Judgement(self.coast(measured.stamp), refuse(Test.LATE), math.inf, 1.0)
            self._ordered.clear()
            self._state = None
            return self._advance(measured)
        if self._ordered[0][0].stamp >= measured.stamp or any(m.stamp == measured.stamp for m, _ in self._ordered):
            return Judgement(self.coast(measured.stamp), refuse(Test.LATE), math.inf, 1.0)
        later: list[Measured] = []
        while self._ordered[-1][0].stamp > measured.stamp:
            undone, self._state = self._ordered.pop()
            later.append(undone)
        judgement = self._advance(measured)
        for again in reversed(later):
            self._advance(again)
        return judgement

    def _set_back(self, stamp: int) -> bool:
        """Return whether sweeps of long ago go on (a clock set back, a recording from its beginning).

        What a link held up and delivers behind newer sweeps is no new time, and must not end the track.
        """
        first, last, count = self._early
        first, count = (first, count + 1) if count and stamp > last else (stamp, 1)
        self._early = (first, stamp, count)
        if count < _SET_BACK_SWEEPS or (stamp - first) * 1e-9 < _SET_BACK_TIME:
            return False
        self._early = (0, 0, 0)
        return True

    def _advance(self, measured: Measured) -> Judgement:
        self._ordered.append((measured, self._state))
        if self._state is None:
            self._state, outcome = continuity.begin(measured, self._limits)
        else:
            self._state, outcome = continuity.follow(self._state, measured, self._limits, self._settings)
        return Judgement(outcome.motion, outcome.verdict, outcome.gate, outcome.scale)

    def coast(self, stamp: int) -> Motion:
        """Return the velocity at `stamp` [ns] without a sweep."""
        return continuity.coasting(self._state, stamp) if self._state is not None else UNKNOWN

    def count(self, verdict: Verdict) -> None:
        """Count the failed tests."""
        if not verdict.failed:
            return
        for test in Test:
            if test and verdict.failed & test:
                self.failures[str(test.name).lower()] += 1
