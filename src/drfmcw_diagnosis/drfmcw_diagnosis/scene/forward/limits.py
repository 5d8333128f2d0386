"""Constants of the forward model of scenes, with units; "chosen" is a judgement that only tests have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class ForwardLimits:
    """How lines are fitted to many sweeps, and how noise is measured beside them."""

    values: int = 96_000
    """Samples that lines are fitted to and held out, at most; chosen: seconds of work."""

    longest: int = 8192
    """Samples of a sweep that are described, the first ones; chosen: the same."""

    fewest: int = 32
    """Samples of a sweep from which lines are fitted; chosen."""

    dead: int = 16
    """Share of a sweep before its first echo, at most one of so many [1]; chosen."""

    first: int = 12_000
    """Samples in which lines are found first, at most; chosen: the rest only refines most of them."""

    sweeps_held: int = 6
    """Sweeps from which whole ones are held out; chosen."""

    third: int = 3
    """One sweep of so many is held out; chosen, as for features."""

    blocks: int = 100
    """Blocks of a sweep of which some are held out where sweeps are few; chosen: shorter than a beat."""

    sweeps_of_tracks: int = 8
    """Sweeps from which the frequency of a line may move over them; chosen."""

    order: int = 3
    """Legendre coefficients of a line's frequency over the sweeps; chosen: constant, even and accelerated motion."""

    drift: int = 8
    """Half cells by which a line may move from mid-recording to its ends, where it is searched; chosen."""

    most: int = 24
    """Lines, at most; chosen: seconds of work."""

    padding: int = 4
    """Points of a spectrum per resolution cell; chosen."""

    chance: float = 1e-3
    """Chance of a cell as strong as the weakest line, over all cells [1]; chosen."""

    step: float = 0.5
    """Resolution cells by which an iteration moves a line, at most [1]; chosen."""

    early: int = 3
    """Lines up to which effects are fitted to the end before a further line is looked for; chosen."""

    each: int = 3
    """Iterations after each line found; chosen."""

    final: int = 12
    """Iterations at the end, at most; chosen."""

    halvings: int = 4
    """Shorter steps tried in each; chosen."""

    settled: float = 1e-5
    """Relative change of the misfit at which a fit ends [1]; chosen."""

    still_there: float = 1e-4
    """Resolution cells by which a line may move for what effects do to it to stay the same; chosen."""

    apart: float = 0.05
    """Resolution cells over which the change of what effects do is taken; chosen."""

    straight: int = 8
    """Sets of lines whose waves without effects are kept; chosen: a fit and its derivatives need two at once."""

    fixed_points: int = 3
    """Rounds in which lines in front of a receiver that is not linear are found; chosen."""

    damping: float = 1e-4
    """Of Levenberg and Marquardt's method where a fit of effects begins [1]; chosen."""

    gentle: float = 0.1
    """Step of a numerical derivative over that of the effect's recipe [1]; chosen: lines are known better."""

    seen: float = 1e-4
    """Relative change of the samples from which on a step shows a derivative [1]; derived: samples are simulated with
    a relative error of 1e-7."""

    trials: int = 6
    """Steps tried in each iteration; chosen."""

    ridge: float = 1e-10
    """Relative ridge of the amplitudes of lines [1]; chosen: two at one frequency have no amplitudes of their own."""


@dataclasses.dataclass(frozen=True)
class WarpLimits:
    """Where a search for what bends the ramp begins."""

    values: int = 1500
    """Samples looked at, at most, but one sweep; chosen."""

    finer: int = 4
    """Points between which sweeps are interpolated, per sample; chosen."""

    held: float = 0.98
    """Share of the power below the highest frequency of lines [1]; chosen."""

    reference: float = 0.15
    """Frequency of the line whose phase shows what an effect does [1 / sample]; chosen."""

    weakest: float = 0.4
    """Phase by which the weakest bend turns the highest line [rad]; chosen: weaker ones need no such start."""

    steepest: float = 0.6
    """Relative error of the ramp's rate, at most [1]; chosen."""

    ratio: float = 0.35
    """Logarithm of the ratio of neighbouring sizes; chosen."""

    even: float = 2.0
    """Phase of the highest line between neighbouring sizes, where the ratio is finer [rad]; chosen."""

    polished: int = 4
    """Starts of one kind that are refined; chosen."""

    slow: float = 4.0
    """Periods of a ripple in a ramp below which neighbours are half as far apart; chosen: it may be strong."""

    slowest: float = 0.5
    """Periods of a ripple in a ramp, at least; chosen."""

    fastest: float = 40.0
    """The same, at most; chosen."""

    step: float = 0.5
    """The same, between neighbours; derived: half a resolution cell."""

    sharper: float = 1e-3
    """Fall of that measure from which on a start is refined; chosen."""

    near: float = 0.1
    """Relative change of parameters in which the sharpest are looked for at first [1]; chosen."""

    trials: int = 200
    """Parameters tried; chosen."""


@dataclasses.dataclass(frozen=True)
class NamingLimits:
    """When an effect of the forward model is named."""

    values: int = 6_000
    """Samples on which kinds of effects are compared, at most but two sweeps; chosen."""

    lines: int = 8
    """Lines with which kinds of effects are compared, at most; chosen."""

    weak: float = 0.25
    """Amplitude of a line over the strongest up to which it may be what an effect does to others [1]; chosen."""

    twice: int = 2
    """Times that lines are found anew with an effect; chosen."""

    better: float = 0.8
    """Misfit after that over before, from which on it is kept [1]; chosen."""

    rounds: int = 8
    """Iterations of a fit among them, at most; chosen."""

    final: int = 12
    """Iterations of the fit to all sweeps; chosen."""

    near: float = 100.0
    """Twice the logarithm of the likelihood by which a kind may be worse on some sweeps and be tried; chosen."""

    curves: int = 2
    """Free curves of the ramp's rate that are compared, those of the fewest coefficients; chosen."""

    crowded: int = 2
    """Bends of the ramp that are fitted to all lines of a scene of many; chosen."""

    finalists: int = 3
    """Kinds of effects that are tried on what is held out; chosen."""

    effects: int = 2
    """Effects at once; chosen."""

    halved: float = 0.5
    """Share of the excess misfit that an effect must take away [1]; chosen: shapes which only sharpen what is not
    understood take away less."""

    clear: float = 5.0
    """Signal-to-noise ratio of the size of an effect that all lines but one show, above which it is tested whether
    they agree [1]; chosen."""

    uneven: float = 0.05
    """Share of the squared sizes that may be scatter from line to line [1]; chosen on real radars to which ripples
    were added: of true ones 0.0002 to 0.02, of most false ones 0.2 to 1."""

    ridge: float = 1e-9
    """Relative ridge of the sizes of lines at one frequency [1]; chosen."""

    edge: float = 1e-3
    """Relative distance from a bound within which a fit ended there [1]; chosen."""

    rival: float = 7.0
    """Logarithm of the likelihood by which another explanation may be worse and still be listed; derived: 1 of 1000."""

    gain: float = 6.0
    """Logarithm of the likelihood per parameter from which on a candidate is refined; chosen."""


FORWARD = ForwardLimits()
WARPS = WarpLimits()
NAMING = NamingLimits()
