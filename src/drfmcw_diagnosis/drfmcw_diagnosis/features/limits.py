"""Constants of the features, with units; "chosen" is a judgement that only the tests and the proof have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class CodeLimits:
    """How ADC codes are judged."""

    least_noise: float = 4.0
    """Standard deviation from which on noise makes the histogram smooth [codes]; chosen."""

    least_count: float = 25.0
    """Samples in a code's neighbourhood, for counts to be normal; chosen."""

    neighbours: int = 9
    """Codes whose mean count gives the standard deviation of one; chosen."""

    rail: int = 5
    """Codes next to the smallest and the largest, in which a limiter piles samples up; chosen."""

    correlated: float = 2.7
    """Sum of squared correlations of fourth differences, which share their counts [1]; derived."""

    stands_out: float = 4.0
    """Standard deviations from which on a difference counts for where the excess is; chosen."""

    pile: int = 3
    """Samples more than at the next code that a sweep may have at its outermost ones by chance; chosen."""

    outermost: int = 4
    """Codes that count as outermost, and as many as the next ones; chosen: the standard deviation of the least noise,
    which still hides a crest among them."""

    golden: float = 0.6180339887498949
    """Parts of a code by which the codes of one sweep lie beside those of the next, modulo one; derived: the golden
    section, whose multiples are evenly spread."""

    within: float = 0.998
    """Codes over which they are spread, less than one: whole codes stay as they are [1]; chosen."""

    tails: float = 1.05
    """By which differences may be larger than normal ones [1]; chosen."""


@dataclasses.dataclass(frozen=True)
class SidebandLimits:
    """Which sidebands of both lines are compared."""

    bands: int = 8
    """Bands of offsets from the line in which both stations' phases are compared; chosen."""

    quiet: int = 6
    """Sweeps without a burst that determine what both lines' noise shares; chosen."""

    farthest: float = 0.25
    """Largest offset, of the sample rate [1]; chosen."""

    nearest: int = 16
    """Bins from the line that its own changes within the sweep leave free; chosen."""

    clear: int = 16
    """Bins of both sidebands from 0 Hz and from the Nyquist frequency; chosen."""


@dataclasses.dataclass(frozen=True)
class SineLimits:
    """Which sines of random phase are looked for in sweeps."""

    fine: int = 8
    """Frequencies per resolution cell; chosen."""

    slowest: float = 1.0
    """Periods within the sweep [1]; chosen: slower ones each sweep's own phase and frequency follow."""

    singular: float = 1e-9
    """Of the power of cosine and sine, added to it: of two that look alike one counts [1]; chosen."""

    shared: float = 3.0
    """Gain over that by chance [1], which counts at most of each group; chosen."""

    left: float = 0.1
    """Share of a term's noise that a sine leaves, at least; chosen."""

    most: int = 3
    """Sines that are taken out of the noise; chosen."""

    strong: float = 6.0
    """Standard deviations of the gain beyond that by chance, from which on a sine is taken out; chosen: none of some
    thousand frequencies comes near it by chance."""


@dataclasses.dataclass(frozen=True)
class SpectrumLimits:
    """How spectra and series are taken."""

    chunk: int = 64
    """Sweeps whose features are computed at once [1]; chosen."""

    bands: int = 8
    """Bands of equal width in which the noise is compared; chosen."""

    stretch: int = 64
    """Length of the table of a line's phases that serves all stretches of a sweep [samples]; chosen."""

    edge_samples: int = 32
    """Samples about either end of the ramp in which the signal is counted; chosen."""

    edge_inside: int = 16
    """Samples by which these reach into the analysis window at its end; chosen."""

    edge_alike: float = 0.1
    """By how much a line and its mirror differ at least in these, as a share of their power [1]; chosen: below two
    thirds of a cycle they look alike."""

    onset_samples: int = 3
    """Samples of a span in which a signal's begin is compared; chosen."""

    onsets: int = 2
    """Such spans, ahead of the analysis window; chosen: it begins with the largest delay that a station may have."""

    onset_whole: float = 0.2
    """By how much the amplitude in such a span may differ for the signal to count as there throughout [1]; chosen."""

    onset_late: float = 1.0
    """Samples that must lie between the signal's begin and such a span; chosen: the sampling grid rounds it."""

    shortest_transient: int = 8
    """Samples of the first span after the signal's begin; chosen."""

    transients: int = 7
    """Spans after the signal's begin, each twice as long as the one before; chosen: half of a sweep."""

    transient_turns: float = 1.0
    """Periods of a line in a span [1], from which on its mean is known beside the line; chosen."""

    harmonics: tuple[int, ...] = (2, 3, 5)
    """Multiples of the line's phase at which distortion shows; chosen."""

    least_spread: float = 0.5
    """Power of a line's bins over its coherent power, at least [1]; derived: 1, less what noise makes of it."""

    span: int = 64
    """Samples over which the power without the line is taken; chosen."""

    spans: int = 15
    """Spans of the sweep, which overlap by half, in which the samples are averaged; chosen."""

    first_spans: tuple[int, ...] = (32, 64)
    """Lengths of further spans where the window begins [samples], for what settles within few samples; chosen."""

    kept_out: float = 5.6
    """Periods of a line in a span [1], from which on its Blackman-Harris window keeps the line out; chosen: the main
    lobe ends at 4."""

    burst: float = 2.2
    """Power over its median that no span of steady noise reaches [1]; derived: the mean power of 64 real samples of
    white noise exceeds it with a chance of 1e-7 (chi-squared)."""

    noisier: float = 16.0
    """Excess of the median power of a sweep's bins over that of its group [1], times the root of their number, from
    which on it holds a burst; chosen: eight standard deviations of steady noise behind a Hann window."""

    line: int = 64
    """Bins on either side of a line in which no other line is sought; chosen: the ramp's features cover them."""

    span_share: float = 0.1
    """Of the window's largest power that a span must have [1]; chosen."""

    free_sweeps: int = 3
    """Sweeps without a burst that determine the noise between bursts; chosen."""

    clear: int = 24
    """Bins from the line, its mirror and 0 Hz that a harmonic must keep; chosen."""

    blocks: range = range(16, 21, 4)
    """Samples per block: changes within the sweep up to 50 kHz; chosen: multiples of four, whose means leave out the
    images of a line that two or four interleaved converters make."""

    most_blocks: int = 1024
    """Blocks of a sweep, from which on blocks are longer; chosen: the search's memory grows with their square."""

    edge: int = 32
    """Bins next to 0 Hz and to the Nyquist frequency that are not compared; chosen."""

    median: int = 65
    """Bins over which the noise around a narrow line is taken; chosen."""

    fewest_bins: int = 16
    """Bins of a band that determine its noise; chosen."""

    band_parts: int = 8
    """Parts of a band whose medians give the course of the noise over it; chosen."""

    band_places: int = 64
    """Places in a band at which that course is taken; chosen: close to each other beside the bins' own scatter."""

    noticed: float = 1e-3
    """Of the noise [1], below which a line leaves the median of its band alone; chosen."""


@dataclasses.dataclass(frozen=True)
class SurgeLimits:
    """How surges of the power within a sweep are found."""

    windows: tuple[int, ...] = (32, 64, 128, 256, 512)
    """Lengths of windows [samples]; chosen: bursts of these and similar lengths stand out in one of them."""

    block: int = 32
    """Neighbouring bins that share a median; chosen."""

    fewest_blocks: int = 4
    """Blocks of bins beside a line, at least; chosen."""

    taper: float = 0.1
    """Share of the sweep over which its window rises, and falls [1]; chosen: a line is then some ten bins wide."""

    inside: float = 0.5
    """Mean square of that window in a window that is looked at, at least [1]; chosen."""

    course: int = 3
    """Degree of the course of the noise over all sweeps, which is taken out [1]; chosen."""

    lowest: float = 0.3
    """Of the mean noise that this course may fall to [1]; chosen."""

    highest: float = 2.8
    """Magnitude of a bin over that of the noise, to which a line is held down [1]; chosen: noise exceeds it with a
    chance of 4e-4."""

    line: float = 4.5
    """Magnitude of a bin over that of the noise from which on it is a line's [1]; chosen: noise exceeds it with a
    chance of 2e-9."""

    leaked: float = 0.3
    """What a line may leave in a bin, over the noise [1]; chosen."""

    fewest_points: int = 2
    """Independent powers of a window, at least; chosen."""

    fewest_windows: int = 8
    """Windows of a sweep, at least; chosen."""

    below: float = 0.1587
    """Share of the powers below one standard deviation under their median [1]; derived (normal)."""

    least_spread: float = 0.5
    """Spread of the powers over that of white noise, at least [1]; chosen."""

    usual: tuple[float, ...] = (2.7, 2.5, 2.3, 2.0, 1.7)
    """Standard deviations that the largest power of a steady sweep may have in windows of each length; chosen: of a
    third to a sixth of sweeps of 2048 samples it has more, so that the mean over some hundred sweeps is normal."""

    sure: float = 1.5
    """Standard deviations beyond these, from which on a sweep surely holds a burst; chosen."""

    groups: int = 96
    """Groups of sweeps of white noise that show what steady noise does; chosen."""

    group: int = 12
    """Sweeps of each; chosen."""

    seed: int = 20071
    """Of these; chosen."""

    least_std: float = 1e-3
    """Standard deviation of a score, at least [1]; chosen: windows too long for a sweep have none."""

    singular: float = 1e-2
    """Added to the variances of scores, of which each is one [1]; chosen: neighbouring windows score nearly alike."""

    skewed: float = 0.5
    """Logarithm of the mean square of steady noise over its median, by its squared spread [1]; derived: 1/2 of a
    lognormal distribution."""

    uncertain: float = 1.15
    """By which standard deviations of means of scores are larger than those of white noise [1]; chosen: the noise of
    oscillators is not quite as steady."""


@dataclasses.dataclass(frozen=True)
class BlockLimits:
    """Which blocks of the ramp are left out."""

    sweeps: int = 4
    """Sweeps of a group that show how a block scatters; chosen."""

    groups: float = 0.3
    """Share of groups in which a block is uneven, at least [1]; chosen."""

    uneven: float = 4.0
    """Scatter of a block over that of most [1], from which on it is left out; chosen: noise alone stays below 3."""


BLOCKS = BlockLimits()
CODES = CodeLimits()
SIDEBANDS = SidebandLimits()
SINES = SineLimits()
SPECTRUM = SpectrumLimits()
SURGES = SurgeLimits()
