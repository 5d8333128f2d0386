"""Constants of a finding, with units; "chosen" is a judgement of what a reader needs."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class ViewLimits:
    """What a finding names and shows."""

    beyond_chance: float = 4.0
    """Standard deviations by which a sum of squares must exceed its expectation to be an excess; chosen."""

    central: float = 0.9
    """Share of an excess that a location's span holds [1]; chosen."""

    shown: float = 0.01
    """Share of the excess below which a location is not named [1]; chosen."""

    by_chance: float = 1e-4
    """Chance below which uneven codes are a mismatch with a location [1]; chosen."""

    predicted: float = 3.0
    """Doubt in standard deviations, to which a number must be predicted to count as misfit; chosen."""

    compared: int = 6
    """Explanations of one effect whose distances a finding lists, at most; chosen."""


@dataclasses.dataclass(frozen=True)
class SeparationLimits:
    """How the separation that a measurement brings is judged."""

    separable: float = 4.0
    """Distance below which two explanations are one answer [standard deviations]; chosen: chance exceeds it in 6 of
    100 000 measurements."""

    informative: float = 1.0
    """Separation from which on a measurement contributes to the decision [standard deviations]; chosen."""

    full_bar: float = 20.0
    """Separation from which on a measurement's bar in the report is full [standard deviations]; chosen."""


@dataclasses.dataclass(frozen=True)
class ScenarioLimits:
    """How a recording becomes a scenario."""

    moving: float = 4.0
    """Standard deviations from which on a group's velocity is more than the reference's noise; chosen."""

    fewest: int = 4
    """Sweeps of a group from which its scatter is estimated, at least; chosen."""

    rounds: int = 4
    """Iterations that remove the reference's errors; derived: errors are small against the distance, so each
    iteration leaves 1e-3 of the error before it."""

    shortest_report: float = 0.1
    """Interval of weather and status, at least [s]; chosen."""


@dataclasses.dataclass(frozen=True)
class SentenceLimits:
    """How much the sentences hold; the tables hold all."""

    listed: int = 4
    """Rivals and locations named, at most; chosen."""

    parameters: int = 20
    """Parameters of one effect that are listed, at most; chosen: a spline's say nothing one by one."""

    further: int = 2
    """Measurements named after the best one, at most; chosen."""


@dataclasses.dataclass(frozen=True)
class PageLimits:
    """How many series the page shows."""

    most: int = 18
    """Series in the page, at most; chosen: drawn in seconds, and those with the least misfit show nothing."""

    unfolded: int = 6
    """Series shown unfolded, at most: those with the largest excess misfit; chosen."""

    least: int = 2
    """Series shown unfolded, at least, even if they hold nothing but noise; chosen."""


@dataclasses.dataclass(frozen=True)
class PlotLimits:
    """What the plots look like."""

    width: float = 11.0
    """Width of a figure [in]; chosen."""

    dpi: int = 150
    """Resolution [1/in]; chosen: 1.5 times a screen's, enough for paper."""

    colors: int = 192
    """Colours of a picture's palette; chosen."""

    enlarged: float = 4.0
    """The remainder is also shown enlarged if the residual was this many times larger before [1]; chosen."""

    bars: int = 120
    """Points drawn with error bars of their own, at most; chosen."""

    deepest: float = 8.0
    """Misfit per degree of freedom with the deepest red of a map, at least, so that noise stays pale [1]; chosen."""

    cells: int = 14
    """Columns of a map whose cells hold their numbers, at most; chosen."""

    text: float = 10.0
    """Size of letters [pt]; chosen."""

    legend_text: float = 9.0
    """The same in legends [pt]; chosen."""

    cell_text: float = 8.5
    """The same in the cells of a map [pt]; chosen."""

    grid: float = 0.25
    """Opacity of grid lines [1]; chosen."""

    letters: int = 70
    """Letters below a map, if all columns had the longest name, beyond which the names are turned; derived: this many
    of 10 pt fill the figure's width."""

    letter: float = 0.07
    """Height that each letter of a turned name takes [in]; derived: half a letter's height of 10 pt, at 35 degrees."""

    line: float = 0.2
    """Height of one line of text [in]; derived: 10 pt and its spacing."""

    below: float = 0.3
    """Height below a map without its columns' names [in]; chosen."""

    title: float = 0.45
    """Height of a map without its rows [in]; chosen."""

    row: float = 0.36
    """Height of a row of a map [in]; chosen."""

    dark: float = 0.6
    """Share of the logarithmic scale from which on a cell is so dark that its number is white [1]; chosen."""

    palest: float = 0.3
    """Misfit per degree of freedom at which the colour bar begins, at most [1]; chosen."""

    decades: float = 200.0
    """Largest misfit per degree of freedom up to which the colour bar has ticks between powers of ten [1]; chosen."""

    series_height: float = 3.3
    """Height of a series with its legend [in]; chosen."""

    legend_share: float = 0.06
    """Height of that legend over that of the series [1]; chosen."""

    held_out_height: float = 1.9
    """Height of the comparison with held-out sweeps [in]; chosen."""

    margin: float = 0.08
    """Part of the shown span that is left free above and below it [1]; chosen."""


@dataclasses.dataclass(frozen=True)
class RepeatLimits:
    """When a remainder counts as one that repeats."""

    wholly: float = 0.95
    """Share of the excess misfit [1], from which on it repeats as a whole; chosen."""

    complete: float = 1.1
    """Misfit per degree of freedom up to which a measured remainder is complete [1]; chosen, as the goal is stated."""

    exceeding: float = 4.0
    """Standard deviations by which a kind of number must exceed noise to be named; chosen."""

    steady: float = 0.02
    """Share of the power that the strongest hundredth of spans of steady noise holds, at most [1]; measured: 1.6 %."""

    elsewhere: float = 0.5
    """Share of a curve that must be predicted where it was not learnt, for it to hold between [1]; chosen."""

    decibel: float = 0.3
    """Noise in a band beyond the model, from which on it is named [dB]; chosen."""

    sweep_decibel: float = 1.0
    """Change of the power beside the line from sweep to sweep, from which on it is named [dB]; chosen."""

    rhythm: float = 6.0
    """Standard deviations of a change from sweep to sweep at one frequency, from which on it is named; chosen."""


VIEWS = ViewLimits()
REPEATS = RepeatLimits()
SEPARATION = SeparationLimits()
SCENARIO = ScenarioLimits()
SENTENCES = SentenceLimits()
PAGE = PageLimits()
PLOTS = PlotLimits()
