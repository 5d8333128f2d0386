"""Constants of recordings and their groups, with units; "chosen" is a judgement that only tests have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class GroupLimits:
    """Which sweeps are taken together."""

    pause: float = 2.0
    """Pause between sweeps after which a new group begins, if longer than five intervals [s]; chosen."""

    fastest: float = 10.0
    """Change of the reference that is another distance and no drive [m/s]; chosen."""

    still: float = 0.05
    """By which a standing crane's reference may change beyond its noise [m]; chosen."""

    peak: float = 8.0
    """Largest difference of readings within a group, in standard deviations of the reference; chosen."""

    bent: float = 4.0
    """Standard deviations from which on an acceleration is more than noise; chosen."""

    smallest: int = 6
    """Sweeps of a driving crane's group that is not cut further; chosen."""

    most: int = 24
    """Sweeps of a driving crane that are taken together, at most; chosen."""

    pairing: int = 1_000_000_000
    """Difference of both stations' stamps of one sweep, at most [ns]; chosen."""

    steady: float = 60.0
    """Time in which weather and temperatures count as steady [s]; chosen."""

    mad_to_std: float = 1.4826
    """Standard deviation over the median absolute value of normal noise [1]; derived."""


@dataclasses.dataclass(frozen=True)
class LineLimits:
    """How lines are measured."""

    far: float = 1.0
    """Delay at which the sign of a beat frequency is beyond doubt [s]; chosen."""

    chunk: int = 512
    """Sweeps estimated at once, which bounds the memory; chosen."""


@dataclasses.dataclass(frozen=True)
class ThinningLimits:
    """How much of a long recording is compared."""

    groups: int = 40
    """Groups, at most; chosen: the search takes a minute with so many."""

    sweeps: int = 48
    """Sweeps of a group, at most; chosen: noise then still hides the errors of the forward models."""

    samples: int = 32768
    """Samples of a sweep that a station hears of itself, at most; chosen: the search takes a minute with so many."""

    delays: float = 2.0
    """Delays of the line that these cover at least [1]; chosen: an echo must be heard for most of them."""


@dataclasses.dataclass(frozen=True)
class EndLimits:
    """Where a ramp counts as not running."""

    sweeps: int = 512
    """Sweeps of one setting whose power is looked at, at most; chosen."""

    smooth: int = 8
    """Neighbouring samples whose power is averaged; chosen."""

    silent: float = 0.25
    """Power over that of the median sample, below which nothing is received [1]; chosen."""

    near: float = 4.0
    """Samples that may be silent next to the analysis window's own end [samples]; chosen."""

    margin: int = 16
    """Samples next to a silent end that are left out as well; chosen."""

    most: float = 0.75
    """Share of the analysis window that silent ends may take; chosen: beyond it there is no ramp."""


ENDS = EndLimits()
GROUPS = GroupLimits()
LINES = LineLimits()
THINNING = ThinningLimits()
