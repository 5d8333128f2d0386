"""Comparing recomputed ranges with those that the live graph published."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from drfmcw_ros.bag.files import BagError, BagReader
from drfmcw_ros.graph.messages import stamp_ns

from ..pipeline import Flag, RangeResult
from ..tracking import MEMORY

_COMPARED = (
    'mode',
    'flags',
    'range',
    'range_std',
    'velocity',
    'uncorrected_range',
    'alpha_correction',
    'atmosphere_correction',
    'delay_correction',
    'velocity_correction',
    'refractive_index',
)
_LATER = 'correlated_std'  # NaN where the recording is older


_ROUNDING = 1e-9  # relative: what a track that began earlier may change by the order of its sums


@dataclasses.dataclass(frozen=True)
class Comparison:
    """How recorded and recomputed ranges compare, sweep by sweep."""

    identical: int
    different: int
    largest_difference: float  # of the range [m]
    only_recorded: int  # ranges in the recording that were not recomputed
    only_recomputed: int
    rounded: int = 0  # equal to 1e-9, where the live velocity track began before the recording
    early: int = 0  # from before the recording held what the live nodes had
    start: float = 0.0  # from when on they are compared, after the first recorded range [s]
    reasons: tuple[str, ...] = ()  # why not from the beginning
    first_missing: float = 0.0  # of `only_recorded`, after the first recorded range [s]


def recorded_ranges(bag: BagReader) -> dict[tuple[str, str, int, int], Any]:
    """Return {(first, second, sweep_id, stamp [ns]): RangeEstimate} of all ranges in a recording.

    Raises:
        BagError: the recording holds none.
    """
    topics = {t for t, kind in bag.topics.items() if kind == 'drfmcw_msgs/msg/RangeEstimate'}
    if not topics:
        raise BagError(f'{bag.path}: holds no RangeEstimate topic to compare with')
    return {
        (m.first_station, m.second_station, m.sweep_id, stamp_ns(m.header.stamp)): m for _, _, m in bag.messages(topics)
    }


def compare(recorded: dict[tuple[str, str, int, int], Any], results: Sequence[RangeResult]) -> Comparison:
    """Compare every field of RangeEstimate, bit by bit (NaN equals NaN).

    A recording that begins while the crane drives lacks what the live nodes had from before: sweeps, weather, the
    track of the velocity. Where the first ranges of a pair differ, they are compared from when on the recording holds
    all of it, and the reasons are stated; from there on the velocity may differ by rounding. The same holds where the
    live graph did not hear the first sweeps of a pair, and the recorder did.
    """
    recomputed = {(r.first_station, r.second_station, r.sweep_id, r.stamp): r for r in results}
    begin = min((key[3] for key in recorded), default=0)
    starts, reasons = _starts(recorded, recomputed, begin)
    identical = rounded = different = early = 0
    largest = 0.0
    common = recorded.keys() & recomputed.keys()
    for key in common:
        one, other = recorded[key], recomputed[key]
        compared = _COMPARED if math.isnan(one.correlated_std) else (*_COMPARED, _LATER)
        if all(_equal(getattr(one, name), getattr(other, name)) for name in compared):
            identical += 1
        elif key[:2] in starts and key[3] < starts[key[:2]]:
            early += 1
        else:
            largest = max(largest, abs(one.range - other.range))
            close = all(_close(getattr(one, name), getattr(other, name)) for name in compared)
            rounded += close and key[:2] in starts
            different += not (close and key[:2] in starts)
    missing = [key for key in recorded.keys() - recomputed.keys() if key[3] >= starts.get(key[:2], 0)]
    return Comparison(
        identical=identical,
        different=different,
        largest_difference=largest,
        only_recorded=len(missing),
        only_recomputed=len(recomputed) - len(common),
        rounded=rounded,
        early=early + len(recorded) - len(common) - len(missing),
        start=max(((start - begin) * 1e-9 for start in starts.values()), default=0.0),
        reasons=reasons,
        first_missing=(min((key[3] for key in missing), default=begin) - begin) * 1e-9,
    )


def _starts(
    recorded: Mapping[tuple[str, str, int, int], Any],
    recomputed: Mapping[tuple[str, str, int, int], RangeResult],
    begin: int,
) -> tuple[dict[tuple[str, str], int], tuple[str, ...]]:
    """Return when each pair of which live graph and recording do not begin alike can be compared [ns], and why."""
    starts: dict[tuple[str, str], int] = {}
    reasons: list[str] = []
    for pair in sorted({key[:2] for key in recomputed}):
        keys = sorted((key for key in recomputed if key[:2] == pair), key=lambda key: key[3])
        both = [key for key in keys if key in recorded]
        if not both:
            continue
        unheard = keys[0] != both[0]
        if not unheard and not _under_way(recorded[both[0]], recomputed[both[0]]):
            continue
        keys = both if unheard else keys
        name, first = '/'.join(pair), keys[0][3]
        if unheard:
            reasons.append(f'{name}: the live graph heard sweeps from {(first - begin) * 1e-9:.1f} s on')
        if any(key[:2] == pair and key[3] < first for key in recorded):
            reasons.append(f'{name}: sweeps are recorded from {(first - begin) * 1e-9:.1f} s on')
        sweeps, duration = MEMORY
        track = max(keys[min(sweeps, len(keys)) - 1][3], first + round(duration * 1e9))
        reasons.append(f'{name}: the track of the velocity is the live one from {(track - begin) * 1e-9:.1f} s on')
        weather = first
        for key in both:
            if recomputed[key].flags & ~recorded[key].flags & Flag.STALE_ENVIRONMENT:
                weather = key[3] + 1
        if weather > first:
            reasons.append(f'{name}: weather is recorded from {(weather - begin) * 1e-9:.1f} s on')
        starts[pair] = max(track, weather)
    return starts, tuple(reasons)


def _under_way(live: Any, recomputed: RangeResult) -> bool:
    """Return whether the live node knew of a pair, at its first common sweep, what the recording does not hold."""
    unknown = Flag.UNKNOWN_VELOCITY | Flag.STALE_ENVIRONMENT | Flag.STALE_CALIBRATION
    return bool(recomputed.flags & ~live.flags & unknown)


def _close(one: float, other: float) -> bool:
    return _equal(one, other) or math.isclose(one, other, rel_tol=_ROUNDING, abs_tol=_ROUNDING)


def _equal(one: float, other: float) -> bool:
    return one == other or (isinstance(one, float) and math.isnan(one) and math.isnan(other))


def compare_with_recorded(path: str, results: Sequence[RangeResult], console: Console) -> int:
    """Print how the recomputed ranges compare with those in the recording; return 1 where any differs or is missing.

    Raises:
        BagError: the recording holds no ranges.
    """
    with BagReader(path) as bag:
        found = compare(recorded_ranges(bag), results)
    console.print(
        f'recorded ranges recomputed: {found.identical} identical bit by bit, {found.different} different'
        + (f' (by up to {found.largest_difference * 1e3:.3g} mm)' if found.different else '')
        + (f', {found.rounded} equal but for rounding' if found.rounded else '')
        + f', {found.only_recorded} only in the recording, {found.only_recomputed} only recomputed',
        highlight=False,
    )
    if found.reasons:
        console.print(
            f'the recording does not begin as the live graph did: compared from {found.start:.1f} s on, '
            f'{found.early} earlier ranges are left out',
            highlight=False,
        )
        for reason in found.reasons:
            console.print(f'  {reason}', highlight=False)
    if found.only_recorded and found.different:
        console.print(
            f'  the recorder lost the sweeps of {found.only_recorded} ranges, first at {found.first_missing:.1f} s: '
            'the live velocity rests on them, so that later ranges may differ',
            highlight=False,
        )
    return 1 if found.different or found.only_recorded else 0
