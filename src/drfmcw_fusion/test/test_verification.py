"""Comparing recomputed ranges with those of a graph that was under way when rosbag2 began to record it."""

import dataclasses
import functools

import numpy as np
import pytest
from checkout import DATA, SHARED

from drfmcw_fusion.offline import replay_recording
from drfmcw_fusion.pipeline import Flag
from drfmcw_fusion.replayed.verification import compare, recorded_ranges
from drfmcw_ros.bag.files import BagReader

FOLDERS = (DATA / 'ros2_bags', SHARED / 'ros2_bags')


@functools.cache
def compared(kind):
    """(recorded ranges, recomputed ones) of a recording begun while the crane drove."""
    path = next((folder / kind for folder in FOLDERS if (folder / kind).exists()), None)
    if path is None:
        pytest.skip('lies in shared/recordings only')
    with BagReader(path) as bag:
        return recorded_ranges(bag), replay_recording(str(path)).results


@pytest.mark.parametrize('kind', ['splitfile', 'mid_real', 'plain', 'mfile'])
def test_recording_begun_mid_drive_verifies_from_when_it_holds_all(kind):
    """Live nodes knew weather and velocity from before: stated with times; every later range is the same.

    They knew no integrity monitor yet, which doubts one of these ranges: that flag differs, and no range. They computed
    in another order, so that most are equal but for rounding.
    """
    found = compare(*compared(kind))
    assert found.only_recorded == 0
    assert found.different <= 1
    assert found.largest_difference < 1e-12
    assert found.identical + found.rounded > 100
    assert 5.0 < found.start < 7.0
    assert found.early < 50
    assert any('velocity' in reason for reason in found.reasons)
    assert any('weather' in reason for reason in found.reasons)


@pytest.mark.parametrize('error', [1e-6, 0.01])
def test_wrong_range_after_that_is_still_found(error):
    """A micrometre is far beyond rounding."""
    recorded, results = compared('splitfile')
    before = compare(recorded, results).different
    wrong = [*results[:-1], dataclasses.replace(results[-1], range=results[-1].range + error)]
    found = compare(recorded, wrong)
    assert found.different == before + 1
    assert found.largest_difference == pytest.approx(error, rel=1e-3)


def test_wrong_range_of_a_recording_from_the_start_is_not_excused():
    """Nothing is left out where the live nodes knew no more than the recording: every difference counts."""
    recorded, results = compared('splitfile')
    keys = [(r.first_station, r.second_station, r.sweep_id, r.stamp) for r in results]
    same = [
        dataclasses.replace(r, flags=recorded[k].flags) for r, k in zip(results, keys, strict=True) if k in recorded
    ]
    found = compare(recorded, same)
    assert (found.start, found.early, found.rounded, found.reasons) == (0.0, 0, 0, ())
    assert found.different > 90


def test_sweeps_that_the_recorder_lost_are_named():
    """Later ranges of such a recording differ, because the live velocity rests on them."""
    found = compare(*compared('mmsg'))
    assert found.only_recorded == 2
    assert found.first_missing > found.start


def test_sweeps_that_the_live_graph_did_not_hear_make_no_later_range_wrong():
    """Without the first sweep it knew the velocity one sweep later: left out until the track holds none of it."""
    _, results = compared('splitfile')
    by_pair = {}
    for r in sorted(results, key=lambda r: r.stamp):
        by_pair.setdefault((r.first_station, r.second_station), []).append(r)
    (own,) = by_pair.values()
    known = next(i for i, r in enumerate(own) if not r.flags & Flag.UNKNOWN_VELOCITY)
    unknown = dataclasses.replace(own[known], flags=own[known].flags | Flag.UNKNOWN_VELOCITY, velocity=np.nan)
    live = [*own[1:known], unknown, *own[known + 1 :]]
    recorded = {(r.first_station, r.second_station, r.sweep_id, r.stamp): r for r in live}
    found = compare(recorded, results)
    assert (found.different, found.early, found.only_recomputed) == (0, 1, 1)
    assert any('live graph heard' in reason for reason in found.reasons)
    wrong = [*results[:-1], dataclasses.replace(results[-1], range=results[-1].range + 0.01)]
    assert compare(recorded, wrong).different == 1
