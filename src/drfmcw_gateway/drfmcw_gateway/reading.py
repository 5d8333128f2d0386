"""What a controller reads about a pair at one instant: the quality word, and a range with its age."""

import dataclasses
import enum
import math

NANOSECONDS = 1_000_000_000
_LATE_LIMIT = 10 * NANOSECONDS  # a stamp further back is of a clock that was set, not of a late sweep
_COUNTER = 1 << 32


class Quality(enum.IntFlag):
    """Bits of the quality word. Exactly one of the lowest five is set, so that 0 is never written by the gateway.

    Bits 8 to 15 are `RangeEstimate.flags` of the last range. What each bit means: `QUALITY_MEANINGS`.
    """

    VALID = 1
    DOUBTFUL = 2
    REFUSED = 4
    STALE = 8
    NO_RANGE = 16
    LATE = 32
    MIXED = 64
    CONTROLLER_SILENT = 128


FLAG_SHIFT = 8
"""Position of `RangeEstimate.flags` in the quality word."""
STATES = Quality.VALID | Quality.DOUBTFUL | Quality.REFUSED | Quality.STALE | Quality.NO_RANGE
"""The bits of which exactly one is set."""
USABLE = Quality.VALID | Quality.DOUBTFUL
"""States in which a range may be used."""

WEAK_SIGNAL, MODE_MISMATCH, OUT_OF_LIMITS, SIGNAL_QUALITY = 1, 2, 16, 32
"""Flags of RangeEstimate with which a controller drops the range (docs/sensors_and_flags.md)."""
_DROPPED = WEAK_SIGNAL | MODE_MISMATCH | OUT_OF_LIMITS | SIGNAL_QUALITY


@dataclasses.dataclass(frozen=True)
class Estimate:
    """The fields of RangeEstimate that a controller gets."""

    sweep_id: int
    flags: int
    range: float
    range_std: float
    velocity: float
    protection_level: float
    failed_tests: int
    stamp: int  # [ns]
    frame_id: str = ''


@dataclasses.dataclass(frozen=True)
class Reading:
    """A pair at one instant."""

    quality: Quality
    counter: int
    estimate: Estimate | None
    judgement: Quality  # VALID, DOUBTFUL or REFUSED when the last range came, NO_RANGE without one
    age: float  # of the last range's stamp, by the clock; NaN without a range [s]
    silence: float  # since the last range arrived; infinite without one [s]

    @property
    def state(self) -> Quality:
        """Return the one state bit."""
        return self.quality & STATES

    def value(self, name: str) -> float:
        """Return a number of the range, NaN where it must not be used."""
        if self.estimate is None or not self.state & USABLE:
            return math.nan
        return float(getattr(self.estimate, name))


@dataclasses.dataclass(frozen=True)
class _Arrived:
    estimate: Estimate
    arrival: float
    counter: int
    mixed: bool


class PairState:
    """Keeps a pair's newest range. One thread may take ranges while others read."""

    def __init__(self, timeout: float, age_limit: float) -> None:
        """Start without a range.

        Args:
            timeout: without a range, after which the last one is stale [s].
            age_limit: difference of stamp and clock beyond which a range is stale, NaN for none [s].
        """
        self.timeout, self.age_limit = timeout, age_limit
        self.late = 0
        """Ranges that came after a newer one, and were left out."""
        self._last: _Arrived | None = None

    def take(self, estimate: Estimate, arrival: float, mixed: bool = False) -> bool:
        """Take a range; return whether it is the newest.

        Args:
            estimate: as published.
            arrival: on any clock that runs on [s].
            mixed: whether several nodes publish this pair's ranges.
        """
        last = self._last
        if last is not None and last.estimate.stamp - _LATE_LIMIT < estimate.stamp < last.estimate.stamp:
            self.late += 1
            return False
        counter = (last.counter + 1) % _COUNTER if last else 1
        self._last = _Arrived(estimate, arrival, counter, mixed)
        return True

    def reading(self, now: float, clock: int, margin: float = 0.0, controller_silent: bool = False) -> Reading:
        """Return what holds at an instant.

        Args:
            now: on the clock of the arrivals [s].
            clock: on the clock of the stamps [ns].
            margin: time until somebody looks again; silence that will have lasted too long by then counts already [s].
            controller_silent: whether the controller's heartbeat has stopped.
        """
        extra = Quality.CONTROLLER_SILENT if controller_silent else Quality(0)
        last = self._last
        if last is None:
            return Reading(Quality.NO_RANGE | extra, 0, None, Quality.NO_RANGE, math.nan, math.inf)
        age = (clock - last.estimate.stamp) / NANOSECONDS
        silence = now - last.arrival
        if abs(age) > self.age_limit:
            extra |= Quality.LATE
        if last.mixed:
            extra |= Quality.MIXED
        judgement = Quality.REFUSED if last.mixed else judged(last.estimate)
        stale = silence + margin >= self.timeout or extra & Quality.LATE
        state = Quality.STALE if stale else judgement
        flags = Quality((last.estimate.flags & 0xFF) << FLAG_SHIFT)
        return Reading(state | extra | flags, last.counter, last.estimate, judgement, age, silence)


def judged(estimate: Estimate) -> Quality:
    """Return VALID, DOUBTFUL or REFUSED for a range by its flags."""
    if estimate.flags & _DROPPED or not math.isfinite(estimate.range):
        return Quality.REFUSED
    return Quality.DOUBTFUL if estimate.flags else Quality.VALID


class Controller:
    """The controller's own heartbeat: a number that it changes as long as it lives."""

    def __init__(self, timeout: float) -> None:
        """Expect a change within `timeout`, NaN for never [s]."""
        self.timeout = timeout
        self.value = 0
        """The number written last."""
        self._changed: float | None = None

    def write(self, value: int, now: float) -> None:
        """Take a number."""
        if self._changed is None or value != self.value:
            self.value, self._changed = value, now

    @property
    def heard(self) -> bool:
        """Return whether a controller has ever written."""
        return self._changed is not None

    def silence(self, now: float) -> float:
        """Return the time since the number changed last, infinite where it never did [s]."""
        return math.inf if self._changed is None else now - self._changed

    def silent(self, now: float) -> bool:
        """Return whether the number has not changed for longer than allowed; one that never wrote is silent too."""
        return not math.isnan(self.timeout) and self.silence(now) >= self.timeout
