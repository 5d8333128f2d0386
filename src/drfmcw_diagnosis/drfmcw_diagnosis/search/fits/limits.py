"""Constants of fits, with units; "chosen" is a judgement that only the tests and the proof have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class FitLimits:
    """How parameters are fitted."""

    unfelt: float = 1e-9
    """Eigenvalue of a common model error [variances], below which it changes nothing; chosen."""

    flat: float = 1e-30
    """Curvature of a misfit that a parameter does not change [1]; chosen."""

    gained: float = 0.1
    """Gain of a step [1] below which a fit ends: the next would gain far less; chosen."""

    gained_at_first: float = 0.5
    """The same while effects are compared, which differ by far more [1]; chosen."""

    gained_share: float = 1e-5
    """The same over the misfit [1], if that is more; chosen."""

    gained_of_left: float = 1e-3
    """The same over what the misfit is beyond chance [1], while effects are compared; chosen."""

    as_promised: float = 0.9
    """Share of the gain that slopes promise which a step must gain for them to be used again, updated by what it did
    [1]; chosen."""

    as_promised_at_first: float = 0.5
    """The same while effects are compared [1]; chosen."""

    promised: float = 2.0
    """Gain that such slopes promise over the one below which a fit ends [1], from which on they are determined anew
    before it ends; chosen."""

    stride: float = 2.0
    """Standard deviations of the data by which a step of a numerical derivative may change a template; chosen: the
    phase of a moving crane turns within a few."""

    shortened: float = 0.25
    """The same of a step that was too long; chosen."""

    shorter: int = 2
    """Times, at most, that such a step is made shorter; chosen."""

    steps: int = 12
    """Steps of Levenberg and Marquardt's method, at most; chosen."""

    rounds: int = 4
    """Times, at most, that a distortion is computed anew on the other effects as they were fitted; chosen."""

    settled: float = 0.5
    """Squared change of a template [1] by a distortion computed anew, below which it need not be again; chosen."""

    settled_share: float = 1e-3
    """The same over the misfit [1], if that is more; chosen."""

    linear: float = 5.0
    """Standard deviations by which a distortion's parameters may change while its template counts as linear, and any
    parameters while slopes count as those at the end of an exact fit; chosen."""

    still: float = 0.02
    """Change of a line's log amplitude or phase [1, rad] below which a distortion of it stays as it is; chosen."""

    sweeps: float = 2.0
    """Time constant of what fades within a sweep, over the sweep's duration [1], at most: longer ones are a constant;
    chosen."""

    louder: float = 0.5
    """Change of the lines' level [dB], from which on a distortion is simulated beside it; chosen."""

    as_loud: float = 0.1
    """Change of that level [dB], below which what was simulated beside it is used again; chosen."""

    as_distorted: float = 0.01
    """The same of other distortions: squared change of what they add over its square [1]; chosen."""

    levels: int = 8
    """Such levels, and other distortions, that are remembered; chosen."""

    certain: float = 2.0
    """Standard deviations that an effect's size must have, and what makes it this effect; chosen."""


FIT = FitLimits()
