"""Constants of the measured remainder, with units; "chosen" is a judgement that only the tests have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class LearningLimits:
    """How smooth a curve is, and when there is one."""

    folds: int = 4
    """Parts of each group's sweeps, blocked in time, of which each is predicted by the others; chosen."""

    stiffness: tuple[float, ...] = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
    """Weight of a spline's squared second derivative over the covariate's span, over the mean weight of the data [1];
    chosen: from nearly a straight line to nearly the data."""

    free: float = 1e-9
    """The same of a curve with a value of its own at each point of the covariate [1]; chosen."""

    alike: float = 1e-3
    """Of a covariate's span [1], within which its values are one point; chosen."""

    beyond_chance: float = 4.0
    """Standard deviations by which the gain on held-out sweeps must exceed that of noise; chosen."""

    as_good: float = 2.0
    """Standard deviations of the gain within which the smoother curve is taken; chosen."""

    rounds: int = 2
    """Times that a curve is corrected by what its simulation shows; chosen: each leaves a tenth."""

    narrow: float = 5.0
    """Standard deviations from which on a bin of the spectrum holds more than noise; chosen: 0.0003 of 1000 bins by
    chance."""

    envelope: int = 8
    """Terms of the envelope by which a line is taken out of the samples; chosen."""

    neighbours: int = 31
    """Cosine terms that share a variance from sweep to sweep; chosen."""

    least_floor: float = 0.05
    """Share of the additive noise that a measured remainder leaves, at least [1]; chosen."""

    probe: float = 1e-3
    """Phase by which a response is changed to see how it shows in the features [rad]; chosen: small enough to be
    linear."""

    chunk: int = 32
    """Sweeps whose lines are fitted together; chosen: some 10 MB."""

    deconvolved: int = 20
    """Iterations by which the window's width is taken out of a spectrum; chosen."""


LEARNING = LearningLimits()
