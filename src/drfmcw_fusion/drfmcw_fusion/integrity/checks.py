"""Tests of one sweep by itself: T_off, powers, noise. Derivations and probabilities: docs/integrity.md."""

import dataclasses
import enum
import math

from drfmcw_node.estimators.estimation import Flag as BeatFlag
from drfmcw_physics.link_budget import free_space_loss
from drfmcw_physics.sweep import SweepSettings

from ..combination import PathDelay, Station
from .settings import IntegritySettings

NOISE_FACTOR = 5.0
"""Standard deviations of noise that a test grants beyond its tolerance: 6e-7 of false alarms."""

_OFF_WINDOW = 500.0  # path that the sample clocks' error adds to a clock error's scale [m]
_CHIRP_STD = 1.5e-4  # error of a maximum-likelihood line smeared over one bin, growing with the fourth power [m]
_SCATTER = 4.34  # one standard deviation of a power in dB is 4.34 sqrt(2 / SNR) dB


class Test(enum.IntFlag):
    """Tests that a range failed (bits of RangeEstimate.failed_tests)."""

    NONE = 0
    START_DELAY = 1
    CLOCKS = 2
    POWER = 4
    BALANCE = 8
    NOISE = 16
    REPEATED = 32
    STAMPS = 64
    UNLOCKED = 128
    CONTINUITY = 256
    SCATTER = 512
    LATE = 1024
    STRAIGHT = 2048


class Decision(enum.IntEnum):
    """What becomes of a range; the worst of all tests counts."""

    VALID = 0
    DOUBTFUL = 1
    REFUSED = 2


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Outcome of tests."""

    decision: Decision = Decision.VALID
    failed: Test = Test.NONE
    std: float = 0.0  # to add to the range's, as a square [m]

    def __and__(self, other: 'Verdict') -> 'Verdict':
        """Return the outcome of both."""
        if other is PASSED:
            return self
        if self is PASSED:
            return other
        return Verdict(max(self.decision, other.decision), self.failed | other.failed, math.hypot(self.std, other.std))


PASSED = Verdict()


def refuse(test: Test) -> Verdict:
    """Return the verdict of a failed test that makes the range useless."""
    return Verdict(Decision.REFUSED, test)


def start_delay(
    first: Station, second: Station, path: PathDelay, distance: float, settings: IntegritySettings
) -> tuple[Verdict, float]:
    """Return the verdict on T_off, and by how much it exceeds its nominal value [s].

    T_off is in the sum of what the difference of both lines gives the range. A line that is not the peer's, another
    mode or other settings shift it by as much time as they shift the delay. A difference of the references does as
    well, by f_c / k per unit; where both powers say that the lines are the peer's, it is taken for that.
    """
    sweep = first.sweep
    excess = path.start_delay_excess
    rate = abs(sweep.chirp_rate)
    noise = NOISE_FACTOR * math.hypot(first.beat.frequency_std, second.beat.frequency_std) / (2.0 * rate)
    if abs(excess) <= settings.start_delay_tolerance + noise:
        return PASSED, excess
    clocks = max(abs(excess) - settings.start_delay_tolerance, 0.0) * rate / sweep.center_frequency
    if clocks > 1e-6 * settings.clock_tolerance:
        return refuse(Test.START_DELAY), excess
    smear = 2.0 * rate * clocks * sweep.ramp_duration**2
    std = 0.5 * clocks * (abs(distance) + _OFF_WINDOW) + _CHIRP_STD * smear**4
    return Verdict(Decision.DOUBTFUL, Test.CLOCKS, std), excess


def powers(first: Station, second: Station, distance: float, settings: IntegritySettings) -> Verdict:
    """Return the verdict on both received powers, against the link budget and against each other."""
    excess = [_over_budget(own, peer.sweep, distance) for own, peer in ((first, second), (second, first))]
    known = [value for value in excess if math.isfinite(value)]
    verdict = PASSED
    if any(not -settings.loss_tolerance <= value <= settings.gain_tolerance for value in known):
        verdict &= refuse(Test.POWER)
    if len(known) < 2:
        return verdict
    scatter = _SCATTER * math.hypot(*(math.sqrt(2.0) * 10.0 ** (-s.beat.snr / 20.0) for s in (first, second)))
    difference = abs(known[0] - known[1]) - NOISE_FACTOR * scatter
    if difference > 2.0 * settings.balance_tolerance:
        verdict &= refuse(Test.BALANCE)
    elif difference > settings.balance_tolerance:
        verdict &= Verdict(Decision.DOUBTFUL, Test.BALANCE)
    return verdict


def noise(station: Station, settings: IntegritySettings) -> Verdict:
    """Return the verdict on a station's noise level; what the level itself does is in the standard deviation."""
    density = station.beat.power - station.beat.snr + 10.0 * math.log10(station.sweep.ramp_duration)
    excess = density - station.calibration.noise_floor
    if math.isfinite(excess) and excess > settings.noise_tolerance:
        return Verdict(Decision.DOUBTFUL, Test.NOISE)
    return PASSED


def straight(station: Station) -> Verdict:
    """Return the verdict on a station's own line: no straight ramp makes it vary over the sweep as it does.

    What that may do to the range is in the standard deviation of the line already.
    """
    if station.beat.flags & BeatFlag.MODEL_MISMATCH:
        return Verdict(Decision.DOUBTFUL, Test.STRAIGHT)
    return PASSED


def _over_budget(own: Station, peer: SweepSettings, distance: float) -> float:
    """Return the received power over that of free space [dB]; NaN where it is not known."""
    if not (math.isfinite(distance) and math.isfinite(own.beat.power)):
        return math.nan
    loss = float(free_space_loss(max(distance, 1.0), own.sweep.center_frequency))
    return own.beat.power - (peer.tx_eirp + own.sweep.rx_antenna_gain - loss)
