"""Ranges for displays: all of them, soon, in few messages."""

import math

import pytest

from drfmcw_fusion.batch import INTERVAL, Gathering
from drfmcw_fusion.pipeline import RangeResult


def result(number, distance=100.0):
    return RangeResult(number * 1000, 'antenna', 'a', 'b', number, 0, 0, distance, *[0.001] * 10)


@pytest.mark.parametrize('rate', [0.5, 10.0, 50.0, 200.0, 1000.0])
def test_every_range_is_sent_soon_and_in_few_messages(rate):
    """Ranges at a steady rate for 4 s, looked at after each one, as fusion does."""
    gathering, sent = Gathering(), []
    times = [100.0 + i / rate for i in range(max(4, round(4 * rate)))]
    for number, now in enumerate(times):
        gathering.add(result(number), now)
        if gathering.due(now):
            sent.append(gathering.take(now))
    rest = gathering.take(times[-1] + INTERVAL)
    whole = [number for batch in (*sent, rest) if batch is not None for number in batch.sweep_id]
    assert whole == list(range(len(times)))
    fewest = max(1.0, INTERVAL * rate - 1.0)  # in a batch but for the first one, which holds one range
    assert len(sent) - 1 <= len(times) / fewest
    assert max(max(batch.age) for batch in sent) <= INTERVAL + 1e-9
    if rate * INTERVAL < 1.0:  # at a low rate none waits
        assert rest is None and all(batch.age == [0.0] for batch in sent)


def test_a_batch_has_the_ranges_in_order_and_is_headed_by_the_newest():
    gathering = Gathering()
    assert gathering.take(0.0) is None and not gathering.due(0.0)
    for number, distance in ((7, 100.0), (8, math.nan), (9, 101.0)):
        gathering.add(result(number, distance), 1.0 + number * 1e-3)
    batch = gathering.take(1.010)
    assert (batch.stamp, batch.frame_id, batch.first_station, batch.second_station) == (9000, 'antenna', 'a', 'b')
    assert list(batch.sweep_start) == [7000, 8000, 9000]
    assert batch.age == pytest.approx([0.003, 0.002, 0.001])
    assert batch.range[::2] == [100.0, 101.0] and math.isnan(batch.range[1])
    assert gathering.take(1.011) is None
