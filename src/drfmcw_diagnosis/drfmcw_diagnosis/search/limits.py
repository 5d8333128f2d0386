"""Constants of fits, with units; "chosen" is a judgement that only the tests and the proof have tried."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class FitLimits:
    """How parameters are fitted."""

    flat: float = 1e-30
    """Curvature of a misfit that a parameter does not change [1]; chosen."""

    steps: int = 12
    """Steps of Levenberg and Marquardt's method, at most; chosen."""

    rounds: int = 4
    """Times, at most, that a distortion is computed anew on the other effects as they were fitted; chosen."""

    settled: float = 0.5
    """Squared change of a template [1] by a distortion computed anew, below which it need not be again; chosen."""

    settled_share: float = 1e-3
    """The same over the misfit [1], if that is more; chosen."""

    certain: float = 2.0
    """Standard deviations that an effect's size must have, and what makes it this effect; chosen."""


@dataclasses.dataclass(frozen=True)
class SearchLimits:
    """How candidates are ranked, refined and exchanged."""

    tried: int = 12
    """Kinds of effects that are tried in each round, those with the largest promised gain; chosen."""

    refined: int = 5
    """Of them that are refined, those with the largest gain where refinement begins; chosen."""

    starts: int = 6
    """Starting points of each kind; chosen."""

    least: float = 14.0
    """Promised gain below which a starting point is not tried: refined, it would not be accepted either; chosen."""

    first_steps: int = 2
    """Of refinement, after which one starting point of a kind is chosen; chosen."""

    steps_to_size: int = 4
    """The same where a template cannot simply be scaled; chosen."""

    off: float = 0.01
    """Relative systematic error of a forward model; chosen."""

    faint: float = 0.1
    """Length of a template below which it may be mere rounding; chosen."""

    alike: float = 0.9
    """Cosine between the templates of a size and of twice the size, if they are more than rounding; chosen."""

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

    behind: float = 0.2
    """Share of an effect's gain by which a substitute may then be behind; chosen."""

    of_a_kind: int = 2
    """Effects of one kind at one station, at most; chosen."""

    same: float = 4.0
    """Squared distance below which two fits of the same effects are the same (2 sigma); chosen."""

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

    better: float = 3.0
    """Log evidence by which an exchange must be better to be made; chosen."""

    exchanged: int = 3
    """Times at most; chosen."""


@dataclasses.dataclass(frozen=True)
class RivalLimits:
    """When another explanation fits as well."""

    says_the_same: float = 25.0
    """Squared distance between what explanations fitted to the same noise add, of one answer at most; chosen."""

    worse: float = 8.0
    """Log evidence by which a rival may be behind: one that only imitates with more freedom is none; chosen."""

    substitutes: int = 3
    """Of one effect, of which several are exchanged at once; chosen."""

    most: int = 24
    """Explanations with several effects exchanged that are fitted; chosen."""


FIT = FitLimits()
SEARCH = SearchLimits()
SELECTION = SelectionLimits()
RIVALS = RivalLimits()
