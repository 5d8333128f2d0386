"""What the page shows: histories keep every extreme, staleness follows the clock, errors follow the reference."""

import math
import time

import numpy as np
import pytest
from drfmcw_msgs.msg import RangeBatch, RangeEstimate
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from drfmcw_fusion.batch import Gathering
from drfmcw_fusion.pipeline import RangeResult
from drfmcw_host.state.decoding import batch_readings, range_reading
from drfmcw_host.state.freshness import STALE_AFTER, Arrivals
from drfmcw_host.state.history import WINDOWS, History
from drfmcw_host.state.readings import Diagnostic, LogLine, RangeReading, SiteReading, decimated
from drfmcw_host.state.store import Store
from drfmcw_host.state.verdicts import Span, Verdicts
from drfmcw_ros.graph.messages import to_message

SECOND = 1_000_000_000


def reading(sweep_id=1, stamp=0, distance=100.0, flags=0):
    return RangeReading(sweep_id, stamp, 0, flags, 0, distance, 0.001, 0.0, 0.01)


@pytest.mark.parametrize('span', WINDOWS)
def test_history_keeps_the_extremes_of_every_span(span):
    """A single outlier within the span stays visible, however coarse the scale is."""
    rng = np.random.default_rng(1)
    times = np.sort(rng.integers(0, span * SECOND, 20_000))
    values = rng.normal(10.0, 1.0, len(times))
    values[len(values) // 2], values[len(values) // 3] = 99.0, -99.0
    history = History()
    for part in np.array_split(np.arange(len(times)), 37):
        history.add(times[part], values[part])
    curve = history.curve(span, int(times[-1]))
    assert curve.high.max() == 99.0 and curve.low.min() == -99.0
    assert len(curve.times) <= 600
    assert np.all(np.diff(curve.times) > 0)
    assert np.all((curve.low <= curve.mean) & (curve.mean <= curve.high))


def test_history_is_the_same_however_it_arrives():
    rng = np.random.default_rng(2)
    times = np.sort(rng.integers(0, 100 * SECOND, 3000))
    values = rng.normal(size=len(times))
    whole, single = History(), History()
    whole.add(times, values)
    for t, v in zip(times, values, strict=True):
        single.add(np.array([t]), np.array([v]))
    for span in WINDOWS:
        one, other = (h.curve(span, int(times[-1])) for h in (whole, single))
        np.testing.assert_array_equal(one.high, other.high)
        np.testing.assert_allclose(one.mean, other.mean, rtol=1e-12, atol=1e-12)


def test_history_mean_is_that_of_all_values():
    """On the 24 h scale one interval of 144 s holds them all."""
    history = History()
    values = np.arange(1000.0)
    history.add(np.linspace(0, 100 * SECOND, 1000).astype(np.int64), values)
    assert history.curve(86_400, 100 * SECOND).mean == pytest.approx([values.mean()])


def test_history_forgets_what_is_older_than_the_span():
    history = History()
    history.add(np.array([0]), np.array([1.0]))
    history.add(np.array([90_000 * SECOND]), np.array([2.0]))
    assert list(history.curve(86_400, 90_000 * SECOND).mean) == [2.0]
    assert not len(history.curve(10, 90_100 * SECOND).mean)


def test_history_leaves_out_what_is_no_number_and_refuses_impossible_spans():
    history = History()
    history.add(np.array([1, 2]), np.array([math.nan, math.inf]))
    assert not len(history.curve(10, 3).times)
    for span in (0.0, -1.0, 90_000.0, math.nan):
        with pytest.raises(ValueError):
            history.curve(span, 0)


def test_decimation_keeps_every_line():
    """A line of one bin is as strong after decimation, wherever it stands."""
    for line in range(0, 1024, 7):
        magnitude = np.full(1024, -90.0)
        magnitude[line] = -20.0
        shown, group = decimated(magnitude, 512)
        assert group == 2 and shown.max() == -20.0 and shown.argmax() == line // 2


def test_range_becomes_stale_by_the_clock_alone():
    """Nothing has to arrive for that."""
    now = [100.0]
    store = Store(clock=lambda: now[0])
    store.add_ranges('a/b', [reading()], [time.time_ns()])
    pair = store.pairs['a/b']
    assert not store.is_stale(pair)
    now[0] += STALE_AFTER + 0.05
    assert store.is_stale(pair)
    store.add_ranges('a/b', [reading(2)], [time.time_ns()])
    assert not store.is_stale(pair)


def test_a_slow_site_is_stale_later_and_one_interruption_makes_none_slow():
    slow, interrupted = Arrivals(), Arrivals()
    for i in range(4):
        slow.add(10.0 + i)
    assert slow.limit == 1.5 and not slow.is_stale(14.4) and slow.is_stale(14.6)
    for when in (10.0, 70.0, 70.05, 70.1, 70.15):
        interrupted.add(when)
        assert interrupted.limit == STALE_AFTER
    assert Arrivals().is_stale(0.0) and Arrivals().age(0.0) == math.inf


def test_weather_is_as_old_as_its_stamp_says():
    """A late joiner gets readings from before; a site may count its own time; a stamp may be missing."""
    now = [100.0]
    store = Store(clock=lambda: now[0])
    store.site['/site/temperature'] = SiteReading(15.0, 3 * SECOND, 100.0)
    store.site['/site/pressure'] = SiteReading(101_325.0, 0, 100.0)
    assert math.isnan(store.weather_age('/site/humidity')) and store.weather_age('/site/temperature') == 0.0
    store.add_ranges('a/b', [reading(stamp=1000 * SECOND)], [time.time_ns()])
    now[0] += 2.0
    assert store.weather_age('/site/temperature') == pytest.approx(999.0, abs=0.5)
    assert store.weather_age('/site/pressure') == pytest.approx(2.0)


def test_pair_without_a_range_is_stale():
    store = Store()
    store.add_ranges('a/b', [], [])
    assert store.is_stale(store.pairs['a/b'])


def test_error_is_that_against_the_reference_of_the_same_time():
    now = [100.0]
    store = Store(clock=lambda: now[0])
    for second in range(3):
        store.add_reference(second * SECOND, 10.0 + second, '')
    readings = [reading(1, SECOND, 11.002), reading(2, SECOND + SECOND // 2, 11.497)]
    store.add_ranges('a/b', readings, [time.time_ns()] * 2)
    assert math.isnan(store.pairs['a/b'].error)  # the next reading of the reference may still come
    now[0] += 1.0
    store.add_ranges('a/b', [], [])
    assert store.pairs['a/b'].error == pytest.approx(-0.003, abs=1e-9)
    curve = store.pairs['a/b'].histories['error'].curve(60, time.time_ns())
    assert curve.high.max() == pytest.approx(0.002, abs=1e-9)


def test_errors_are_kept_whatever_else_is_logged():
    """Lines come newest first; a node that says much displaces no warning and no error."""
    store = Store()
    store.add_logs([LogLine(0, 40, 'fusion', 'e'), LogLine(1, 30, 'fusion', 'w'), LogLine(2, 50, 'fusion', 'f')])
    for i in range(100):
        store.add_logs([LogLine(i, 20, 'master.station', str(i)), LogLine(i, 0, '', '')] * 10)
    assert [line.message for line in store.newest_logs(40)] == ['f', 'e']
    assert [line.message for line in store.newest_logs(30)] == ['f', 'w', 'e']
    shown = store.newest_logs(0)
    assert len(shown) == 103 and shown[-3:] == store.newest_logs(30) and shown[1].message == '99'


def test_verdicts_over_time_are_spans_that_silence_interrupts():
    kept = Verdicts()
    for when, level in ((0, 3), (1, 0), (2, 0), (3, 1), (4, 1), (30, 1), (31, 1)):
        kept.add(level, float(when))
    assert kept.since(-1.0) == [Span(0, 1, 3), Span(1, 3, 0), Span(3, 4, 1), Span(30, 31, 1)]
    assert kept.since(3.5) == [Span(3, 4, 1), Span(30, 31, 1)] and not kept.since(31.0)
    kept.add(1, 10.0)  # the clock was set back
    for i in range(10_000):
        kept.add(i % 2, 40.0 + i)
    assert len(kept.since(0.0)) <= 2000 and kept.since(0.0)[-1].end == 40.0 + 9999


def test_memory_is_bounded_whatever_names_arrive():
    store = Store()
    for i in range(1000):
        store.add_diagnostic(Diagnostic(0, f'/watch: Model a/{i}', '', '', (), 0.0))
        store.add_ranges(f'a/{i}', [reading()], [time.time_ns()])
        store.station(str(i))
    assert len(store.pairs) == len(store.stations) == len(store.verdicts) == 64


@given(
    strings=st.tuples(*[st.text(st.characters(codec='ascii', exclude_characters='\0'), max_size=20)] * 3),
    numbers=st.tuples(*[st.floats(allow_nan=False)] * 4),
    whole=st.tuples(*[st.integers(0, 2**bits - 1) for bits in (64, 8, 8, 32, 31, 30)]),
)
def test_bytes_are_read_as_ros_reads_them(strings, numbers, whole):
    """The strings decide where the numbers begin."""
    message = RangeEstimate(first_station=strings[1], second_station=strings[2])
    message.header.frame_id = strings[0]
    message.range, message.range_std, message.velocity, message.protection_level = numbers
    message.sweep_id, message.mode, message.flags, message.failed_tests = whole[:4]
    message.header.stamp.sec, message.header.stamp.nanosec = whole[4:]
    data = serialize_message(message)
    assert range_reading(data) == RangeReading(
        whole[0], whole[4] * SECOND + whole[5], whole[1], whole[2], whole[3], *numbers
    )
    with pytest.raises(ValueError, match='RangeEstimate of'):
        range_reading(data[:40])


def batch(distances, sweep_id=0, interval=0.001):
    """A RangeBatch as it arrives from fusion, of ranges published one after the other, the newest just now."""
    gathering = Gathering()
    rest = [math.nan] * 8  # fields that no display gets
    for i, distance in enumerate(distances):
        gathering.add(RangeResult(i, '', 'a', 'b', sweep_id + i, 1, 4, distance, 0.002, 0.5, *rest), i * interval)
    message = to_message(gathering.take((len(distances) - 1) * interval), RangeBatch)
    return deserialize_message(serialize_message(message), RangeBatch)


def test_no_outlier_of_a_batch_is_lost():
    """One range of 25 is far off: history, rate and count show all of them, each at its own time."""
    message = batch([100.0] * 7 + [160.0] + [100.0] * 17, sweep_id=40)
    readings = batch_readings(message)
    assert [r.sweep_id for r in readings] == list(range(40, 65)) and readings[-1].stamp == 24
    assert {(r.mode, r.flags, r.range_std, r.velocity) for r in readings} == {(1, 4, 0.002, 0.5)}
    now = time.time_ns()
    arrived = [now - round(age * 1e9) for age in message.age]
    assert np.diff(arrived) == pytest.approx(1e6, abs=2)
    store = Store(clock=lambda: 1000.0)
    store.add_ranges('a/b', readings, arrived)
    pair = store.pairs['a/b']
    assert (pair.count, pair.newest, pair.rate(1000.0)) == (25, readings[-1], 25.0)
    assert pair.histories['range'].curve(10, now).high.max() == 160.0


def test_a_batch_that_cannot_be_is_refused():
    short, old = batch([1.0, 2.0]), batch([1.0, 2.0])
    short.flags.pop()
    for age in (math.nan, -1e-3, 1e300):
        old.age[0] = age
        with pytest.raises(ValueError, match='age'):
            batch_readings(old)
    with pytest.raises(ValueError, match='1 to 2 elements'):
        batch_readings(short)
