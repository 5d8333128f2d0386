"""Constants of the comparison, with units; "chosen" is a judgement that only the tests and the proof have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class ModelLimits:
    """To what forward models are trusted."""

    forward: float = 0.003
    """Of what an effect adds [1]; chosen."""

    forward_in_unknown_air: float = 0.02
    """Of the same where the weather is unknown [1]: the phase of a second path follows the air; chosen."""

    lines: float = 0.05
    """Of narrow lines [1], whose power follows amplitudes that scatter from sweep to sweep; chosen."""

    flutter: float = 2.0
    """Of what changes with the phase of each sweep [1], of which two are simulated; chosen."""

    own_flutter: float = 0.03
    """Of the change from sweep to sweep that effects of random phase cause [1]; chosen."""

    flutter_leak: float = 0.02
    """Of the largest such change in a group, in all of its terms [1]; chosen."""

    harmonics: float = 0.5
    """Of harmonics in the spectrum [1]: their position and shape multiply those of the line; chosen."""

    coherent_harmonics: float = 0.02
    """Of harmonics at the line's own phase [1]; chosen."""

    piled: float = 0.05
    """Of samples at a limit [1], which follow amplitudes that scatter from sweep to sweep; chosen."""

    bursts: float = 0.5
    """Of bursts [1], of which a group of sweeps holds a few; chosen."""

    all_bursts: float = 0.1
    """Of bursts [1], of which a recording and the sweeps simulated for it hold some hundred; chosen."""

    uneven: float = 1.0
    """Of what a distortion makes uneven from sweep to sweep as bursts do [1]; chosen."""

    bursts_rest: float = 1.0
    """Standard deviations of the noise that bursts may leave: one that the sweep's end cuts off looks like noise;
    chosen."""

    harmonics_width: int = 33
    """Bins over which a harmonic may be displaced; chosen."""

    calm: float = 0.4
    """Share of a group's sweeps without a burst [1], below which bursts may change the ramp from sweep to sweep;
    chosen."""

    unsettled: float = 2.0
    """Standard deviation of the share of what a filter's begin leaves that is there [1]; chosen: all of it, or none."""

    flutter_width: int = 5
    """Terms over which a change from sweep to sweep may be displaced; chosen."""

    floor: float = 0.02
    """Of a white noise floor [dB]; chosen."""

    skirt: float = 0.1
    """Of the oscillators' skirts [dB]; chosen."""

    common_floor: float = 0.04
    """Of a station's white noise floor in all bands and groups at once [dB]; chosen."""

    common_skirt: float = 0.15
    """Of a station's skirts at once, of their level and of their tilt from 0 Hz to the Nyquist frequency [dB];
    chosen."""

    beat: float = 10.0
    """Of T_off on average, in the sum of both beat frequencies [Hz]; chosen."""

    amplitude: float = 0.1
    """Of the link budget at each distance [dB]; chosen."""

    coherence: float = 0.005
    """Of the coherence of both lines' noise [1]; chosen."""

    coherence_added: float = 0.05
    """Relative to what an explanation adds to that coherence; chosen: skirts may not quite be one pole's."""

    movement: float = 1e-5
    """Of the carrier phase as a movement [m]; chosen."""

    air: float = 3e-5
    """Of the refractivity where the weather is unknown [1]: a tenth of the default's; chosen."""

    air_drift: float = 1e-8
    """Of the refractive index of air within a group [1/s]: 10 mK/s, which weather readings do not resolve; chosen."""

    felt: float = 0.01
    """Squared length of a common error [variances], below which it is left out; chosen."""

    largest: float = 1e4
    """Whitened residual at which numbers are clipped [1]: a larger one carries no more information; chosen."""


@dataclasses.dataclass(frozen=True)
class ScatterLimits:
    """How standard deviations follow from the scatter of sweeps."""

    fewest: int = 3
    """Sweeps of a group whose scatter is measured; smaller groups are left out; chosen."""

    pool: float = 30.0
    """Sweeps for which the scatter in all groups counts in each group; chosen."""

    disturbed: float = 1e-6
    """Chance of a group's scatter over that of the median one, below which it is the group's own [1]; chosen."""

    turned: float = 5.0
    """Departure of a sweep's phase from its neighbours' over the usual one [1], from which on a burst has turned it;
    chosen."""

    ambiguous: float = 0.5
    """Movement from sweep to sweep over half a turn of the carrier's phase [1], from which on the range counts it;
    chosen."""

    beyond_noise: float = 4.0
    """Mean square of that movement in the range over that of its noise, from which on it is a movement [1]; chosen."""

    course: int = 3
    """Degree of a polynomial that follows a slow movement within a group; chosen."""

    of_course: float = 32.0
    """Its steps over the noise, times the number of sweeps to the power of 3/2 [1], from which on it is a movement;
    chosen: twice what the fit makes of white noise."""

    coherent: float = 0.5
    """Length of the mean phasor of a group's sweeps [1], beyond which their phases count as one; chosen."""

    steady: int = 3
    """Terms of the ramp that slow changes of the conditions may move from sweep to sweep; chosen."""

    free_amplitude: int = 1
    """Cosine terms that the amplitude of each sweep takes out of the course of amplitudes; derived."""

    free_phase: int = 2
    """Cosine terms that phase and frequency of each sweep take out of the course of phases; derived."""

    trend_from: int = 8
    """Terms below which that course counts as level: at the edge of a fit a strong modulation would pass for noise;
    chosen."""

    trend_degree: int = 3
    """Degree of the polynomial that follows the oscillators' noise; chosen."""

    trend_rounds: int = 3
    """Rounds in which outliers are taken out of that fit; chosen."""

    trend_above: float = 2.5
    """Standard deviations from which on a term is an outlier of that fit; chosen."""

    same_pause: float = 0.1
    """Relative difference of a pause between sweeps from the usual one, up to which none is missing; chosen."""

    about_gap: int = 2
    """Sweeps on either side, beyond as many as are missing, that show how far the phase turns in a gap; chosen."""

    wander_sweeps: int = 7
    """Consecutive sweeps whose bends show how the carrier phase wanders; chosen."""

    noisy: float = 3.0
    """Power of a sweep's ramp over that of the median one, beyond which it counts less; chosen: a modulation of random
    phase makes sweeps scatter by less."""

    slipping: float = 0.05
    """Variance of the phase of a sweep's blocks by noise [rad^2], beyond which its course may slip by a turn, which
    raises the slow terms; chosen: a line 10 dB above the noise of a block."""

    flutter_median: int = 31
    """Terms over which the variance around one is taken; chosen."""

    flutter_spread: float = 1.025
    """By which the median of so few terms widens the spread of flutter [1]; chosen."""

    correlated: float = 0.5
    """Correlation of the phases' sum and difference, above which it counts [1]; chosen: of a receiver 5 dB noisier."""

    fully: float = 0.9995
    """The same at most [1]; chosen: of a receiver 36 dB noisier."""

    smooth: int = 15
    """Neighbouring cosine terms that share a variance; chosen."""

    piled: float = 0.3
    """Samples of a sweep that may pile up by chance; chosen."""

    amplitude_shared: float = 1.4
    """By which amplitudes of two stations are widened, as they scatter together: the sum counts twice; derived,
    sqrt(2)."""

    least_end: float = 0.3
    """Least standard deviation of when a signal begins or ends [samples]; chosen: the sampling grid rounds it."""

    least_mean: float = 0.01
    """Least standard deviation of a sweep's mean [LSB]; chosen."""

    least_onset: float = 2e-3
    """Least standard deviation of the line's change in the first samples of the signal [1]; chosen."""

    least_transient: float = 1e-6
    """Least standard deviation of a sweep's transient, over its line [1]; chosen."""

    least_range: float = 1e-5
    """Least standard deviation of a sweep's range [m]; chosen."""


@dataclasses.dataclass(frozen=True)
class SweepLimits:
    """Which sweeps are compared."""

    nearest_line: float = 40e3
    """Distance of a line from 0 Hz and from the Nyquist frequency [Hz], at which the mirror line is clear of the ramp;
    chosen."""

    least_line: float = 40.0
    """Power of a line over that of a bin of noise [1], in the median of a group (16 dB), below which another bin may
    pass for it; chosen."""

    least_over_others: float = 4.0
    """Power of a line over that of any other line [1], in the median of a group (6 dB), below which the other one may
    pass for it where the model is a little off; chosen."""

    mistaken: float = 10.0
    """Difference of a group's range from the reference, beside another group's, where a line was mistaken [m]; chosen:
    more than scales, clocks and delays make."""

    astray: float = 1.0
    """Difference of a range from those of its group where a line was mistaken [m]; chosen."""

    astray_spreads: float = 30.0
    """The same in median absolute differences, if that is more; chosen."""

    faded: float = 2.0
    """Difference of a level from those of its group where something is in the way [dB]; chosen."""

    faded_spreads: float = 10.0
    """The same in median absolute differences, if that is more; chosen."""

    faded_share: float = 0.25
    """Share of a group's sweeps from which on fading is no exception [1]; chosen."""

    standing: float = 4.0
    """Standard deviations of the reference's slope within which a group stands; chosen."""

    standing_among_drives: float = 2.0
    """The same where other groups do not stand; chosen."""

    exact: float = 1e-9
    """Standard deviation of a slope of exact readings [m/s]; chosen: above rounding."""


@dataclasses.dataclass(frozen=True)
class SimulationLimits:
    """How many sweeps stand for a group, and what is rounded."""

    distorted: int = 11
    """Sweeps simulated per group where an effect distorts the IF, evenly over a turn, or the crane sways fast; derived:
    a prime number, so that harmonics that fold back near the line, with many times its phase, cancel up to the 43rd
    where the line is near a quarter of the sampling rate."""

    quadrature: tuple[tuple[float, ...], ...] = (
        (-0.7946544723, -0.1875924741, 0.1875924741, 0.7946544723),
        (-0.8662468181, -0.4225186538, -0.2666354015, 0.2666354015, 0.4225186538, 0.8662468181),
    )
    """Places about the middle at which 4 or 6 sweeps have the mean of a slow sway [half of the way]; derived
    (Chebyshev's quadrature, exact for powers up to the 5th and 7th)."""

    misplaced: float = 3e-5
    """Error of the mean distance with so few [m], from which on more are tried; chosen: a range has 1e-3."""

    mirrored: float = 0.03
    """Change of the ramp by the line's phase [Np, rad], from which on a mean is that of twice as many sweeps: the
    square of what mirror lines leak does not cancel in two; chosen: it is then 2e-4."""

    levels: int = 6
    """Strengths of a line at which it is simulated what a distortion takes of it; chosen."""

    straight: float = 0.0005
    """Error of a line's strength between these [dB], below which no nearer ones are simulated; chosen: a tenth of
    `line_known`."""

    fine: int = 201
    """Strengths that are compared over the same reach, between those simulated; chosen."""

    beyond: float = 3.0
    """Strength that is tried beyond that of the measured line, or of the link budget [dB]; chosen."""

    line_known: float = 0.005
    """Standard deviation of a line's strength [dB]; chosen."""

    limit_known: float = 0.1
    """The same of a line that is held at a limit, whose level is to be found [dB]; chosen."""

    budget_known: float = 0.5
    """The same before it, by the link budget [dB]; chosen: sweeps scatter by so much."""

    turning: float = 0.02
    """Turn of a second path's phase within a driving group, from which on sweeps are simulated all along its way [1];
    chosen."""

    bursting: int = 12
    """Sweeps simulated per group, at most, where an effect comes and goes; chosen."""

    least_share: float = 1e-3
    """Share of sweeps without a burst, at least [1]; chosen: they say what there is between bursts."""

    turns: tuple[float, ...] = (0.0, 1.0 / 3.0, 2.0 / 3.0)
    """Phases at which an effect of random phase is simulated [turns]; derived: the fewest in which sines and their
    squares have the mean and the variance of all phases."""

    nodes: int = 9
    """Points of the quadrature over the noise of a sample; derived: exact for powers up to the 17th."""

    undistorted: int = 32
    """Explanations whose noisy sweeps without distortion are kept; chosen."""

    raised: float = 1.5
    """Of the noise [1], where the median around a bin counts as raised by lines; chosen."""

    line_step: float = 100.0
    """To which lines are rounded where skirts are computed [Hz]; derived: 64 kHz from a line it changes a skirt, which
    falls by 20 dB per decade, by less than 0.01 dB."""

    delay_step: float = 1e-9
    """Delay that turns no sideband's phase noticeably [s]; chosen."""

    frequencies: int = 16
    """Frequencies of each noise band at which the skirts are taken; chosen."""

    halvings: int = 24
    """Of the range in which the median of a band is sought; chosen: to a part in 1e7."""


@dataclasses.dataclass(frozen=True)
class LeftoverLimits:
    """How leftovers are tested."""

    windows: tuple[int, ...] = (2, 4, 8, 16, 32)
    """Blocks over which a remainder is averaged; chosen."""

    widths: tuple[float, ...] = (1.0, 2.5, 6.0)
    """Widths of events within the sweep [blocks]; chosen."""

    edge: int = 4
    """Blocks at the sweep's ends in which no event is looked for; chosen."""

    rhythm: tuple[int, ...] = (1, 3)
    """Terms over which a rhythm of random phase spreads; chosen."""

    flutter_tails: float = 1.15
    """By which tails of variances over the median of those around are wider than normal ones [1]; chosen."""

    tails_freedom: int = 60
    """Degrees of freedom of standard deviations that more than a group's own scatter gives; chosen."""

    squares: float = 1.03
    """By which squares of whitened noise may be larger than 1 [1]; chosen."""

    tails: float = 1.05
    """By which standard deviations from scatter widen a normal distribution's tails [1]; chosen."""

    common_tails: float = 1.1
    """The same of means over all groups, and by how much their terms share their noise [1]; chosen."""

    least_power: float = 0.02
    """Of an event's squared length that counts, however much of it an explanation can imitate [1]; chosen."""


MODEL, SCATTER, SWEEPS = ModelLimits(), ScatterLimits(), SweepLimits()
SIMULATION, LEFTOVER = SimulationLimits(), LeftoverLimits()
