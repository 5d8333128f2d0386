"""Comparing recomputed ranges with those that the live graph published."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from rich.console import Console

from drfmcw_ros.bag.files import BagError, BagReader
from drfmcw_ros.messages import stamp_ns

from .pipeline import RangeResult

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


@dataclasses.dataclass(frozen=True)
class Comparison:
    """How recorded and recomputed ranges compare, sweep by sweep."""

    identical: int
    different: int
    largest_difference: float  # of the range [m]
    only_recorded: int  # ranges in the recording that were not recomputed
    only_recomputed: int


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
    """Compare every field of RangeEstimate, bit by bit (NaN equals NaN)."""
    recomputed = {(r.first_station, r.second_station, r.sweep_id, r.stamp): r for r in results}
    identical, largest = 0, 0.0
    common = recorded.keys() & recomputed.keys()
    for key in common:
        one, other = recorded[key], recomputed[key]
        if all(_equal(getattr(one, name), getattr(other, name)) for name in _COMPARED):
            identical += 1
        largest = max(largest, abs(one.range - other.range))
    return Comparison(
        identical=identical,
        different=len(common) - identical,
        largest_difference=largest,
        only_recorded=len(recorded) - len(common),
        only_recomputed=len(recomputed) - len(common),
    )


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
        + f', {found.only_recorded} only in the recording, {found.only_recomputed} only recomputed',
        highlight=False,
    )
    return 1 if found.different or found.only_recorded else 0
