"""Constants of the watch, with units; "chosen" is a judgement that only tests have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class WindowLimits:
    """What the window keeps."""

    back: int = 10_000_000_000
    """Age over that of the newest sweep from which on a sweep shows that time was set back [ns]; chosen."""

    margin: int = 10_000_000_000
    """Time around the sweeps whose conditions are kept [ns]; chosen: the reference is interpolated between readings."""

    conditions: int = 100_000
    """Values of each kind of condition, at most, which bounds the memory; chosen."""


@dataclasses.dataclass(frozen=True)
class DrivingLimits:
    """When a crane drives."""

    certain: float = 4.0
    """Standard deviations by which a velocity differs from zero, and a distance from another; chosen."""

    standing: float = 0.01
    """Velocity of a crane that stands, at most, as sway and wind move it [m/s]; chosen."""

    spans: tuple[int, ...] = (3, 8, 24)
    """Numbers of consecutive sweeps over which the carrier's phase gives a velocity; chosen."""

    certain_phase: float = 6.0
    """Standard deviations by which such a velocity differs from zero; chosen: a window holds hundreds of them."""


@dataclasses.dataclass(frozen=True)
class NodeLimits:
    """How the node listens, and when it looks."""

    peers: int = 32
    """Peers whose settings a late subscription gets; chosen."""

    gather: float = 2e-3
    """Time in which messages are taken together [s]; chosen."""

    tick: float = 0.2
    """Time between questions whether a look is due or has ended [s]; chosen."""

    silent: float = 10.0
    """Time without sweeps after which the last verdict counts as stale [s]; chosen."""


WINDOW, DRIVING, NODE = WindowLimits(), DrivingLimits(), NodeLimits()
