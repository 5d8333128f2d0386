"""Hypothetical further sweeps, simulated and compared as a recording."""

import abc
import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.sweep import Mode, SweepSettings, beat_frequency
from drfmcw_sim.effects import Effect, Motion, Of, Stage
from drfmcw_sim.nominal import link_budget
from drfmcw_sim.synthesis.signal_model import synthesise

from ..compare.comparison import Comparison
from ..features.limits import SPECTRUM
from ..recording.dataset import Dataset
from .instruments import Effects, Measurement, View
from .limits import FURTHER


@dataclasses.dataclass(frozen=True)
class Conditions:
    """Conditions of a hypothetical recording; lists hold one entry per group of sweeps unless stated otherwise."""

    groups: tuple[int, ...]  # of the recording, from which everything else is taken
    distance: tuple[float, ...]  # [m]
    sweeps: tuple[tuple[SweepSettings, ...], ...]  # of all stations
    boards: tuple[float, ...]  # warmer than in the recording, one per station [K]
    air: float = 0.0  # warmer [K]
    later: float = 0.0  # [s]
    attenuation: float = 0.0  # of all received power [dB]
    referenced: bool = True  # distance measured by the recording's reference instrument, otherwise exactly known


@dataclasses.dataclass(frozen=True)
class _Supposed(Dataset):
    """A hypothetical recording."""

    begin: int  # stamp of the first sweep of the real one [ns]
    distance_index: np.ndarray  # (n,) number of the distance at which each sweep is made

    @functools.cached_property
    def time(self) -> np.ndarray:
        """Time since the first sweep of the real recording, (n,) [s]."""
        return (self.stamp - self.begin) * 1e-9

    @property
    def group(self) -> np.ndarray:
        """Number of the distance, (n,): each distance is one group, whatever the readings."""
        return self.distance_index


def supposed(comparison: Comparison, conditions: Conditions) -> Comparison:
    """Return the comparison of a simulated recording: nominal sweeps with noise, and jitter as in the real one."""
    data = comparison.data
    members = [comparison.members[g][: FURTHER.sweeps] for g in conditions.groups]
    rows = np.concatenate(members)
    distance_index = np.repeat(np.arange(len(members)), [len(m) for m in members])
    distance = np.array(conditions.distance)[distance_index]
    settings = [
        _powered(data, m, sweeps, d, conditions.attenuation)
        for m, sweeps, d in zip(members, conditions.sweeps, conditions.distance, strict=True)
    ]
    distinct = list(dict.fromkeys(settings))
    fields = {f.name: getattr(data, f.name) for f in dataclasses.fields(Dataset)}
    fields |= {
        name: value[..., rows]
        for name, value in fields.items()
        if isinstance(value, np.ndarray) and value.shape[-1] == len(data)
    }
    fields |= {
        'sweeps': tuple(distinct),
        'setting': np.array([distinct.index(s) for s in settings])[distance_index],
        'sweep_id': np.arange(len(rows)),
        'stamp': fields['stamp'] + round(conditions.later * 1e9),
        'board_temperature': fields['board_temperature'] + np.array(conditions.boards)[:, None],
        'temperature': fields['temperature'] + conditions.air,
        'reference': distance,
    }
    made = _Supposed(**fields, begin=int(data.stamp[0]), distance_index=distance_index)
    per_delay = comparison.parts[0].extract.beat_per_start_delay
    jitter = [np.var(s.beat) / per_delay**2 for s in comparison.sweeps]
    scatter = [np.var(s.amplitude, axis=0).mean() for s in comparison.sweeps]
    samples: dict[int, np.ndarray] = {}
    for setting in range(len(distinct)):
        chosen = np.flatnonzero(made.setting == setting)
        nominal = made.nominal(chosen)
        nominal.start_delay_jitter = math.sqrt(np.mean(jitter))
        nominal.amplitude_scatter = math.sqrt(np.mean(scatter))
        for i, values in enumerate(synthesise(nominal, 0)):
            if data.samples[i] is None:
                continue
            if i not in samples:
                samples[i] = np.empty((len(rows), values.shape[1]), values.dtype)
            samples[i][chosen] = values
    made = dataclasses.replace(made, samples=tuple(samples.get(i) for i in range(len(data.stations))))
    if not conditions.referenced:
        exact = np.zeros(len(rows))
        return Comparison(dataclasses.replace(made, reference_std=exact, reference_limit=exact))
    noise = np.concatenate([_scatter(data, m) for m in members])
    return Comparison(dataclasses.replace(made, reference=distance + noise))


def _powered(
    data: Dataset, rows: np.ndarray, sweeps: tuple[SweepSettings, ...], distance: float, attenuation: float
) -> tuple[SweepSettings, ...]:
    """Return settings whose link budget gives the recording's power, attenuated and never above full scale."""
    result = []
    for own, power in zip(sweeps, data.received_power[:, rows].mean(axis=1), strict=True):
        plain = dataclasses.replace(own, tx_eirp=0.0, rx_antenna_gain=0.0)
        gain = power - float(link_budget(plain, plain, np.array(data.distance[rows].mean()))) - attenuation
        most = own.full_scale_power - FURTHER.headroom - float(link_budget(plain, plain, np.array(distance)))
        # distances of equal gain are simulated together
        result.append(dataclasses.replace(plain, rx_antenna_gain=round(float(min(gain, most)), 2)))
    return tuple(result)


def _scatter(data: Dataset, rows: np.ndarray) -> np.ndarray:
    """Return the reference's readings less a straight line through them [m], zero where there are none."""
    readings = data.reference[rows]
    if not np.isfinite(readings).all():
        return np.zeros(len(rows))
    time = data.time[rows] - data.time[rows].mean()
    slope = time @ readings / max(time @ time, 1e-30)
    return readings - readings.mean() - slope * time


class _Sweeps(Measurement):
    """Further sweep pairs, under other conditions than the recording's."""

    @abc.abstractmethod
    def conditions(self, comparison: Comparison, count: int) -> Conditions | None:
        """Return the conditions, None where they cannot be had."""

    def acting(self, effect: Effect, comparison: Comparison) -> Effect | None:
        """Return the effect as it acts in these sweeps, None where it does not."""
        return effect

    def spread(self, made: Comparison) -> np.ndarray:
        """Return by how much each number's standard deviation exceeds that of the sweeps alone."""
        return np.ones(len(made.residual))

    def view(self, comparison: Comparison, count: int) -> View | None:
        """Return what effects add to the sweeps."""
        conditions = self.conditions(comparison, count)
        if conditions is None or not conditions.groups:
            return None
        made = supposed(comparison, conditions)
        spread = self.spread(made)
        for kind in comparison.kinds:
            known = not kind.needs_conditions or np.isfinite(comparison.std[kind.name]).any()
            if kind.rounded or (not known and (not kind.needs_reference or conditions.referenced)):
                spread[made.rows(kind)] = np.inf

        def show(effects: Effects) -> np.ndarray:
            acting = [self.acting(_at(e, conditions.groups), comparison) for e in effects]
            return made.template(tuple(e for e in acting if e is not None)) / spread

        return View(show, made)


def _at(effect: Effect, groups: Sequence[int]) -> Effect:
    """Return an effect whose parameters differ from group to group with those of some groups alone."""
    if not any(recipe.per_group for recipe in effect.recipes):
        return effect
    lists = {name: getattr(effect, name) for name in effect.list_parameters()}
    chosen: dict[str, Any] = {
        name: tuple(values[g] for g in groups) for name, values in lists.items() if len(values) > 1
    }
    return dataclasses.replace(effect, **chosen)


def _same(comparison: Comparison, count: int, **changes: Any) -> Conditions:
    """Return the recording's own conditions at some of its distances."""
    data, members = comparison.data, comparison.members
    groups = np.unique(np.linspace(0, len(members) - 1, min(count, len(members))).round().astype(int))
    conditions = Conditions(
        groups=tuple(groups.tolist()),
        distance=tuple(float(data.distance[members[g]].mean()) for g in groups),
        sweeps=tuple(data.sweeps[data.setting[members[g][0]]] for g in groups),
        boards=(0.0,) * len(data.stations),
    )
    return dataclasses.replace(conditions, **changes)


def _timed(
    comparison: Comparison, sweeps: tuple[SweepSettings, ...], start_delay: float, distance: float
) -> tuple[SweepSettings, ...] | None:
    """Return the settings with another T_off, None where a line would leave the IF band at that distance."""
    index = comparison.data.refractive_index.mean()
    delay = sum(c.delay for c in comparison.data.calibration) + distance * index / SPEED_OF_LIGHT
    mode = Mode.LONG_DISTANCE if delay > start_delay and not sweeps[0].hears_itself else Mode.SHORT_DISTANCE
    changed = tuple(dataclasses.replace(s, start_delay=start_delay, mode=int(mode)) for s in sweeps)
    for sweep in changed:
        line, margin = beat_frequency(sweep, delay, 1.0, 1.0), SPECTRUM.line * sweep.sample_rate / sweep.sample_count
        if not margin < line < sweep.sample_rate / 2 - margin:
            return None
    return changed


@dataclasses.dataclass(frozen=True)
class Baseline(_Sweeps):
    """A distance between the antennas, on the ground, measured by tape."""

    text = 'Measure a known baseline of {m.length:g} m between the antennas, laid out by tape to {m.millimetres:g} mm.'

    length: float  # [m]
    millimetres: float = 1.0  # to which it is known

    def conditions(self, comparison: Comparison, count: int) -> Conditions | None:
        """Return the nearest group's conditions at the baseline's length."""
        data, members = comparison.data, comparison.members
        group = int(np.argmin([data.distance[m].mean() for m in members]))
        old = data.sweeps[data.setting[members[group][0]]]
        sweeps = _timed(comparison, old, old[0].start_delay, self.length)
        if sweeps is None:
            return None
        return _same(comparison, count, groups=(group,), distance=(self.length,), sweeps=(sweeps,), referenced=False)

    def acting(self, effect: Effect, comparison: Comparison) -> Effect | None:
        """Leave out what belongs to the crane and to the reference instrument."""
        of_crane = effect.motion is not Motion.NONE or effect.stage is Stage.GEOMETRY
        return None if of_crane or effect.of is Of.REFERENCE else effect

    def spread(self, made: Comparison) -> np.ndarray:
        """Return that by the tape's error."""
        spread = np.ones(len(made.residual))
        chosen = made.entries.where(kind='range')
        spread[chosen] = np.hypot(1.0, 1e-3 * self.millimetres / made.std.range[made.entries.group[chosen]])
        return spread


@dataclasses.dataclass(frozen=True)
class OtherStartDelay(_Sweeps):
    """Another T_off, at those distances where both lines stay in the IF band."""

    text = 'Repeat the sweeps with a second T_off, a quarter or more longer or shorter.'

    factors: tuple[float, ...] = (1.25, 0.8, 1.5, 0.6, 2.0, 0.4)

    def conditions(self, comparison: Comparison, count: int) -> Conditions | None:
        """Return the T_off with which most distances can be measured."""
        if comparison.data.topology.hears_itself:
            return None
        same = _same(comparison, count)
        best: list[tuple[int, tuple[SweepSettings, ...]]] = []
        for factor in self.factors:
            timed = [
                _timed(comparison, s, factor * s[0].start_delay, d)
                for s, d in zip(same.sweeps, same.distance, strict=True)
            ]
            heard = [(i, s) for i, s in enumerate(timed) if s is not None]
            best = max(best, heard, key=len)
        return dataclasses.replace(
            same,
            groups=tuple(same.groups[i] for i, _ in best),
            distance=tuple(same.distance[i] for i, _ in best),
            sweeps=tuple(s for _, s in best),
        )


@dataclasses.dataclass(frozen=True)
class FurtherAway(_Sweeps):
    """Beyond the longest distance of the recording, with a T_off that allows for it."""

    text = 'Measure at {m.times:g} times the longest distance, against the same reference.'

    times: float = 1.5  # the longest distance

    def conditions(self, comparison: Comparison, count: int) -> Conditions | None:
        """Return the longest group's conditions further away, None where no T_off keeps both lines in the IF band."""
        data, members = comparison.data, comparison.members
        distances = [float(data.distance[m].mean()) for m in members]
        group = int(np.argmax(distances))
        distance = self.times * distances[group]
        old = data.sweeps[data.setting[members[group][0]]]
        timed = (_timed(comparison, old, factor * old[0].start_delay, distance) for factor in (1.0, 0.5, 0.25, 2.0))
        sweeps = next((s for s in timed if s is not None), None)
        if sweeps is None:
            return None
        return _same(comparison, count, groups=(group,), distance=(distance,), sweeps=(sweeps,))


@dataclasses.dataclass(frozen=True)
class Between(_Sweeps):
    """Distances between those of the recording."""

    text = 'Measure at further distances, halfway between those of the recording.'

    def conditions(self, comparison: Comparison, count: int) -> Conditions | None:
        """Return the distances halfway to the next group, where the settings of both are the same."""
        same = _same(comparison, count)
        data, members = comparison.data, comparison.members
        distance = np.array([data.distance[m].mean() for m in members])
        chosen = [
            (i, 0.5 * (distance[g] + distance[g + 1]))
            for i, g in enumerate(same.groups[:-1])
            if data.setting[members[g][0]] == data.setting[members[g + 1][0]]
        ]
        return dataclasses.replace(
            same,
            groups=tuple(same.groups[i] for i, _ in chosen),
            distance=tuple(float(d) for _, d in chosen),
            sweeps=tuple(same.sweeps[i] for i, _ in chosen),
        )


@dataclasses.dataclass(frozen=True)
class Repeated(_Sweeps):
    """The same distances once more, with something changed."""

    text = 'Repeat the sweeps {m.how}.'
    how: str  # in words
    board: float = 0.0  # warmer [K]
    station: str = ''  # whose board is warmer, '' for all
    air: float = 0.0  # warmer [K]
    later: float = 0.0  # [s]
    attenuation: float = 0.0  # of all received power [dB]
    still: bool = False  # the crane can neither drive nor sway

    def conditions(self, comparison: Comparison, count: int) -> Conditions:
        """Return the recording's conditions, changed."""
        boards = tuple(self.board * (self.station in ('', s)) for s in comparison.data.stations)
        return _same(comparison, count, boards=boards, air=self.air, later=self.later, attenuation=self.attenuation)

    def acting(self, effect: Effect, comparison: Comparison) -> Effect | None:
        """Leave out motion where the crane is held."""
        return None if self.still and effect.motion is not Motion.NONE else effect


@dataclasses.dataclass(frozen=True)
class Exchanged(_Sweeps):
    """Another, calibrated station replaces one, and with it that station's effects disappear."""

    text = 'Repeat the sweeps with another calibrated station in the place of {m.station}.'

    station: str

    @staticmethod
    def predictable(effect: type[Effect]) -> bool:
        """Return False for an effect that may belong to the path or to either station."""
        return not effect.movable

    def conditions(self, comparison: Comparison, count: int) -> Conditions | None:
        """Return the recording's conditions; None where a station hears itself."""
        return _same(comparison, count) if comparison.data.topology.is_pair else None

    def acting(self, effect: Effect, comparison: Comparison) -> Effect | None:
        """Leave out what the station did."""
        if effect.of is not Of.STATION:
            return effect
        left = [s for s in comparison.data.stations if s != self.station and effect.applies_to(s)]
        return dataclasses.replace(effect, station=left[0]) if left else None


@dataclasses.dataclass(frozen=True)
class MoreSweeps(Measurement):
    """As before, for longer."""

    times: int = 4
    text = 'Record {m.times} times as many sweeps under the same conditions.'

    def view(self, comparison: Comparison, count: int) -> View:
        """Return what effects add to the additional sweeps; limits of the model do not average out."""
        scale = np.zeros(len(comparison.residual))
        for kind in comparison.kinds:
            if kind.averages:
                scale[comparison.rows(kind)] = math.sqrt(self.times - 1.0)
        return View(lambda effects: comparison.template(effects) * scale, comparison)
