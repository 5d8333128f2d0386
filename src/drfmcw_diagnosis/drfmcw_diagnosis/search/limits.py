"""Constants of fits, with units; "chosen" is a judgement that only the tests and the proof have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class SearchLimits:
    """How candidates are ranked, refined and exchanged."""

    tried: int = 12
    """Kinds of effects that are tried in each round, those with the largest promised gain; chosen."""

    refined: int = 5
    """Of them that are refined, those with the largest gain where refinement begins; chosen."""

    begun_behind: float = 0.6
    """Of the largest gain where refinement begins, the least share that is refined; chosen."""

    begun_far_behind: float = 0.05
    """The same of an effect without a size, whose gain where refinement begins says less; chosen."""

    starts: int = 6
    """Starting points of each kind; chosen."""

    foremost: int = 3
    """Of these, where a template is scaled to the data, those that are refined: what fits best as it begins; chosen."""

    least: float = 14.0
    """Promised gain below which a starting point is not tried: refined, it would not be accepted either; chosen."""

    hardly: float = 0.01
    """Share of the largest gain promised by an effect of some size, below which a starting point is not tried; chosen:
    refined, its gain would be far below the shares that count."""

    first_steps: int = 2
    """Of refinement, after which one starting point of a kind is chosen; chosen."""

    joint_steps: int = 3
    """Of refinement together with the present effects, after which only what fits nearly best is refined; chosen."""

    joint_rounds: int = 2
    """Rounds of this refinement, see `FitLimits.rounds`; chosen."""

    plenty: float = 1e3
    """Gain [1] beyond which an effect is not tried to be left out; chosen."""

    own: float = 0.2
    """Share of an effect's power that the others must not be able to follow for that; chosen."""

    steps_to_size: int = 4
    """The same where a template cannot simply be scaled; chosen."""

    rival: float = 16.0
    """Squared distance below which two explanations are one answer (4 sigma) [1]; chosen."""

    unchanged: float = 0.1
    """Change of a rounded number by an effect over its standard deviation [1], below which it shows nothing; chosen."""

    off: float = 0.01
    """Relative systematic error of a forward model; chosen."""

    faint: float = 0.1
    """Length of a template below which it may be mere rounding; chosen."""

    alike: float = 0.9
    """Cosine between the templates of a size and of twice the size, if they are more than rounding; chosen."""

    same_shape: float = 0.98
    """Cosine between what two effects add, from which on one is doubted with the other; chosen."""

    nothing: float = 1e-6
    """Length of a template below which this recording cannot show the effect; chosen."""

    few: int = 6
    """Kinds of rivals that are refined; chosen."""

    places: int = 2
    """Starting points of each; chosen."""

    fringes: int = 6
    """The same of a reflection: the fringes of different heights resemble each other; chosen."""

    promised: float = 0.3
    """Share of an effect's gain that a substitute must promise; chosen."""

    far: float = 4.0
    """Multiple of RIVAL within which a substitute is refined to the end; chosen."""

    much: float = 0.01
    """Share of what several effects gain by which one in their place may be behind before it is refined; chosen."""

    bend_points: int = 400
    """Points of a ramp [1] at which one bend is compared with another; chosen."""

    behind: float = 0.2
    """Share of an effect's gain by which a substitute may then be behind; chosen."""

    alone_steps: int = 6
    """Steps of a substitute's fit while the other effects follow to first order; chosen."""

    hopeless: float = 0.4
    """Share of an effect's gain by which a substitute may then be behind and still be fitted with them; chosen."""

    hopeless_elsewhere: float = 0.05
    """The same of an effect of the same kind with other values: the others need not change much; chosen."""

    behind_elsewhere: float = 0.2
    """Share of what the best place gains or loses by which another one may then be behind it; chosen."""

    returned: float = 0.01
    """Squared distance of the substitute from the explanation over that gain [1], below which they are the same;
    chosen."""

    of_a_kind: int = 2
    """Effects of one kind at one station, at most; chosen."""

    shift: float = 0.06
    """Rate about which another is tried where an effect has a random phase [resolution cells]; chosen: half of what
    lies between two that fit best around."""

    same: float = 4.0
    """Squared distance below which two fits of the same effects are the same (2 sigma); chosen."""

    elsewhere: float = 1e-3
    """Relative difference from which on a parameter is at another of its lookalikes [1]; chosen."""

    kept: int = 512
    """Templates; chosen."""

    parallel: float = 0.02
    """Share of a template's power that counts, however much of it an explanation can follow; chosen."""

    beyond_level: float = 16.0
    """Gain that a second path must bring apart from the received power, which may drift; chosen."""


@dataclasses.dataclass(frozen=True)
class SelectionLimits:
    """When an effect is added, dropped or exchanged."""

    further: float = 0.1
    """Of the accepted chance: an effect beside others must be surer than the first; chosen."""

    added: float = 1.0
    """Log evidence that an effect more must add; chosen."""

    better: float = 3.0
    """Log evidence by which an exchange must be better to be made; chosen."""

    as_well: float = 8.0
    """Misfit by which one effect in the place of several may be behind and still take it [1]; chosen."""

    relocated: int = 3
    """Effects that are about as likely, beside each of which the others may move; chosen."""

    most: int = 6
    """Effects in one explanation; chosen."""

    exchanged: int = 3
    """Times at most; chosen."""

    hopeful: float = 0.15
    """Share of a remainder that one more effect must explain, where the remainder is far beyond chance and two effects
    are there already [1]; chosen: what explains less imitates a part of something unknown."""

    nearly: float = 0.9
    """Share of the gain of an effect with lookalikes at which one of one parameter is added before it [1]; chosen."""

    beyond: float = 4.0
    """Misfit per number from which on a remainder is far beyond chance [1]; chosen."""

    far_less: float = 0.3
    """Share of a remainder far beyond chance that one effect in place of several must leave at most [1]; chosen."""

    hopeless: float = 0.5
    """Share of such a remainder in the misfit, beyond which exchanging effects is no use [1]; chosen."""


@dataclasses.dataclass(frozen=True)
class RivalLimits:
    """When another explanation fits as well."""

    says_the_same: float = 49.0
    """Squared distance between what explanations fitted to the same noise add, of one answer at most; chosen."""

    worse: float = 8.0
    """Log evidence by which a rival may be behind: one that only imitates with more freedom is none; chosen."""

    resembling: float = 1e-6
    """Chance that an effect of many coefficients resembles a simple one, below which it is no rival of it; chosen."""

    substitutes: int = 3
    """Of one effect, of which several are exchanged at once; chosen."""

    most: int = 24
    """Explanations with several effects exchanged that are fitted; chosen."""


@dataclasses.dataclass(frozen=True)
class ScanLimits:
    """Where scanners look."""

    hann: float = 2.0
    """Resolution cells that a Hann window's line is wide, half of it [1]; derived."""

    fine: int = 8
    """Transform bins per resolution cell [1]; chosen."""

    peaks: int = 3
    """Starting points of each effect [1]; chosen."""

    slowest_ripple: float = 2.0
    """Periods within the sweep [1]: each sweep's frequency takes out slower ripples; chosen."""

    fastest_sway: float = 5.0
    """Frequency of sway, at most [Hz]; chosen."""

    sway_cells: int = 2048
    """Resolution cells of sway, at most [1]; chosen."""

    aliases: int = 512
    """Frequencies of sway whose maxima are refined [1]; chosen."""

    top: int = 17
    """Points around each of them [1]; chosen."""

    compared: int = 24
    """Maxima that are refined once more before the highest ones count [1]; chosen: gains of aliases differ by 1e-6."""

    surges: tuple[float, ...] = (1.0, 2.0, 4.0)
    """Standard deviations beyond those of a steady sweep to which bursts raise the power; chosen."""

    faint: float = 12.0
    """Gain below which no sway is tried [1]; chosen."""

    reflections: int = 32
    """Starting points of a reflection [1]: the fringes of different heights resemble each other; chosen."""

    shown: float = 0.5
    """Share of a wanted gain [1] that a reflection's fringes, or a line in the spectrum, must show alone; chosen."""

    highest: float = 1000.0
    """Product of both antennas' heights above the ground, at most [m^2]; chosen."""

    beside: float = 0.1
    """Spread of what is explained of the range, in wavelengths, from which on fringes are sought there, too; chosen."""

    per_fringe: int = 8
    """Products tried per fringe at the nearest distance [1]; chosen."""

    heights: int = 30000
    """Products tried, at most [1]; chosen."""

    longest: float = 500.0
    """Excess range of an echo, at most [m]; chosen."""

    shorter: tuple[float, ...] = (1.0, 0.7, 0.4)
    """Dead times that are tried, over the one that the ends of the signals show [1]; chosen."""

    above_limit: tuple[float, ...] = (-0.05, 0.0, 0.04, 0.08, 0.13, 0.2)
    """Limits that are tried where samples pile up, relative to these [dB]; chosen."""

    piled: float = 2.0
    """Samples that pile up, over their standard deviation [1], from which on a limit is tried there; chosen."""

    level_step: float = 2.0
    """Between limits that are tried [dB]; chosen."""

    deepest: float = 20.0
    """Below the strongest line, of limits that are tried [dB]; chosen."""

    growth: tuple[int, ...] = (2, 8)
    """Powers of the line by which relative harmonics grow [1]: of a compression, of a limiter (about); derived."""

    leaked: float = 0.03
    """Power in a span over the largest one of its sweep, below which a burst leaks into it [1]; chosen."""

    loud: float = 0.3
    """Share of sweeps with a loud span [1], below which faint bursts are tried too; chosen."""

    alike: float = 16.0
    """Squared sum of phasors over the sum of squares [1], beyond which their phases are alike; derived: 1e-7 by
    chance."""

    suspicion: float = 0.05
    """p-value of a station's spectrum [1], below which distortions and bursts are tried; chosen."""


SEARCH = SearchLimits()
SCAN = ScanLimits()
SELECTION = SelectionLimits()
RIVALS = RivalLimits()


@dataclasses.dataclass(frozen=True)
class EventLimits:
    """Which events take the place of an effect."""

    by_ramp: float = 0.9
    """Share of an effect's power over the sweep, above which an event may stand for it [1]; chosen."""

    edge: float = 0.1
    """Share of the sweep at either end in which an event may be what settles there [1]; chosen."""

    widths: tuple[float, ...] = (0.0, 2.0, 5.0)
    """Standard deviations of an event's onset [blocks of the sweep]; chosen."""

    longest: float = 2.0
    """Standard deviation of a bump, at most: wider ones resemble a curved ramp [blocks]; chosen."""

    beaten: float = -6.0
    """Gain of an effect beyond that of the best event, below which it is in doubt: odds of 20 to 1; chosen."""

    parameter: float = 2.0
    """Gain that each parameter must bring which an effect has more than an event [1]; derived (Akaike 1974)."""

    of_event: int = 2
    """Parameters of an event [1]; derived: its time and its size."""

    least_power: float = 0.1
    """Share of an event's power that the other effects must leave of it [1]; chosen."""

    about: int = 2
    """Blocks before and behind an event of which nothing is known [blocks of the sweep]; chosen."""

    most: int = 4
    """Events that are set aside, at most; chosen."""

    worth: float = 0.6
    """Share of what is left of its channels that an event must explain to be set aside [1]; chosen: a smooth curve that
    nobody knows is no event."""

    chance: float = 1e-6
    """Chance of an event, of all times and shapes, above which it is not set aside [1]; chosen."""

    clearly: float = 30.0
    """Gain by which events that are set aside must exceed that of the best further effect [1]; chosen."""

    lost: int = 4
    """Samples that a station loses at once, at most, whose turns of the line may exceed half a turn [1]; chosen."""

    adequate: float = 1e-3
    """Gain over what an explanation explains [1], below which an event may be its inaccuracy; chosen, as of a
    remainder."""

    faint: float = 1e-3
    """Gain of an effect over what is set aside of the same numbers explains, from which on it counts [1]; chosen: that
    is known to first order only."""

    prior: float = 30.0
    """Standard deviation of the size of an event that is set aside, over the size found [1]; chosen: any size."""


EVENTS = EventLimits()
