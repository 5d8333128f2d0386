"""What a diagnosis says; `as_object` gives the JSON of the interface."""

import dataclasses
import math
from typing import Any

import numpy as np

from .limits import SEPARATION

LEVELS = ('if_samples', 'if_spectrum', 'beat_frequency', 'amplitude', 'noise', 'range')
"""Levels at which data and model are compared."""

VERDICTS = ('consistent', 'explained', 'ambiguous', 'partial', 'unexplained')
"""What can come out."""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """One parameter of an effect."""

    value: float
    std: float
    unit: str


@dataclasses.dataclass(frozen=True)
class FoundEffect:
    """One effect of an explanation."""

    effect: str
    station: str | None
    parameters: dict[str, Estimate]
    log_evidence_gain: float  # by this effect, the others in place
    p_value: float  # of a gain this large by chance, over all positions searched
    range_shift: float | None = None  # largest change of a range in this recording by it, with its sign [m]
    correlation: tuple[tuple[float, ...], ...] | None = None  # of the parameters, in order; None: not computed


@dataclasses.dataclass(frozen=True)
class Explanation:
    """Effects that together explain the data, and how well."""

    effects: tuple[FoundEffect, ...]
    log_evidence_gain: float  # over no effect at all


@dataclasses.dataclass(frozen=True)
class Location:
    """Where a mismatch sits."""

    level: str
    station: str | None
    axis: str  # 'ramp_time' [s], 'if_frequency' [Hz], 'range' [m], 'time' [s], 'board_temperature' [degC], ...
    start: float
    end: float
    share: float  # of the excess misfit


@dataclasses.dataclass(frozen=True)
class BeforeAfter:
    """A figure without and with the explanation in the model."""

    before: float
    after: float


@dataclasses.dataclass(frozen=True)
class Fit:
    """Misfit per degree of freedom, 1 when the model is right; range error against the reference where there is one."""

    fitted: BeforeAfter
    held_out: BeforeAfter
    range_bias: BeforeAfter | None = None  # mean [m]
    range_std: BeforeAfter | None = None  # [m]


@dataclasses.dataclass(frozen=True)
class Series:
    """Residuals of one level and station along one axis, whitened or not, with the explanation's curve."""

    level: str
    station: str | None
    axis: str
    x: np.ndarray  # (n,)
    residual: np.ndarray  # (n,) data minus nominal model
    std: np.ndarray  # (n,) of each
    curve: np.ndarray  # (n,) what the explanation adds to the model
    unit: str  # of residual, std and curve
    label: str  # in words, e.g. 'IF phase of master, mean over 336 sweeps'


@dataclasses.dataclass(frozen=True)
class MisfitMap:
    """Misfit per degree of freedom over level x span, before and after."""

    rows: tuple[str, ...]  # level and station
    columns: tuple[str, ...]  # spans in words, or '' where a row has fewer
    before: np.ndarray  # (rows, columns), NaN where there is nothing
    after: np.ndarray


@dataclasses.dataclass(frozen=True)
class Separability:
    """Smallest distance between what explanations predict, in standard deviations."""

    names: tuple[str, ...]
    distance: np.ndarray  # (n, n)


@dataclasses.dataclass(frozen=True)
class NextMeasurement:
    """A hypothetical measurement, and by how much it would separate the explanation from its rivals."""

    sentence: str  # what to do
    separations: tuple[float, ...]  # from each of the alternatives, beyond what the recording brings [std]

    @property
    def ruled_out(self) -> frozenset[int]:
        """Which of the rivals it would rule out, by their places."""
        return frozenset(i for i, s in enumerate(self.separations) if s >= SEPARATION.separable)

    @property
    def decides(self) -> int:
        """Number of rivals that it would rule out."""
        return len(self.ruled_out)

    @property
    def separation(self) -> float:
        """Smallest of the separations that rule a rival out; the largest where none does."""
        ruling_out = (s for s in self.separations if s >= SEPARATION.separable)
        return min(ruling_out, default=max(self.separations, default=0.0))


@dataclasses.dataclass(frozen=True)
class MeasuredCurve:
    """One curve of a measured remainder."""

    label: str  # kind of number and station, in words
    quantities: tuple[str, ...]  # that simulate it, as in `drfmcw_sim.synthesis.measured`
    axis: str  # covariate over which it changes, '' for none
    terms: int | None  # numbers over the sweep or the spectrum; None: of the samples or of single lines
    freedom: float | None  # values that the data determine of each, over the covariate
    elsewhere: float | None  # share of it that is also predicted where it was not learnt [1]; None: not testable


@dataclasses.dataclass(frozen=True)
class RandomPart:
    """Statistics of what does not repeat from sweep to sweep at one station."""

    station: str
    spectrum: tuple[tuple[float, float, float | None], ...]  # (from [Hz], to [Hz], power beyond the model [dB])
    strongest: float  # share of the power beside the line in the strongest hundredth of the spans of 64 samples [1]
    sweep_std: float  # standard deviation of that power from sweep to sweep [dB]
    modulation: float | None  # frequency at which amplitude or phase change most from sweep to sweep [Hz]


@dataclasses.dataclass(frozen=True)
class MeasuredRemainder:
    """What no effect explains, learnt from the data where it repeats: measured, not physics."""

    curves: tuple[MeasuredCurve, ...]  # none where nothing of it repeats
    repeats: (
        float  # share of what is left beyond chance that the curves predict, of held-out sweeps if there are any [1]
    )
    fitted: BeforeAfter  # misfit per degree of freedom with the effects alone, and with the curves as well
    held_out: BeforeAfter | None
    unmodelled: tuple[str, ...]  # kinds of numbers that the curves leave beyond chance
    random: tuple[RandomPart, ...]  # where not all of it repeats


@dataclasses.dataclass(frozen=True)
class Remainder:
    """What an explanation leaves beyond chance."""

    probability: float  # of so much by chance
    share: float  # of the excess misfit before
    locations: tuple[Location, ...]
    measured: MeasuredRemainder | None = None
    model: str | None = None  # path of the measured remainder


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """Everything a diagnosis found."""

    recording: str
    verdict: str
    significance: float  # probability of a mismatch this large by chance, over all positions searched
    false_alarm_rate: float  # setting
    locations: tuple[Location, ...]
    explanation: Explanation | None
    alternatives: tuple[Explanation, ...]
    next_measurement: str | None
    fit: Fit
    refined_config: str | None
    not_testable: tuple[str, ...]  # what could not be tested, and why, one sentence each
    sentences: tuple[str, ...]  # the finding in plain words
    series: tuple[Series, ...] = ()
    misfit_map: MisfitMap | None = None
    separability: Separability | None = None
    sweeps_fitted: int | None = None
    sweeps_held_out: int | None = None
    command: str = ''  # that gave this diagnosis
    measurements: tuple[NextMeasurement, ...] = ()  # that were simulated, the most decisive first
    remainder: Remainder | None = None  # what the effects leave beyond chance
    learnt: tuple[Series, ...] = ()  # what the effects leave, with the measured curves
    stations: tuple[str, ...] = ()  # (first, second), or the one that hears itself
    scene: dict[str, Any] | None = None  # of a station that hears itself: delays, window, what repeats; JSON-ready
    places: int | None = None  # positions searched, over which chance is counted

    def as_object(self) -> dict[str, Any]:
        """Return a JSON-ready object, as docs and ../shared/interfaces describe it."""
        return {
            'verdict': self.verdict,
            'significance': known(self.significance),
            'false_alarm_rate': self.false_alarm_rate,
            'locations': list(map(_location, self.locations)),
            'remainder': None
            if self.remainder is None
            else {
                'probability': known(self.remainder.probability),
                'share': known(self.remainder.share),
                'locations': list(map(_location, self.remainder.locations)),
                'model': self.remainder.model,
                'measured': None if self.remainder.measured is None else _plain(self.remainder.measured),
            },
            'effects': [] if self.explanation is None else [effect_object(e) for e in self.explanation.effects],
            'alternatives': [
                {'effects': [effect_object(e) for e in a.effects], 'log_evidence_gain': known(a.log_evidence_gain)}
                for a in self.alternatives
            ],
            'next_measurement': self.next_measurement,
            'measurements': [
                {
                    'measurement': m.sentence,
                    'separation': known(m.separation),
                    'decides': m.decides,
                    'separations': list(map(known, m.separations)),
                }
                for m in self.measurements
            ],
            'fit': {
                field.name: None
                if (value := getattr(self.fit, field.name)) is None
                else {'before': known(value.before), 'after': known(value.after)}
                for field in dataclasses.fields(self.fit)
            },
            'sweeps': {'fitted': self.sweeps_fitted, 'held_out': self.sweeps_held_out},
            'places': self.places,
            'scene': self.scene,
            'refined_config': self.refined_config,
            'not_testable': list(self.not_testable),
            'summary': list(self.sentences),
        }


def _plain(measured: MeasuredRemainder) -> dict[str, Any]:
    """Return a measured remainder as plain objects."""
    found = dataclasses.asdict(measured)
    for part in found['random']:
        part['spectrum'] = [{'from': a, 'to': b, 'beyond': c} for a, b, c in part['spectrum']]
    return found


def _location(x: Location) -> dict[str, Any]:
    return {
        'level': x.level,
        'station': x.station,
        'axis': x.axis,
        'from': known(x.start),
        'to': known(x.end),
        'share': known(x.share),
    }


def effect_object(found: FoundEffect) -> dict[str, Any]:
    """Return an effect as the interface has it."""
    parameters = {
        name: {'value': known(e.value), 'std': known(e.std), 'unit': e.unit} for name, e in found.parameters.items()
    }
    return {
        'effect': found.effect,
        'station': found.station,
        'parameters': parameters,
        'log_evidence_gain': known(found.log_evidence_gain),
        'p_value': known(found.p_value),
        'range_shift': known(found.range_shift),
    }


def known(value: float | None) -> float | None:
    """Return a plain number, or None for what JSON cannot say (NaN, infinite)."""
    return None if value is None or not math.isfinite(value) else float(value)
