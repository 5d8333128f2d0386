"""Numbers of a recording's groups of sweeps, what each of them is, and how groups are made of sweeps."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_sim.effects import ActsOn, Effect, Motion, Stage
from drfmcw_sim.measurements import Measurements

from ..features.extractor import Extractor, SweepFeatures
from .limits import SCATTER

_BY_DISTANCE = (Stage.GEOMETRY, Stage.PATHS)  # stages of effects that may follow the distance


@dataclasses.dataclass(frozen=True)
class Entries:
    """What the numbers of the vector are; arrays (n,)."""

    kind: np.ndarray  # its name
    station: np.ndarray  # number among those with samples, -1 for the path; of ramp: number of the channel
    group: np.ndarray
    position: np.ndarray  # cosine term, bin, band or sweep

    def where(self, **wanted: Any) -> np.ndarray:
        """Return which entries have all the values given."""
        chosen = np.ones(len(self.kind), bool)
        for name, value in wanted.items():
            chosen &= np.isin(getattr(self, name), value)
        return chosen


@dataclasses.dataclass(frozen=True)
class Correlated:
    """Pairs of numbers whose noise is correlated; arrays (m,)."""

    first: np.ndarray  # where they stand in the vector
    second: np.ndarray
    share: np.ndarray  # correlation [1]


class Groups(Mapping[str, np.ndarray]):
    """Numbers of a recording's groups by kind, measured or predicted, also as attributes: see `kinds.KINDS`."""

    def __init__(self, values: Mapping[str, np.ndarray]) -> None:
        """Take arrays by the kinds' names."""
        self._values = dict(values)

    def __getitem__(self, name: str) -> np.ndarray:
        """Return the numbers of a kind."""
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the kinds' names."""
        return iter(self._values)

    def __len__(self) -> int:
        """Return how many kinds there are."""
        return len(self._values)

    def __getattr__(self, name: str) -> np.ndarray:
        """Return the numbers of a kind."""
        if name.startswith('_') or name not in self._values:
            raise AttributeError(f"no kind of number '{name}'")
        return self._values[name]


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """The groups of one setting of the sweep."""

    groups: np.ndarray  # their numbers among all groups
    local: list[np.ndarray]  # rows of `all` of each
    all: Measurements  # nominal, one per sweep
    steady: Measurements  # nominal, one per group under its mean conditions
    extract: Extractor


def acted(part: Part, effects: Sequence[Effect]) -> Measurements:
    """Return the groups' steady conditions after effects."""
    state = part.steady.rows(slice(None))
    for effect in sorted(effects, key=lambda e: e.stage):
        effect.prepare(state)
    return state


def move(m: Measurements, way: np.ndarray) -> None:
    """Move the target of each measurement farther (n,) [m], in place."""
    m.range += way
    m.paths[0].delay += way * m.refractive_index / SPEED_OF_LIGHT


def follows_distance(effect: Effect | type[Effect]) -> bool:
    """Return whether what an effect adds may follow the true distance to a part of the carrier's wavelength."""
    return ActsOn.DELAY in effect.acts_on and effect.stage in _BY_DISTANCE and not displaces(effect)


def displaces(effect: Effect | type[Effect]) -> bool:
    """Return whether the crane stands elsewhere than the reference says if an effect acts."""
    return effect.motion is not Motion.NONE or ActsOn.REFERENCE in effect.acts_on


def changes_distance(effect: Effect | type[Effect]) -> bool:
    """Return whether an effect changes the distance that others follow: where the crane stands, or how far that is."""
    return displaces(effect) or effect.stage == Stage.GEOMETRY


def shows_place(effect: Effect) -> bool:
    """Return whether what an effect adds shows where the crane is: a bent ramp does by the line's frequency."""
    return follows_distance(effect) or effect.motion is not Motion.NONE or effect.shapes_chirp


def align(
    part: Part, rows: Measurements, copies: int, sweeps: Sequence[SweepFeatures], effects: Sequence[Effect]
) -> np.ndarray:
    """Give the line of a station that hears itself the measured phase; return the mean delay added (G,) [s].

    Its phase is no free one as that of a pair, but follows from the delay, which nobody knows to a part of a
    wavelength: less than that is added. Where the phases of a group's sweeps differ, the copies' lie evenly over
    half a turn.

    Args:
        part: groups of one setting.
        rows: their steady conditions, as often as there are copies; the delays are changed.
        copies: number of them.
        sweeps: measured features of all groups.
        effects: may change the delay.
    """
    added = np.zeros((copies, len(part.groups)))
    if not part.extract.topology.hears_itself:
        return added[0]
    state = acted(part, effects)
    (station,) = state.stations
    delay, sweep = state.paths[0].delay, station.sweep
    carrier = station.alpha * sweep.center_frequency
    own = carrier * delay - 0.5 * sweep.chirp_rate * delay**2  # turns in mid-sweep
    for row, g in enumerate(part.groups):
        phasor = np.mean(np.exp(1j * sweep.line_sign() * sweeps[g].carrier))
        turns = np.arange(copies) / (2.0 * copies)
        if abs(phasor) > SCATTER.coherent:
            turns = np.angle(phasor) / (2.0 * np.pi) - own[row]
        added[:, row] = (turns - np.rint(turns)) / carrier[row]
    rows.paths[0].delay += added.ravel()
    return added.mean(axis=0)


def in_phase(part: Part, rows: Measurements, copies: int, effects: Sequence[Effect]) -> np.ndarray:
    """Give a pair's lines the same carrier phase wherever a group's copies stand; return the mean delay added (G,) [s].

    Only then do initial phases that lie evenly over a turn make the lines' phases even. Less than a wavelength is
    added.

    Args:
        part: groups of one setting.
        rows: their conditions, as often as there are copies; the delays are changed.
        copies: number of them.
        effects: may change the delay.
    """
    state = acted(dataclasses.replace(part, steady=rows), effects)
    carrier = part.extract.sweeps[0].center_frequency
    turns = carrier * state.paths[0].delay.reshape(copies, -1)
    turns -= turns[:1]
    added: np.ndarray = (np.rint(turns) - turns) / carrier
    rows.paths[0].delay += added.ravel()
    return added.mean(axis=0)


def pooled(values: Sequence[np.ndarray], expected: np.ndarray | None = None) -> np.ndarray:
    """Return standard deviations within groups (G, k), each drawn towards that of all groups together.

    The scatter of few sweeps is a poor estimate: alone it would make large residuals far too likely.

    Args:
        values: of each group (n, k).
        expected: variance of each group (G,) up to a common factor; None where all are alike.
    """
    freedom = np.array([len(v) - 1 for v in values])[:, None]
    own = np.array([v.var(axis=0, ddof=1) for v in values])
    shape = np.ones((len(values), 1)) if expected is None else expected[:, None]
    # a group in which something disturbs the line scatters by more than chance, and says nothing of the others
    ratio = own / shape
    disturbed = ratio > np.median(ratio, axis=0) * stats.f.isf(SCATTER.disturbed, freedom, freedom.sum())
    alike = np.where(disturbed, 0, freedom)
    common = (alike * own).sum(axis=0) / np.maximum((alike * shape).sum(axis=0), 1e-300) * shape
    drawn = (freedom * own + SCATTER.pool * common) / (freedom + SCATTER.pool)
    return np.sqrt(np.where(disturbed, own * variance_factor(freedom), drawn))


def variance_factor(freedom: np.ndarray | int) -> np.ndarray:
    """Return by what to widen a variance with few degrees of freedom, so that squares over it are 1 on average.

    Values over it follow Student's t.
    """
    factor: np.ndarray = freedom / np.maximum(freedom - 2.0, 1.0)
    return factor


def steady(m: Measurements, local: Sequence[np.ndarray]) -> Measurements:
    """Return one measurement per group, under the group's mean conditions; `local` are the groups' rows of `m`."""
    result = m.rows(np.array([rows[0] for rows in local]))

    def mean(values: np.ndarray) -> np.ndarray:
        return np.array([values[rows].mean() for rows in local])

    for station, source in zip(result.stations, m.stations, strict=True):
        for name in ('received_power', 'temperature'):
            getattr(station, name)[:] = mean(getattr(source, name))
    for path, recorded in zip(result.paths, m.paths, strict=True):
        path.delay[:] = mean(recorded.delay)
    for name in ('range', 'time', 'velocity', 'refractive_index'):
        getattr(result, name)[:] = mean(getattr(m, name))
    return result
