"""Ranges of a station that hears itself, one sweep after the other: no partner tests them, and no carrier phase.

In: one sweep's range. Out: whether it hops between lines, and how fast the target may go, which one ramp cannot
separate from a longer range.
"""

import collections
import math

from ..tracking import VelocityTracker
from .checks import PASSED, Decision, Test, Verdict
from .continuity import Limits, Measured

_REMEMBERED = 64  # sweeps with which one is compared
_LONGEST = 5.0  # and for how long [s]
_GATE = 5.5  # standard deviations: one of 64 comparisons exceeds it by chance once in 4e5 sweeps
_SHARE = 0.125  # of the sweeps before that a range may contradict: they are off, not this one


class OwnLine:
    """What the sweeps before say about the next one."""

    def __init__(self, limits: Limits) -> None:
        """Start with nothing known; `limits` are the target's."""
        self._limits = limits
        self._recent: collections.deque[Measured] = collections.deque(maxlen=_REMEMBERED)
        self._tracker = VelocityTracker(limits.velocity, limits.acceleration)

    def follow(self, measured: Measured) -> tuple[Verdict, float]:
        """Take in one sweep; return its verdict, and its velocity about zero as a standard deviation [m/s].

        A range that no target can have reached from an eighth of the sweeps before belongs to another line than theirs.
        Which of them is the target's is not known: the distance between them is in the standard deviation. The velocity
        is that of the ranges; as much as the limit, where there are too few or they hop.
        """
        before = [m for m in self._recent if 0.0 < (measured.stamp - m.stamp) * 1e-9 <= _LONGEST]
        self._recent.append(measured)
        apart = [measured.standing_range - m.standing_range for m in before]
        gates = [
            _GATE * math.hypot(measured.std, m.std, measured.doubt, m.doubt)
            + self._limits.velocity * (measured.stamp - m.stamp) * 1e-9
            for m in before
        ]
        hops = sum(abs(a) > gate for a, gate in zip(apart, gates, strict=True))
        motion = self._tracker.update(
            measured.stamp, measured.path, measured.standing_range, measured.std, measured.index
        )
        unknown = self._limits.velocity / math.sqrt(3.0)
        if hops > _SHARE * len(before):
            std = math.sqrt(sum(a * a for a in apart) / len(apart))
            return Verdict(Decision.DOUBTFUL, Test.CONTINUITY, std), unknown
        if not math.isfinite(motion.velocity):
            return PASSED, unknown
        return PASSED, min(math.hypot(motion.velocity, motion.velocity_std), self._limits.velocity)
