"""What a proof measures: figures beside their goals, each with its 95 % interval, from any subset of the cases."""

import collections
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from .judging import SEPARABLE, keys

Record = Mapping[str, Any]
Interval = tuple[float, float]

BINS = (0.0, 4.0, 5.5, 7.0, 9.0, 14.0, 20.0, 40.0, 120.0, math.inf)
"""Edges of d in tables and plots."""

SEVERAL = ('pair', 'strong_pair', 'mixture', 'beside_unknown')
"""Groups whose recordings hold several effects that all count."""

_HELD_OUT = (0.95, 1.05)  # goal of the misfit per degree of freedom where the verdict is 'explained'
_LONGEST = 60.0  # goal of one diagnosis [s]
_ALONE, _BESIDE = 12.0, 8.0  # least d of an effect in a mixture, no other one in place and all others in place
_ABOUT = 0.97  # of a wanted d, what scaling may miss
_THRESHOLDS = np.arange(-5.0, 25.0, 0.01)  # of a matched filter, among which the measured one is looked for
_LIKELY = 1.92  # log likelihood below the largest that a 95 % interval holds
_PROTOTYPE_PLACES = 1904  # of ../shared/reference/method.md: 952 templates of any phase; 90 % at d = 5.85


def outcome(record: Record) -> str:
    """Return what the finding of a case is worth."""
    return record['judgement']['outcome']


def is_right(record: Record) -> bool:
    """Return whether a finding is right."""
    return outcome(record) == 'right'


def judged(records: Sequence[Record]) -> list[Record]:
    """Return the cases of which more could be said than effects of the registry say that imitate the truth."""
    return [r for r in records if outcome(r) != 'imitated']


def names_too_many(record: Record) -> bool:
    """Return whether the explanation put first has a name that is not there, which the data do not allow either."""
    named = record['judgement']['named']
    if not named or outcome(record) in ('right', 'undecided', 'imitated'):
        return False
    effects = record['finding']['effects']
    return not keys(effects) <= keys(record['truth']['effects'])


def is_null(record: Record) -> bool:
    """Return whether a recording holds no effect."""
    return not record['truth']['effects']


def detected(record: Record) -> bool:
    """Return whether a finding says that there is a mismatch."""
    return record['finding'] is not None and record['finding']['verdict'] != 'consistent'


def sizes(record: Record) -> list[float]:
    """Return the matched signal-to-noise d of each effect; what only shows another one is left out."""
    every = [e['d']['total'] for e in record['truth']['effects']]
    return every if record['group'] in SEVERAL else every[-1:]


def size(record: Record) -> float:
    """Return the smallest d of a recording's effects, zero where there is none."""
    return min(sizes(record), default=0.0)


def of(records: Sequence[Record], *groups: str, least: float = 0.0) -> list[Record]:
    """Return the cases of some groups, with all effects of at least about some d."""
    return [r for r in records if r['group'] in groups and size(r) >= _ABOUT * least]


def large(records: Sequence[Record], group: str) -> list[Record]:
    """Return the cases of a group whose registered effects the goal is for: each by itself, and beside the others."""
    return [
        r for r in of(records, group)
        if all(e['d']['alone'] >= _ABOUT * _ALONE and e['d']['beside'] >= _ABOUT * _BESIDE
               for e in r['truth']['effects'] if e['registered'])
    ]  # fmt: skip


def by(records: Sequence[Record], key: Callable[[Record], Any]) -> dict[Any, list[Record]]:
    """Return cases by a key, sorted."""
    found = collections.defaultdict(list)
    for record in records:
        found[key(record)].append(record)
    return dict(sorted(found.items()))


def names(effects: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return effects without their stations."""
    return sorted(e['effect'] for e in effects)


def is_named(record: Record) -> bool:
    """Return whether the finding gives the effects' names, whatever their stations."""
    if not detected(record) or not record['finding']['effects']:
        return False
    wanted = names(record['truth']['effects'])
    finding = record['finding']
    every = [names(e) for e in (finding['effects'], *(a['effects'] for a in finding['alternatives']))]
    return is_right(record) or all(n == wanted for n in every)


def is_wrong_name(record: Record) -> bool:
    """Return whether one explanation stands alone and holds an effect that is not there."""
    finding = record['finding']
    if finding is None or finding['verdict'] != 'explained':
        return False
    return not set(names(finding['effects'])) <= set(names(record['truth']['effects']))


def is_separable(record: Record) -> bool:
    """Return whether nothing else changes the data as the truth does."""
    return not record['truth']['rivals']


def stations_determined(records: Sequence[Record]) -> list[Record]:
    """Return single effects of one station, found and named, whose station the data determine."""
    return [
        r for r in of(records, 'single', 'strong', least=8.0)
        if is_separable(r) and is_named(r) and r['truth']['effects'][-1]['station'] is not None
    ]  # fmt: skip


def pulls(records: Sequence[Record]) -> list[Mapping[str, Any]]:
    """Return errors of parameters in stated standard deviations."""
    return [pull for r in records for pull in r['judgement']['pulls']]


def held_out(records: Sequence[Record]) -> list[float]:
    """Return misfits per degree of freedom on held-out sweeps, where the verdict is 'explained'."""
    fits = [r['finding']['fit']['held_out'] for r in records if r['finding'] and r['finding']['verdict'] == 'explained']
    return [f['after'] for f in fits if f and f['after'] is not None]


# --- rates ---


def interval(successes: int, count: int) -> Interval:
    """Return the exact 95 % interval of a rate (Clopper and Pearson)."""
    found = stats.binomtest(successes, count).proportion_ci(0.95, 'exact')
    return float(found.low), float(found.high)


@dataclasses.dataclass(frozen=True)
class Rate:
    """How often something is so."""

    successes: int
    count: int

    @property
    def value(self) -> float:
        """The rate; NaN of none."""
        return self.successes / self.count if self.count else math.nan

    @property
    def interval(self) -> Interval:
        """Its exact 95 % interval."""
        return interval(self.successes, self.count) if self.count else (0.0, 1.0)

    def __str__(self) -> str:
        """'k of n: rate (interval)'."""
        if not self.count:
            return 'none'
        low, high = self.interval
        return f'{self.successes} of {self.count}: {percent(self.value)} ({percent(low)} to {percent(high)})'


def percent(share: float) -> str:
    """Return a share in percent, with a digit more where it is small."""
    return f'{100.0 * share:.1f}%' if 0.0 < share < 0.0995 else f'{share:.0%}'


def rate(records: Sequence[Record], is_so: Callable[[Record], bool]) -> Rate:
    """Return how often something is so."""
    return Rate(sum(map(is_so, records)), len(records))


# --- detection ---


def threshold(positions: int, rate_: float = 0.01) -> float:
    """Return the threshold of a matched filter of either sign over so many grid points, at a false-alarm rate."""
    return float(stats.norm.isf(0.5 * rate_ / positions))


def theoretical_power(d: np.ndarray, threshold_: float) -> np.ndarray:
    """Return the chance that a matched filter passes its threshold: a normal number of mean d, either sign."""
    return stats.norm.sf(threshold_ - d) + stats.norm.cdf(-threshold_ - d)


def positions_searched(records: Sequence[Record]) -> int:
    """Return how many positions a search tries; the prototype's if no finding states it."""
    stated = [r['finding']['places'] for r in records if r['finding'] and r['finding'].get('places')]
    return int(np.median(stated)) if stated else _PROTOTYPE_PLACES


def of_power(records: Sequence[Record]) -> list[Record]:
    """Return single effects that nothing else shows."""
    return [r for r in of(records, 'single') if len(r['truth']['effects']) == 1]


def measured_threshold(records: Sequence[Record]) -> tuple[float, Interval] | None:
    """Return the threshold at which a matched filter would detect what was detected, with its 95 % interval.

    Maximum likelihood over all single effects; None where all or none were detected.
    """
    singles = of_power(records)
    found = np.array([detected(r) for r in singles], bool)
    if found.all() or not found.any():
        return None
    d = np.array([size(r) for r in singles])
    likelihood = np.zeros(len(_THRESHOLDS))
    for one, is_found in zip(d, found, strict=True):
        likelihood += (stats.norm.logsf if is_found else stats.norm.logcdf)(_THRESHOLDS - one)
    inside = _THRESHOLDS[likelihood > likelihood.max() - _LIKELY]
    return float(_THRESHOLDS[likelihood.argmax()]), (float(inside[0]), float(inside[-1]))


# --- goals ---


@dataclasses.dataclass(frozen=True)
class Goal:
    """One figure beside its goal."""

    what: str
    goal: str
    measured: str
    interval: str = ''
    met: str = ''  # 'yes' or 'no' where the whole interval says so, 'open' otherwise

    @property
    def row(self) -> tuple[str, ...]:
        """The cells of a table."""
        return self.what, self.goal, self.measured, self.interval, self.met


def _met(found: Interval, low: float, high: float) -> str:
    if low <= found[0] and found[1] <= high:
        return 'yes'
    return 'no' if found[1] < low or high < found[0] else 'open'


def _of_rate(what: str, goal: str, found: Rate, low: float = 0.0, high: float = 1.0) -> Goal:
    if not found.count:
        return Goal(what, goal, 'none run')
    reach = ' to '.join(map(percent, found.interval))
    met = '' if goal == '-' else _met(found.interval, low, high)
    return Goal(what, goal, f'{percent(found.value)} ({found.successes} of {found.count})', reach, met)


def _detection(records: Sequence[Record]) -> Goal:
    tried = positions_searched(records)
    to_90 = float(stats.norm.ppf(0.9))
    theory = threshold(tried) + to_90
    what, goal = 'd for 90 % detection', f'<= {1.1 * theory:.2f} (1.1 of theory at {tried} positions, {theory:.2f})'
    found = measured_threshold(records)
    if found is None:
        known = of_power(records)
        return Goal(what, goal, f'{rate(known, detected)}' if known else 'none run', '', 'open' if known else '')
    value, (low, high) = found[0] + to_90, (x + to_90 for x in found[1])
    return Goal(what, goal, f'{value:.2f}', f'{low:.2f} to {high:.2f}', _met((low, high), 0.0, 1.1 * theory))


def _spread(records: Sequence[Record]) -> Goal:
    what, goal = 'pull of the parameters (rms of error over stated std)', '0.9-1.1'
    every = np.array([p['pull'] for p in pulls(records)])
    if len(every) == 0:
        return Goal(what, goal, 'none named')
    square = float(np.sum(every**2))
    low, high = (math.sqrt(square / stats.chi2.isf(q, len(every))) for q in (0.025, 0.975))
    value = math.sqrt(square / len(every))
    return Goal(what, goal, f'{value:.2f} (of {len(every)})', f'{low:.2f} to {high:.2f}', _met((low, high), 0.9, 1.1))


def _misfit(records: Sequence[Record]) -> Goal:
    low, high = _HELD_OUT
    what, goal = 'held-out misfit per degree of freedom where explained', f'{low:g}-{high:g}'
    found = held_out(records)
    if not found:
        return Goal(what, goal, 'none explained')
    inside = sum(low <= m <= high for m in found)
    measured = f'median {np.median(found):.3f}, {inside} of {len(found)} within'
    met = 'yes' if inside == len(found) else 'no'
    return Goal(what, goal, measured, f'all from {min(found):.3f} to {max(found):.3f}', met)


def _times(records: Sequence[Record]) -> Goal:
    what, goal = 'time of one diagnosis', f'<= {_LONGEST:g} s'
    seconds = [r['seconds'] for r in records]
    reach = f'{min(seconds):.0f} to {max(seconds):.0f} s'
    met = 'yes' if max(seconds) <= _LONGEST else 'no'
    return Goal(what, goal, f'median {np.median(seconds):.0f} s', f'all from {reach}', met)


def goals(records: Sequence[Record]) -> list[Goal]:
    """Return the figures that ../shared/reference/method.md and the issue ask for."""
    known = of(records, 'single', 'strong', least=8.0)
    found = [r for r in known if detected(r) and is_separable(r)]
    named = of(records, 'single', 'strong', 'pair', 'strong_pair', 'decoy', least=8.0)
    mixed, beside = large(records, 'mixture'), large(records, 'beside_unknown')
    sizes_ = f'each d >= {_ALONE:g} alone, >= {_BESIDE:g} beside the others'
    return [
        _of_rate('false alarms at 1 %, wrong noise included', '0.5-1.5 %',
                 rate(of(records, 'null'), lambda r: not is_right(r)), 0.005, 0.015),
        _detection(records),
        _of_rate('right name, given detection, d >= 8, separable', '>= 98 %', rate(found, is_named), 0.98),
        _of_rate('a unique but wrong name, d >= 8', '<= 1 %', rate(named, is_wrong_name), 0.0, 0.01),
        _of_rate('pairs, both d >= 12, exact', '>= 90 %', rate(of(records, 'pair', least=12.0), is_right), 0.9),
        _of_rate('pairs, both d >= 50, exact', '>= 90 %', rate(of(records, 'strong_pair'), is_right), 0.9),
        _of_rate(f'mixtures of 2 to 4, {sizes_}, exact or truth listed', '>= 95 %',
                 rate(mixed, lambda r: outcome(r) in ('right', 'undecided')), 0.95),
        _of_rate('the same, nothing named', '<= 2 %',
                 rate(mixed, lambda r: not r['judgement']['named']), 0.0, 0.02),
        _of_rate('beside something unknown, of the same sizes, named', '>= 90 %',
                 rate(judged(beside), is_right), 0.9),
        _of_rate('a name that is not there, any group', '<= 1 %', rate(records, names_too_many), 0.0, 0.01),
        _of_rate('outside the registry, d >= 10, unexplained, not imitated', '>= 95 %',
                 rate(judged(of(records, 'outside', least=10.0)), is_right), 0.95),
        _of_rate('which station, named, d >= 8, separable', '>= 95 %',
                 rate(stations_determined(records), is_right), 0.95),
        _spread(records),
        _misfit(records),
        _times(records),
        _of_rate('left out of the registry, not named, not imitated', '-',
                 rate(judged(of(records, 'left_out')), is_right)),
        _of_rate('strong effects, d >= 60, exact', '-', rate(of(records, 'strong'), is_right)),
        _of_rate('decoys', '-', rate(of(records, 'decoy'), is_right)),
        _of_rate('ambiguous by construction, called so', '-', rate(of(records, 'ambiguous'), is_right)),
        _of_rate('recommended measurements that decide, carried out', '-',
                 rate([r for r in records if separated(r)], decides)),
        _of_rate('follow-ups of ambiguous cases that decide', '-', rate(of(records, 'decided'), is_right)),
    ]  # fmt: skip


def separated(record: Record) -> list[float] | None:
    """Return by how much the recommended measurement, carried out, separates the truth, if named, from its rivals."""
    judged = record['judgement']
    if judged.get('truth') not in judged['named']:
        return None
    found = [p for p in record.get('separated') or [] if p is not None]
    return found or None


def decides(record: Record) -> bool:
    """Return whether the recommended measurement separates the truth from every rival named."""
    return min(separated(record) or [0.0]) >= SEPARABLE


def nearest_to_truth(record: Record) -> str:
    """Return in words how far from the truth the explanation put first is, empty where that is not known."""
    apart = record['judgement'].get('apart') or [None]
    if apart[0] is None:
        return ''
    return f'; {apart[0]:.1f} sigma from the truth' + (', not separable' if apart[0] < SEPARABLE else '')
