"""Whether a range continues the movement before it, within the declared limits of the crane.

In: one sweep's delay and range. Out: its velocity, and whether the range continues the track. States are immutable, so
that a late sweep is put in order by going back to the state before it.
"""

import dataclasses
import math

from ..combination import PathDelay
from ..tracking import UNKNOWN, Motion, VelocityTracker
from .checks import PASSED, Decision, Test, Verdict, refuse
from .settings import IntegritySettings

GATE = 4.5
"""Standard deviations of an innovation beyond which a range does not continue its track: 7e-6 of false alarms."""

_SMALLEST_GAIN = 1.0 / 16.0  # of a new range on the track: follows slow errors of the model
_SCATTER_LENGTH = 24  # innovations whose median shows the scatter
_SCATTER_MINIMUM = 12  # and how many it takes
_SCATTER_DOUBT = 3.0  # times the stated standard deviation
_SCATTER_REFUSAL = 5.0
_MEDIAN = 0.6745  # of the absolute value of a normal deviate
_LAG = 0.66  # by which a parabola through five sweeps misses a velocity that begins to change, over a dt at most
_SUPPORT = 5  # ranges that a track needs to refuse another one for good
_STEADY = 10  # ranges that a shorter track needs to be taken for the direct path
_LARGEST_Z = 100.0
_SETTLED = 8  # sweeps after which a track's velocity predicts the next phase
_PHASE_ACCELERATION = 2.0  # times the largest one, for what the velocity lags behind
_LONGEST_PHASE_STEP = 0.2  # [s]
_PHASE_SHARE = 0.15  # of a range's standard deviation, that a phase may be off its prediction; its own is 0.01
_MEAN_LENGTH = 16  # ranges after a break of the phases whose mean shows whether it moved them
_MOST_SUSPECT = 8  # sweeps; among many wrong ones some continue the track by chance, but not so many in a row
_ANCHOR_LENGTH = 1024  # ranges whose mean is compared with the newest ones, as far as the phases go on
_DRIFT = 1.0  # standard deviations of a range by which both may differ
_SCALE_ERROR = 3e-5  # of a displacement by the phases: what the references have drifted since they were calibrated
_LARGEST_SHARE = 4.0  # published standard deviations that an innovation may be


@dataclasses.dataclass(frozen=True)
class Limits:
    """What the crane can do."""

    velocity: float  # [m/s]
    acceleration: float  # [m/s^2]


@dataclasses.dataclass(frozen=True)
class Measured:
    """One sweep, as the track takes it in."""

    stamp: int  # [ns]
    path: PathDelay
    standing_range: float  # with the Doppler shift still in it [m]
    std: float  # of the range [m]
    index: float  # refractive index of the air [1]
    doppler: float  # by which the velocity lengthens the range [m per m/s]
    setting: tuple[int, float]  # mode and start delay
    doubt: float = 0.0  # what failed tests add to `std`, as a square [m]
    resolution: float = 0.0  # by which two paths must differ for two lines [m]
    lasting: float = 0.0  # standard deviation of what does not average over sweeps [m]


@dataclasses.dataclass(frozen=True)
class Track:
    """Where a sequence of ranges that continue each other has led."""

    tracker: VelocityTracker
    measured: Measured  # the newest sweep
    position: float  # filtered range [m]
    variance: float  # of it [m^2]
    count: int  # sweeps
    begin: int  # stamp of the first [ns]
    moved: float  # since then [m]
    slack: float  # by which that may be wrong [m]
    known: bool  # the velocity was confirmed, so that `position` has no Doppler shift in it
    anchor: float = math.nan  # mean of all ranges, moved on by the phases since [m]
    anchored: int = 0  # ranges in it
    carried: float = 0.0  # path since it began [m]
    loose: float = 0.0  # by which the crane may have moved beyond it [m]
    drift: float = 0.0  # by which `position` has left it beyond chance [m]
    scatter: tuple[float, ...] = ()  # newest innovations over their standard deviations


@dataclasses.dataclass(frozen=True)
class State:
    """What is known about a pair's movement after a sweep."""

    main: Track
    other: Track | None = None  # ranges that do not continue the main track, but each other
    seen: int = 0  # stamp of the newest sweep [ns]
    suspect: int = 0  # sweeps that did not continue the main track, less those since that did
    doubt: float = 0.0  # by which the main track may be wrong, since it took over from another [m]


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a sweep's range is worth."""

    motion: Motion
    verdict: Verdict
    gate: float  # innovation that would have been refused [m]
    scale: float = 1.0  # of the innovations over what the standard deviations say


def begin(measured: Measured, limits: Limits) -> tuple[State, Outcome]:
    """Return the state after the first sweep, which nothing can test."""
    track, motion = _fresh(measured, limits)
    return State(track, seen=measured.stamp), Outcome(motion, PASSED, math.inf)


def follow(state: State, measured: Measured, limits: Limits, settings: IntegritySettings) -> tuple[State, Outcome]:
    """Return the state after a sweep, and what its range is worth.

    Args:
        state: after the sweep before.
        measured: the sweep, with a later stamp.
        limits: of the crane.
        settings: of the monitor.
    """
    if (measured.stamp - state.seen) * 1e-9 > settings.restart_pause:
        tracker, motion = _updated(state.main.tracker, measured, restart=True)
        return State(_track(tracker, measured, motion), seen=measured.stamp), Outcome(motion, PASSED, math.inf)
    scale = _scale(state.main.scatter)
    continued = _continued(state.other, measured, limits)
    together = _same_phases(state.other, continued, measured, limits)
    track, motion, innovation, std, slack = _extended(state.main, state.other, measured, limits)
    lag = _lag(state.main, track.known, measured, limits)
    gate = GATE * max(scale, 1.0) * std + slack + lag
    if not settings.monitor:
        return State(track, None, measured.stamp), Outcome(motion, PASSED, gate, scale)
    verdict = _scatter_verdict(scale, measured.std)
    if state.doubt > 0.0:
        verdict &= Verdict(Decision.DOUBTFUL, Test.CONTINUITY, state.doubt)
    if together and continued is not None:
        fits, suspect = _joined(state.main, continued, limits), 0
    else:
        fits, suspect = _phases_continue(state.main, track, measured, limits), max(state.suspect - 1, 0)
    if fits and abs(innovation) <= gate:
        # however it is distributed, an error as large as the innovation stays within its standard deviation
        if track.drift > 0.0:
            verdict &= Verdict(Decision.DOUBTFUL, Test.CONTINUITY, track.drift)
        least = (abs(innovation) - slack) / _LARGEST_SHARE
        if least > math.hypot(measured.std, measured.doubt, verdict.std):
            verdict = dataclasses.replace(verdict, std=math.hypot(verdict.std, least))
        # it may as well belong to neither, or fit by chance
        if suspect > 0 or (state.other is not None and slack > _LARGEST_SHARE * std):
            verdict &= refuse(Test.CONTINUITY)
        doubt = state.doubt
        if _contradicted(state) and abs(innovation) > gate - slack:
            doubt = math.hypot(doubt, abs(innovation) + slack)
        return State(track, None, measured.stamp, suspect, doubt), Outcome(motion, verdict, gate, scale)
    other = continued or _branch(state.main, measured)
    verdict &= refuse(Test.CONTINUITY)
    if _takes_over(state.main, other, innovation, measured.resolution, settings):
        motion = other.tracker.coast(measured.stamp)
        doubt = _doubt_after(state, innovation, slack, measured.resolution)
        return State(other, None, measured.stamp, doubt=doubt), Outcome(motion, verdict, gate, scale)
    main = state.main
    if other.count == 1:  # it continues nothing: scatter, not another path
        main = dataclasses.replace(main, scatter=track.scatter)
    suspect = min(state.suspect + 1, _MOST_SUSPECT)
    return State(main, other, measured.stamp, suspect, state.doubt), Outcome(motion, verdict, gate, scale)


def _contradicted(state: State) -> bool:
    """Return whether so many ranges did not continue the main track that one which fits may be one of them.

    Meanwhile the crane may have moved by metres, and what contradicted the track is within reach of it.
    """
    return state.suspect >= _SUPPORT or (state.other is not None and state.other.count >= _SUPPORT)


def _phases_continue(before: Track, after: Track, measured: Measured, limits: Limits) -> bool:
    """Return whether the carrier phase of a settled track went on, or cannot show that it did not.

    Phases are a hundred times as accurate as ranges, and what is wrong with a sweep leaves them anywhere within a half
    wavelength.
    """
    return before.count < _SETTLED or _same_phases(before, after, measured, limits) is not False


def _same_phases(before: Track | None, after: Track | None, measured: Measured, limits: Limits) -> bool | None:
    """Return whether a sweep's carrier phase follows a track's as the largest acceleration allows; None if unknown."""
    if before is None or after is None or not (before.known and after.known):
        return None
    step = (measured.stamp - before.measured.stamp) * 1e-9
    velocity, displacement = before.tracker.coast(measured.stamp).velocity, after.tracker.last_step()
    if step > _LONGEST_PHASE_STEP or not math.isfinite(displacement - velocity):
        return None  # ranges alone must do
    most = _PHASE_ACCELERATION * limits.acceleration * step**2 + _PHASE_SHARE * measured.std
    most += limits.acceleration * before.tracker.coasted * step
    return abs(displacement - velocity * step) <= most


def _joined(main: Track, other: Track, limits: Limits) -> bool:
    """Return whether another track, whose phases go on, turns out to be the main one after a break of the phases.

    What broke them may have moved the ranges by less than one of them shows; the mean of many shows it.
    """
    if other.count < _MEAN_LENGTH:
        return False
    gap = (other.begin - main.measured.stamp) * 1e-9
    displacement, slack = _coasted(main.tracker.coast(other.begin), gap, limits)
    offset = other.position - (main.position + displacement + other.moved)
    return abs(offset) <= GATE * math.sqrt(main.variance + other.variance) + slack + other.slack


def _takes_over(main: Track, other: Track, innovation: float, resolution: float, settings: IntegritySettings) -> bool:
    """Return whether the other track is the one to follow.

    The direct path is the shortest, so a steady shorter range replaces a longer one. A longer one may be an echo behind
    a blocked path: it replaces the shorter one after long, and then in doubt; so does one nearer than the resolution.
    """
    if not other.known or _scale(other.scatter) > _SCATTER_DOUBT:
        return False
    if other.count >= _SUPPORT and main.count < _SUPPORT:
        return True
    needed = settings.shorter_time if innovation < resolution else settings.longer_time
    steady = (other.measured.stamp - other.begin) * 1e-9 >= needed and other.count >= _STEADY
    return steady and (innovation < resolution or settings.longer_time > 0.0)


def _doubt_after(state: State, innovation: float, slack: float, resolution: float) -> float:
    """Return by how much a track may be wrong that takes over from another, whose prediction it misses by `innovation`.

    One of both is right, and where it is not known which, the error is at most their difference. Only a range that is
    shorter by more than another line could hide is another path, and the direct one.
    """
    if state.main.count < _SUPPORT:
        return state.doubt
    if innovation < -resolution:
        return state.doubt if state.doubt < resolution else 0.0  # a longer path that was followed has ended
    return math.hypot(state.doubt, abs(innovation) + slack + state.main.drift)


def _continued(track: Track | None, measured: Measured, limits: Limits) -> Track | None:
    """Return a track with a sweep whose range continues it, else None."""
    if track is None:
        return None
    extended, _, innovation, std, slack = _extended(track, None, measured, limits)
    lag = _lag(track, extended.known, measured, limits)
    return extended if abs(innovation) <= GATE * std + slack + lag else None


def _branch(main: Track, measured: Measured) -> Track:
    """Return another track that begins with a sweep: the crane moves on as before, wherever the range has gone."""
    tracker, motion = _updated(main.tracker.branch(), measured)
    return _track(tracker, measured, motion)


def _fresh(measured: Measured, limits: Limits) -> tuple[Track, Motion]:
    tracker, motion = _updated(VelocityTracker(limits.velocity, limits.acceleration), measured)
    return _track(tracker, measured, motion), motion


def _track(tracker: VelocityTracker, measured: Measured, motion: Motion) -> Track:
    """Return the track that begins with a sweep."""
    position, variance = _corrected(measured, motion), measured.std**2
    return Track(tracker, measured, position, variance, 1, measured.stamp, 0.0, 0.0, _known(motion))


def _updated(tracker: VelocityTracker, measured: Measured, restart: bool = False) -> tuple[VelocityTracker, Motion]:
    """Return a copy of a tracker that has taken in a sweep, and the velocity."""
    copied = tracker.copy()
    if restart:
        copied.restart()
    motion = copied.update(measured.stamp, measured.path, measured.standing_range, measured.std, measured.index)
    return copied, motion


def _corrected(measured: Measured, motion: Motion) -> float:
    velocity = motion.velocity if math.isfinite(motion.velocity) else 0.0
    return measured.standing_range - measured.doppler * velocity


def _extended(
    track: Track, other: Track | None, measured: Measured, limits: Limits
) -> tuple[Track, Motion, float, float, float]:
    """Return the track with a sweep in it, the velocity, the innovation [m], its standard deviation, and its slack.

    The slack is how far the crane may have moved beyond what is known. Where the carrier phases were followed it is
    nothing; where the velocity alone is known, what the largest acceleration does; else what the largest velocity does.
    While another track goes on, its phases show how the crane moves since it began.
    """
    step = (measured.stamp - track.measured.stamp) * 1e-9
    tracker, motion = _updated(track.tracker, measured, restart=track.measured.setting != measured.setting)
    displacement, prior = _by_phases(tracker, measured.path), track.tracker.coast(measured.stamp)
    if not _known(motion) and _known(prior):  # a range that has jumped says nothing about the velocity
        tracker, motion = _updated(track.tracker.branch(), measured)
        displacement = math.nan
    slack, known = 0.0, _known(motion)
    if other is not None:
        tracker, motion, displacement, slack = _beside(track, other, measured, limits, (tracker, motion))
        known = _known(motion)
    elif not (known and track.known) or not math.isfinite(displacement):
        displacement, slack = _coasted(prior, step, limits)
    settled = known and track.known
    if not settled:
        slack += abs(measured.doppler) * limits.velocity
    velocity_std = measured.doppler * motion.velocity_std if known and math.isfinite(motion.velocity_std) else 0.0
    own = math.hypot(measured.std, velocity_std, measured.doubt)
    predicted = track.position + displacement
    variance = track.variance + (slack / 3.0) ** 2
    innovation = _corrected(measured, motion) - predicted
    std = max(math.sqrt(track.variance + own**2), 1e-9)
    gain = max(variance / (variance + own**2 + 1e-18), _SMALLEST_GAIN) if settled else 1.0
    position, variance = predicted + gain * innovation, (1.0 - gain) ** 2 * variance + (gain * own) ** 2
    lag = _lag(track, known, measured, limits)
    beyond = min(max(abs(innovation) - slack - lag, 0.0) / std, _LARGEST_Z)
    own = math.hypot(own, measured.lasting)
    newest = predicted + innovation, own
    anchor, anchored, carried, loose, drift = _anchored(track, (position, variance), (displacement, slack), newest, lag)
    extended = Track(
        tracker,
        measured,
        position,
        variance,
        track.count + 1,
        track.begin,
        track.moved + displacement,
        track.slack + slack,
        known,
        anchor,
        anchored,
        carried,
        loose,
        drift,
        (*track.scatter, beyond)[-_SCATTER_LENGTH:],
    )
    return extended, motion, innovation, std, slack


def _anchored(
    before: Track, filtered: tuple[float, float], moved: tuple[float, float], newest: tuple[float, float], lag: float
) -> tuple[float, int, float, float, float]:
    """Return a track's anchor moved on, and by how much the filtered range has left it: `Track.anchor` to `drift`.

    A second line that rises slowly within the resolution pulls the range away, sweep by sweep by less than its noise.
    The phase moves by millimetres at most meanwhile. The mean stays as it was while the ranges are away from it.
    It goes on where the mode changes, so that both modes must agree on one distance.

    Args:
        before: the track.
        filtered: its range with one sweep more [m], and the variance of it [m^2].
        moved: displacement since, by the phases or coasted, and its slack [m].
        newest: range of the sweep, and its standard deviation [m].
        lag: of its velocity, as `_lag` [m].
    """
    (position, variance), (displacement, slack), (distance, std) = filtered, moved, newest
    anchor, carried, loose = before.anchor + displacement, before.carried + abs(displacement), before.loose + slack
    count = min(before.anchored + 1, _ANCHOR_LENGTH)
    difference, error = position - anchor, abs(distance - anchor)
    systematic = lag + _SCALE_ERROR * carried + loose
    allowed = _DRIFT * std + GATE * math.sqrt(variance + std**2 / count) + systematic
    left = abs(difference) > allowed or error > GATE * std * math.sqrt(1.0 + 1.0 / count) + systematic
    if before.anchored >= _SCATTER_MINIMUM and left:
        return anchor, before.anchored, carried, loose, max(abs(difference), error) + loose
    if loose > std or not before.anchored:  # the phases broke for so long that the crane may have moved
        return position, 1, 0.0, 0.0, 0.0
    kept = 1.0 - 1.0 / count
    return anchor + difference / count, count, kept * carried, kept * loose, 0.0


def _by_phases(tracker: VelocityTracker, path: PathDelay) -> float:
    """Return the displacement between the last two sweeps in wavelengths of the carrier that crossed the path [m]."""
    return tracker.last_step() * (path.center_frequency / path.phase_frequency)


def _beside(
    track: Track, other: Track, measured: Measured, limits: Limits, own: tuple[VelocityTracker, Motion]
) -> tuple[VelocityTracker, Motion, float, float]:
    """Return (tracker, velocity, displacement [m], slack [m]) since a track's last sweep while another one goes on.

    The crane came from the one to the other, and on as the other's phases show.
    """
    gap = (other.begin - track.measured.stamp) * 1e-9
    displacement, slack = _coasted(track.tracker.coast(other.begin), gap, limits)
    following, motion, innovation, std, room = _extended(other, None, measured, limits)
    if other.known and following.known and abs(innovation) <= GATE * std + room:
        return following.tracker, motion, displacement + following.moved, slack + following.slack
    last = (measured.stamp - other.measured.stamp) * 1e-9
    further, more = _coasted(other.tracker.coast(measured.stamp), last, limits)
    return *own, displacement + other.moved + further, slack + other.slack + more


def _lag(before: Track, known: bool, measured: Measured, limits: Limits) -> float:
    """Return by how much a velocity that has just begun to change may displace a range of a followed track [m]."""
    if not (before.known and known):
        return 0.0
    step = min((measured.stamp - before.measured.stamp) * 1e-9, _LONGEST_PHASE_STEP)
    return _LAG * limits.acceleration * abs(measured.doppler) * step


def _known(motion: Motion) -> bool:
    return motion.confirmed and math.isfinite(motion.velocity)


def _coasted(motion: Motion, time: float, limits: Limits) -> tuple[float, float]:
    """Return how far the crane came in `time` [s], and how far off that may be, (displacement, slack) [m]."""
    if motion.confirmed and math.isfinite(motion.velocity):
        return motion.velocity * time, min(0.5 * limits.acceleration * time**2, limits.velocity * abs(time))
    return 0.0, limits.velocity * abs(time)


def _scale(scatter: tuple[float, ...]) -> float:
    """Return the scatter of the newest innovations over what their standard deviations say."""
    if len(scatter) < _SCATTER_MINIMUM:
        return 1.0
    return sorted(scatter)[len(scatter) // 2] / _MEDIAN


def _scatter_verdict(scale: float, std: float) -> Verdict:
    if scale > _SCATTER_REFUSAL:
        return refuse(Test.SCATTER)
    if scale > _SCATTER_DOUBT:
        return Verdict(Decision.DOUBTFUL, Test.SCATTER, std * math.sqrt(scale**2 - 1.0))
    return PASSED


def coasting(state: State, stamp: int) -> Motion:
    """Return the velocity at a stamp [ns] without taking in a sweep."""
    return state.main.tracker.coast(stamp) if state else UNKNOWN
