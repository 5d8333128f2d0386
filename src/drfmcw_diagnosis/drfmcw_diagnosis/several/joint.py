"""What several recordings share: effects of the same hardware with one size, and whether the recordings agree on it.

Each recording determines an effect's parameters with a covariance, its other effects refitted. Their weighted mean is
the joint fit of one effect to all of them, as far as each likelihood is normal. A recording in which the effect was not
found still says how much of it there can be: a multiple s of the combined effect, 1 where it acts, 0 where it does not.
"""

import collections
import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import stats

from drfmcw_sim.effects import Effect, Of

from ..finding.result import Diagnosis, Estimate, FoundEffect
from .limits import JOINT

NOT_VISIBLE = 'not visible'
"""What a recording says that can show neither that an effect is there nor that it is not."""


@dataclasses.dataclass(frozen=True)
class Elsewhere:
    """How much of a shared effect a recording can hold in which it was not found."""

    recording: str
    effect: str
    station: str | None
    scale: float  # size over the combined one
    std: float

    @property
    def there(self) -> bool:
        """True where it is of the same size, and not nothing."""
        return abs(self.scale - 1.0) < JOINT.sigmas * self.std and abs(self.scale) >= JOINT.sigmas * self.std

    @property
    def words(self) -> str:
        """What that says."""
        if self.there:
            return 'there as well'
        if abs(self.scale) < JOINT.sigmas * self.std:
            return 'absent' if abs(self.scale - 1.0) >= JOINT.sigmas * self.std else NOT_VISIBLE
        return 'of another size'


@dataclasses.dataclass(frozen=True)
class Shared:
    """One effect that several recordings hold."""

    effect: str
    station: str | None
    recordings: tuple[str, ...]  # in which it was found
    found: tuple[FoundEffect, ...]  # in each of them
    same_hardware: bool  # it must have one size in all of them
    parameters: dict[str, Estimate]  # combined; {} where it may differ
    chi_square: float
    freedom: int
    elsewhere: tuple[Elsewhere, ...] = ()  # recordings of the same hardware without it

    @property
    def probability(self) -> float:
        """Chance of estimates that differ this much; NaN without a test."""
        return float(stats.chi2.sf(self.chi_square, self.freedom)) if self.freedom else math.nan

    @property
    def contradicting(self) -> tuple[str, ...]:
        """Recordings that show that the effect is absent there, or of another size."""
        return tuple(x.recording for x in self.elsewhere if not x.there and x.words != NOT_VISIBLE)

    @property
    def agrees(self) -> bool:
        """True where all recordings agree."""
        return not self.probability < JOINT.disagreement and not self.contradicting


@dataclasses.dataclass(frozen=True)
class Joint:
    """What several recordings say together."""

    shared: tuple[Shared, ...]
    alone: dict[str, tuple[FoundEffect, ...]]  # by recording


Key = tuple[str, str | None, tuple[str, ...]]  # effect, station, parameters


def joined(diagnoses: Mapping[str, Diagnosis]) -> Joint:
    """Return what the recordings share, and what each has alone; `diagnoses` by recording."""
    by_key: dict[Key, dict[str, FoundEffect]] = collections.defaultdict(dict)
    for recording, diagnosis in diagnoses.items():
        for found in diagnosis.explanation.effects if diagnosis.explanation else ():
            key: Key = (found.effect, found.station, tuple(found.parameters))
            by_key[key].setdefault(recording, found)
    shared = [
        _shared(effect, station, found_in)
        for (effect, station, _), found_in in by_key.items()
        if len(found_in) > 1 or of_hardware(effect)
    ]
    alone: dict[str, list[FoundEffect]] = {recording: [] for recording in diagnoses}
    for (effect, _, _), found_in in by_key.items():
        if len(found_in) == 1 and not of_hardware(effect):
            for recording, found in found_in.items():
                alone[recording].append(found)
    return Joint(tuple(shared), {recording: tuple(found) for recording, found in alone.items()})


def settled(joint: Joint, elsewhere: Sequence[Elsewhere]) -> Joint:
    """Return the same with what recordings say of effects that were not found in them.

    An effect that one recording alone holds, and none else by this test, is that recording's own.

    Args:
        joint: of the effects found.
        elsewhere: of each effect and recording.
    """
    shared, alone = [], {name: list(found) for name, found in joint.alone.items()}
    for one in joint.shared:
        said = [x for x in elsewhere if (x.effect, x.station) == (one.effect, one.station)]
        one = dataclasses.replace(one, elsewhere=tuple(said))
        if len(one.recordings) > 1 or any(x.there for x in said):
            shared.append(one)
        else:
            alone[one.recordings[0]].append(one.found[0])
    return Joint(tuple(shared), {name: tuple(found) for name, found in alone.items()})


def of_hardware(effect: str) -> bool:
    """Return whether an effect belongs to a station or an instrument, so that it is the same in every recording.

    Lists of values go with the distances or with the band of each recording, as does the window of a ramp, which
    depends on where in its band the oscillator begins.
    """
    cls = Effect.registry[effect]
    belongs = cls.of is not Of.PATH or cls.of_hardware
    return belongs and cls.evidence != 'window' and not cls.bursts and not cls.list_parameters()


def _shared(effect: str, station: str | None, found_in: Mapping[str, FoundEffect]) -> Shared:
    same = of_hardware(effect)
    names, found = tuple(found_in), tuple(found_in.values())
    if not same:
        return Shared(effect, station, names, found, False, {}, math.nan, 0)
    parameters, chi_square, freedom = combined(found)
    return Shared(effect, station, names, found, True, parameters, chi_square, freedom)


def combined(found: Sequence[FoundEffect]) -> tuple[dict[str, Estimate], float, int]:
    """Return the weighted mean of one effect's parameters, chi-square of the differences and its degrees of freedom."""
    names = list(found[0].parameters)
    units = [found[0].parameters[n].unit for n in names]
    points = np.array([[f.parameters[n].value for n in names] for f in found])
    for column, unit in enumerate(units):
        if unit == 'rad':  # whole turns are nothing
            turn = 2.0 * math.pi
            points[:, column] -= turn * np.rint((points[:, column] - points[0, column]) / turn)
    covariances = [_covariance(f, names) for f in found]
    scale = np.sqrt(np.mean([np.diag(c) for c in covariances], axis=0))  # parameters differ by many orders
    weights = [np.linalg.pinv(c / np.outer(scale, scale), hermitian=True) for c in covariances]
    total = np.linalg.pinv(np.sum(weights, axis=0), hermitian=True)
    mean = total @ np.sum([w @ (p / scale) for w, p in zip(weights, points, strict=True)], axis=0)
    apart = points / scale - mean
    chi_square = float(sum(d @ w @ d for d, w in zip(apart, weights, strict=True)))
    stds = np.sqrt(np.diag(total)) * scale
    parameters = {
        name: Estimate(float(value), float(std), unit)
        for name, value, std, unit in zip(names, mean * scale, stds, units, strict=True)
    }
    return parameters, chi_square, (len(found) - 1) * len(names)


def _covariance(found: FoundEffect, names: Sequence[str]) -> np.ndarray:
    """Return the covariance of an effect's parameters; without one known they count as independent."""
    stds = np.array([found.parameters[n].std for n in names])
    if found.correlation is None:
        return np.diag(stds**2)
    return np.outer(stds, stds) * np.array(found.correlation)
