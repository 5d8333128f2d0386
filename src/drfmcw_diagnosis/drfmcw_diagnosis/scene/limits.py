"""Constants of scenes, with units; "chosen" is a judgement that only tests and the recordings at hand have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class MaterialLimits:
    """How many samples are looked at."""

    values: int = 4_000_000
    """Samples looked at, at most; chosen: half a minute of work."""

    fewest: int = 8
    """Sweeps looked at, however long; chosen."""

    alike: float = 0.9
    """Power of the mean of a group's sweeps over that of each, above which their mean stands for them [1]; chosen."""

    mad_to_std: float = 1.4826
    """Standard deviation over the median absolute value of normal noise [1]; derived."""


@dataclasses.dataclass(frozen=True)
class WindowLimits:
    """Where the ramp is straight."""

    kink: float = 6.0
    """Third difference beyond its median that is a kink [1]; chosen."""

    together: int = 3
    """Kinks among five consecutive third differences from which on the ramp is off; chosen: one code may stick."""

    clear: int = 4
    """Samples between the ramp's window and the first kink: a stencil and the receiver's settling; chosen."""

    early: float = 0.1
    """Share of the record within which the window must begin [1]; chosen."""

    late: float = 0.75
    """Share of the record behind which it must end [1]; chosen."""

    dead: float = 0.08
    """Power of first differences below which nothing moves, over its median [1]; chosen: a crest has twice it."""

    above: float = 8.0
    """Power of first differences over that of noise, from which on noise is no crest [1]; derived: a crest
    then has 2.4 times that of noise."""

    alone: float = 1.5
    """Power of first differences over that of noise up to which noise is alone [1]; chosen."""

    awake: float = 0.25
    """The same from which on the signal follows the ramp again [1]; chosen."""

    least: int = 5
    """Samples outside that make a window worth a name, at each end; chosen."""


@dataclasses.dataclass(frozen=True)
class ShapeLimits:
    """How a ramp's shape is learnt from lines."""

    degree: int = 3
    """Degree of the spline; derived: that of `sweep_shape`."""

    constant: int = 15
    """Order of the slowly varying constant (Legendre); chosen, after the method's 14 to 16."""

    amplitude: int = 8
    """Order of the line's amplitude; chosen, after the same."""

    harmonic: int = 5
    """Order of the amplitudes of second and third harmonic; chosen on the GMR recordings, where 3 leaves a third
    more."""

    fewest_turns: float = 10.0
    """Periods of the line in a sweep, at least; derived: the constant's order describes up to eight."""

    most_turns: float = 0.2
    """Periods of the line per sample, at most; chosen."""

    intervals: tuple[float, ...] = (0.35, 0.7, 1.35)
    """Intervals of the spline per period of the line, coarse to fine; chosen, after the same: 8 MHz where
    a period has 11."""

    most_intervals: int = 64
    """Intervals of the spline, at most; chosen."""

    fewest_intervals: int = 4
    """Intervals of the spline, at least; chosen."""

    orders: tuple[int, ...] = (4, 6, 8, 10, 12, 12)
    """Orders of the complex amplitude that follow a line's phase, round by round; chosen: one fit from a straight ramp
    sticks."""

    near: float = 6.0
    """Periods about the strongest bin among which a straight ramp is tried; chosen."""

    loose: float = 0.3
    """Standard deviation of the phase that was followed [rad]; chosen: it only starts the fit."""

    rounds: int = 40
    """Iterations of a fit, at most; chosen."""

    ridge: float = 0.06
    """Standard deviation of the relative rate that is expected [1]; chosen, after the same."""

    hold: int = 16
    """Samples of a block that is held out; chosen."""

    every: int = 5
    """One block of so many is held out; chosen."""

    least: float = 0.005
    """Root mean square of the relative rate below which other effects describe the ramp as well [1]; chosen."""

    gain: float = 0.6
    """Held-out misfit after over before, rms, above which a shape does not help; chosen."""

    share: float = 0.5
    """Held-out power of a line's residual over the line's, above which it is no single line; chosen."""

    items: int = 6
    """Sweeps or averages from which a shape is learnt together, at most; chosen."""

    strong: float = 0.3
    """Share of the power that a line holds with its surroundings, at least [1]; chosen."""

    fewest_samples: int = 400
    """Samples of a sweep from which a shape is learnt; derived: 25 per order of the constant."""

    slowest: float = 0.02
    """Relative rate that a scenario is given at least [1]; chosen: a ramp does not turn back."""

    rest: float = 0.02
    """Power that a shape leaves of a line on what is held out, above which it was no single line [1]; chosen."""

    longest: int = 8000
    """Samples of a sweep that are fitted, at most; longer ones are averaged in spans; chosen."""

    settled: float = 1e-7
    """Relative change of a delay at which its fit ends; chosen."""

    fit: float = 1e-4
    """Relative change of the misfit at which a fit ends; chosen."""


@dataclasses.dataclass(frozen=True)
class RailLimits:
    """When samples stand at a limit."""

    widths: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    """Outermost codes taken together, up to four standard deviations of the noise and at least 8 [LSB]; chosen."""

    outliers: tuple[int, ...] = (0, 12, 48)
    """Samples that may lie beyond a rail, as a filter behind it makes them; chosen."""

    beyond: float = 0.25
    """Samples beyond a rail over those at it, at most [1]; chosen: more belong to a higher crest."""

    beside: int = 4
    """Codes compared, in widths; chosen."""

    excess: float = 3.0
    """Count at the rail over that beside it, per four widths, above which they pile up; derived: the crest of a sine
    has 0.8."""

    wall: float = 10.0
    """Count at the last code over that in the four codes beside it, from which on nothing but a limit explains it;
    derived: noise of half a code leaves at most 3."""

    noisy: float = 0.5
    """Noise for that, at least [LSB]; chosen."""

    least: int = 500
    """Numbers of a recording from which rails are looked for; chosen."""

    steeper: float = 2.0
    """Fall of the signal beside the rail over that from a crest, at least [1]; chosen."""

    fewest: int = 12
    """Samples at a rail, at least; chosen."""

    share: float = 5e-4
    """Share of the samples at a rail, at least [1]; chosen: 3 of 2000 may be chance."""

    high: float = 0.6
    """Level of a rail over the outermost value, at least [1]; chosen."""

    usual: float = 0.75
    """Quantile of the roughness that counts as usual [1]; chosen: a limiter may hold half of the samples."""

    smooth: float = 0.15
    """Roughness below which a run of samples is a plateau, over the usual one [1]; chosen."""

    run: int = 24
    """Samples of a plateau, at least; chosen: noise is never so smooth for so long."""

    plateaus: float = 0.03
    """Share of the samples on plateaus, at least [1]; chosen."""

    outer: float = 0.35
    """Level of plateaus over the outermost value, at least [1]; chosen: a dead receiver rests near zero."""


@dataclasses.dataclass(frozen=True)
class BurstLimits:
    """When the power of some sweeps is that of another transmitter."""

    order: int = 32
    """Samples from which the next one is predicted: what no line and no echo makes is left; chosen."""

    block: int = 8
    """Samples over which the power is averaged; chosen."""

    peak: float = 8.0
    """Power over its median at this time of the sweep; derived: noise exceeds it in fewer than 1e-20 of the blocks."""

    fewest: int = 8
    """Sweeps from which bursts are separated from what all sweeps have; chosen."""

    hit: int = 3
    """Sweeps with a burst, at least; chosen."""

    often: float = 0.9
    """Share of the sweeps above which it is no burst [1]; chosen."""

    above: float = 2.0
    """Power of a burst over that at the same time of other sweeps, at least [1]; chosen."""

    contrast: float = 2.0
    """Mean power over its median in all blocks without a burst, above which the whole recording is uneven; chosen."""


@dataclasses.dataclass(frozen=True)
class ImageLimits:
    """When an image at -f is the receiver's."""

    least: float = 10.0 ** (-45.0 / 20.0)
    """Image over line, in amplitude, below which nothing is named [1]; chosen."""

    sigma: float = 6.0
    """Standard deviations from which on an image is no chance; chosen."""

    lines: int = 8
    """Cells of range and Doppler shift that are compared, at most; chosen."""

    strong: float = 30.0
    """Power of a cell over the median of all [dB], at least; chosen."""

    moving: int = 3
    """Doppler cells off zero from which on a line moves; chosen."""

    beside: float = 0.1
    """Power of a moving line over the strongest at its distance, at least [1]; chosen."""

    agree: float = 0.25
    """Scatter of the image from line to line over its mean, at most [1]; chosen."""


@dataclasses.dataclass(frozen=True)
class BackgroundLimits:
    """What repeats with the ramp."""

    fewest: int = 24
    """Sweeps from which a background is learnt; chosen."""

    cells: int = 2
    """Bins from 0 Hz in which leakage stands: it comes from closer than two resolution cells; chosen."""

    above: float = 12.0
    """Level of leakage over the strongest line, at least [dB]; chosen: receivers have a constant of their own."""

    values: int = 1_000_000
    """Samples that a measured remainder holds, at most, of sweeps spread over the recording; chosen: some megabytes."""

    silent: float = -100.0
    """Power sent and gain of an antenna that hears nothing beside a measured remainder [dBm, dBi]; derived: the lowest
    that a scenario accepts."""

    components: int = 6
    """Patterns over the ramp that vary from sweep to sweep, at most; chosen."""

    helps: float = 0.9
    """Held-out misfit, rms, after a further pattern over before, at most [1]; chosen."""


@dataclasses.dataclass(frozen=True)
class TrackLimits:
    """How a moving line is followed."""

    together: int = 4
    """Sweeps whose powers are averaged, at least; chosen."""

    most: int = 100
    """Points of a track, about; chosen."""

    padding: int = 4
    """Length of a spectrum over the sweep's [1]; chosen."""

    cells: int = 2
    """Bins from 0 Hz that are left out; chosen."""

    above: float = 20.0
    """Level of a line over the median, at least [dB]; chosen."""

    apart: tuple[int, ...] = (1, 4, 16, 64)
    """Sweeps between those that are compared, of which the fewest are taken that show a clear line; chosen."""

    clear: float = 6.0
    """Level of a line below that of the clearest among them, at most [dB]; chosen."""

    fainter: float = 15.0
    """Level of a line below its usual one at which it is not there, more of a target that stops [dB]; chosen."""

    turn: float = 4.0
    """Level that a line must gain to move by one point of the spectrum from one of the track to the next [dB];
    chosen."""

    mostly: float = 0.7
    """Share of the time in which a line must stand out [1]; chosen."""


@dataclasses.dataclass(frozen=True)
class SideLimits:
    """On which side of 0 Hz lines are expected."""

    cells: int = 4
    """Bins from 0 Hz that are left out; chosen."""

    above: float = 10.0
    """Level of the other side's line over the expected one's [dB]; chosen, as at the import."""


@dataclasses.dataclass(frozen=True)
class JudgeLimits:
    """When a scene is judged, and how."""

    strong: float = 30.0
    """Misfit per degree of freedom of one line on a straight ramp, above which its samples are searched as well as its
    features; chosen: their search takes seconds, and features of what is no line mislead."""

    certain: float = 1e-300
    """Chance that is stated at least [1]; chosen: smaller ones are no numbers."""

    alike: float = 2.0
    """Held-out misfit with a shared shape over that with an own one [1], below which recordings are of one radar;
    chosen."""

    sweeps: int = 64
    """Sweeps of which the spectra are looked at; chosen."""

    skirt: int = 6
    """Bins on either side that belong to a line or to 0 Hz; chosen."""

    fewest_samples: int = 256
    """Samples of a sweep from which features are compared; derived: they need bins beside the line."""

    single: float = 0.9
    """Share of the power in one line from which on there is no scene [1]; chosen."""

    shown: int = 5
    """Lines whose paths are said, at most; chosen."""

    fitted: float = 2.0 / 3.0
    """Share of the sweeps that is fitted [1]; chosen, as for features."""


@dataclasses.dataclass(frozen=True)
class LineLimits:
    """How many lines describe a sweep, and how they are refined."""

    most: int = 24
    """Lines of a sweep, at most; chosen: seconds of work."""

    items: int = 6
    """Sweeps or means of groups that are described; chosen."""

    longest: int = 65_536
    """Samples of a sweep that are described, the first ones; chosen: memory."""

    blocks: int = 100
    """Blocks of a sweep of which some are held out; chosen: a hole shorter than the finest line's beat."""

    helps: float = 0.02
    """Share by which lines must lower the held-out mean square [1]; chosen."""

    patience: int = 12
    """Lines in turn that may not help before no more are tried; chosen: of many layers, one line describes little."""

    padding: int = 4
    """Points of the spectrum per resolution cell in which a line begins; chosen."""

    lowest: int = 2
    """Resolution cells from 0 Hz at which a line begins, at least; derived: a constant holds what is nearer."""

    damping: float = 1e-3
    """Of Levenberg and Marquardt's method where a fit begins [1]; chosen."""

    rounds: int = 20
    """Iterations of a fit, at most; chosen: lines a resolution cell apart settle slowly."""

    trials: int = 5
    """Steps tried in each of them; chosen."""

    settled: float = 1e-3
    """Relative change of the misfit at which a fit ends; chosen."""


@dataclasses.dataclass(frozen=True)
class NoiseLimits:
    """How noise is measured beside lines."""

    doppler: int = 16
    """Sweeps from which cells of Doppler shift separate noise from what repeats; chosen: half of them hold neither."""

    still: int = 3
    """Cells of Doppler shift about zero that hold what repeats; derived: the window's main lobe has two."""

    bands: int = 16
    """Bands of the IF in which noise is measured, at most; chosen."""

    cells: int = 200
    """Cells of a band, at least; chosen: 7 % of its noise."""

    widest: int = 16
    """Bins of a band, at least; chosen: more than one line holds."""

    quantile: float = 0.25
    """Of the powers of cells, from which their noise is first estimated [1]; chosen: lines hold less than the rest."""

    outlier: float = 4.0
    """Power over that of noise above which a cell does not count as noise [1]; chosen: 2 % of noise is above."""

    rounds: int = 30
    """Rounds in which that is repeated; chosen."""

    lowest: int = 1
    """Bins from 0 Hz at which lines and noise begin; derived: a constant holds what is nearer."""


NOISE = NoiseLimits()
MATERIAL = MaterialLimits()
WINDOW = WindowLimits()
SHAPE = ShapeLimits()
RAILS = RailLimits()
BURSTS = BurstLimits()
IMAGES = ImageLimits()
BACKGROUND = BackgroundLimits()
TRACK = TrackLimits()
SIDES = SideLimits()
LINES = LineLimits()
JUDGE = JudgeLimits()
