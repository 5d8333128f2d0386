"""No message ends a process or changes a range unseen: plausible values, fuzzed callbacks, sweeps without a signal."""

import array
import dataclasses
import math
import time

import numpy as np
import pytest
import rclpy
from drfmcw_msgs.msg import (
    BeatFrequency,
    CompressedIfSamples,
    IfSamples,
    StationCalibration,
    StationStatus,
    SweepConfig,
    SweepSchedule,
)
from hypothesis import HealthCheck, example, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from rclpy.node import Node
from scenes import record, scene
from sensor_msgs.msg import FluidPressure, RelativeHumidity, Temperature

from drfmcw_fusion.fusion import FusionNode
from drfmcw_fusion.offline import replay_recording
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.processing.processor import StationProcessor
from drfmcw_node.station import StationNode
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.plausible import LIMITS, refusal
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.graph.messages import to_message
from drfmcw_ros.graph.publishers import Publishers
from drfmcw_ros.nodes.diagnostics import Diagnostics, Status
from drfmcw_ros.nodes.runner import Executor, Finished, failures, spin, spinning

START = 1_700_000_000_000_000_000
FUZZ = hypothesis_settings(
    max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture(scope='module', autouse=True)
def context():
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.fixture(scope='module')
def fusion():
    node = FusionNode()
    for names_of in (('master', 'slave'), ('slave', 'master')):  # so that beats meet their partners
        role = 1 + (names_of[0] == 'slave')
        node._sweep_config(to_message(SweepSettings(*names_of, role=role, stamp=START - 2), SweepConfig))
    yield node
    node.destroy_node()


@pytest.fixture(scope='module')
def station():
    node = StationNode(namespace='/master')
    yield node
    node.destroy_node()


numbers = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-300, 1e308, math.nan, math.inf, -math.inf, 5725e6, 150e6, 1e-3, 2.048e6]),
)
names = st.one_of(
    st.sampled_from(['master', 'slave', '', 'a\nb', 'x' * 5000, 'hann', 'flac', '/../x']), st.text(max_size=8)
)
SIGNED = {'int32': 32}
UNSIGNED = {'uint8': 8, 'uint16': 16, 'uint32': 32, 'uint64': 64}


def values(kind):
    if kind in ('double', 'float'):
        return numbers
    if kind == 'string':
        return names
    if kind == 'boolean':
        return st.booleans()
    if kind in UNSIGNED:
        return st.integers(0, 2 ** UNSIGNED[kind] - 1) | st.integers(0, 3)
    if kind in SIGNED:
        return st.integers(-(2 ** (SIGNED[kind] - 1)), 2 ** (SIGNED[kind] - 1) - 1)
    if kind == 'sequence<int16>':
        return st.lists(st.integers(-(2**15), 2**15 - 1), max_size=40) | st.just([0] * 2048)
    return st.binary(max_size=60)


@st.composite
def messages(draw, kind):
    """A message of which any field may hold anything that its type allows, starting from a plausible one."""
    message = draw(st.sampled_from(plausible(kind)))()
    if getattr(message, 'peer', '') and draw(st.booleans()):
        message.station, message.peer = message.peer, message.station
        if hasattr(message, 'role'):
            message.role = 2
    fields = kind.get_fields_and_field_types()
    for name in draw(st.lists(st.sampled_from([n for n in fields if n != 'header']), unique=True)):
        value = draw(values(fields[name]))
        setattr(message, name, array.array('h', value) if isinstance(value, list) else value)
    if draw(st.booleans()):
        message.header.stamp.sec = draw(st.integers(-(2**31), 2**31 - 1))
        message.header.stamp.nanosec = draw(st.integers(0, 2**32 - 1))
        message.header.frame_id = draw(names)
    return message


def plausible(kind):
    sweep = SweepSettings('master', 'slave', stamp=START - 1)
    made = {
        SweepConfig: sweep,
        StationCalibration: Calibration('master', stamp=START - 1),
    }
    if kind in made:
        return [lambda: to_message(made[kind], kind)]

    def filled():
        message = kind()
        for name, value in (
            ('station', 'master'),
            ('peer', 'slave'),
            ('full_scale', 32767.0),
            ('frequency', 5e5),
            ('frequency_std', 10.0),
        ):
            if hasattr(message, name):
                setattr(message, name, value)
        message.header.stamp.sec = START // 10**9
        return message

    return [filled]


@FUZZ
@given(st.data())
def test_fusion_survives_any_message(fusion, data):
    """Every subscribed message with any field wrong: no exception, whatever came before."""
    kind, take = data.draw(
        st.sampled_from(
            [
                (BeatFrequency, lambda m: fusion._beats(m.station, Publishers('/any/beat_frequency'), [m])),
                (SweepConfig, fusion._sweep_config),
                (SweepSchedule, fusion._sweep_schedule),
                (StationCalibration, fusion._calibration),
                (StationStatus, fusion._status),
                (Temperature, lambda m: fusion._weather('/site/temperature', m)),
                (FluidPressure, lambda m: fusion._weather('/site/pressure', m)),
                (RelativeHumidity, lambda m: fusion._weather('/site/humidity', m)),
            ]
        )
    )
    take(data.draw(messages(kind)))
    for task in (fusion._diagnose_pairing, fusion._diagnose_inputs, lambda s: fusion._diagnose(('master', 'slave'), s)):
        task(Status())


@FUZZ
@given(st.data())
def test_station_survives_any_message(station, data):
    kind, take = data.draw(
        st.sampled_from(
            [
                (IfSamples, lambda m: station._take_samples([m])),
                (CompressedIfSamples, lambda m: station._take_compressed([m])),
                (SweepConfig, station._take_sweep_config),
                (StationCalibration, station._take_calibration),
            ]
        )
    )
    take(data.draw(messages(kind)))
    station._diagnose_sweeps(Status())
    station._diagnose_inputs(Status())


@given(st.sampled_from(sorted(LIMITS)), st.data())
@example('RelativeHumidity', None)
def test_every_reason_names_field_value_and_range(kind, data):
    if data is None:
        field, value = 'relative_humidity', 75.0
    else:
        field = data.draw(st.sampled_from(sorted(LIMITS[kind])))
        value = data.draw(numbers)
    reason = LIMITS[kind][field].reason(field, value)
    if not reason:
        return
    assert reason.startswith(field)
    assert '\n' not in reason
    assert math.isnan(value) or '...' in reason


@pytest.mark.parametrize(
    ('kind', 'field', 'value', 'hint'),
    [
        (RelativeHumidity, 'relative_humidity', 75.0, 'looks like %'),
        (FluidPressure, 'fluid_pressure', 1013.25, 'looks like hPa'),
        (FluidPressure, 'fluid_pressure', 101.3, 'looks like kPa'),
        (FluidPressure, 'fluid_pressure', 1e9, 'outside'),
        (Temperature, 'temperature', 288.15, 'looks like K'),
        (Temperature, 'temperature', -273.15, 'outside'),
    ],
)
def test_weather_in_wrong_units_is_refused_and_named(kind, field, value, hint):
    reason = refusal(kind.__name__, kind(**{field: value}))
    assert hint in reason
    assert field in reason


def test_implausible_weather_leaves_the_last_plausible_one(fusion):
    """Humidity 75 instead of 0.75: refused, counted, said in diagnostics; the reading before stays."""
    for value in (0.75, 75.0):
        message = RelativeHumidity(relative_humidity=value)
        message.header.stamp.sec = START // 10**9
        before = fusion._refused
        fusion._weather('/site/humidity', message)
    assert fusion._refused == before + 1
    assert fusion._fusion._weather['humidity'].at(START)[1][0] == 0.75
    status = Status()
    fusion._diagnose_inputs(status)
    assert any('looks like %' in line for line in status.messages)


def test_calibration_without_phase_noise_corner_harms_nothing(fusion):
    """A latched calibration with corner 0 killed fusion at every restart."""
    message = to_message(Calibration('master', stamp=START), StationCalibration)
    message.phase_noise_level, message.phase_noise_corner = -90.0, 0.0
    before = fusion._refused
    fusion._calibration(message)
    assert fusion._refused == before + 1
    assert 'phase_noise_corner' in fusion._refusal


@pytest.mark.parametrize('constant', [0, 77])
@pytest.mark.parametrize('estimator', ['paper', 'hann', 'ml', 'pair'])
def test_sweep_without_signal_gives_no_range_and_ends_nothing(tmp_path, constant, estimator, monkeypatch):
    """One all-zero or constant sweep (a fade on an 8-bit ADC): flagged and NaN, the others as before."""
    path = str(record(scene({'standing': {'distances': [100.0], 'sweeps': 20}}), tmp_path / 'r'))
    settings = EstimatorSettings(estimator=estimator)
    clean = replay_recording(path, settings).results
    original = StationProcessor._process

    def blank(self, sweeps, every):
        sweeps = [
            dataclasses.replace(s, samples=np.full(2048, constant, np.int16)) if s.sweep_id == 7 else s for s in sweeps
        ]
        return original(self, sweeps, every)

    monkeypatch.setattr(StationProcessor, '_process', blank)
    if estimator == 'pair':
        from drfmcw_node.processing.pair_processor import PairProcessor

        matched = PairProcessor._matched

        def blank_pairs(self, sweeps):
            return matched(
                self,
                [
                    dataclasses.replace(s, samples=np.full(2048, constant, np.int16)) if s.sweep_id == 7 else s
                    for s in sweeps
                ],
            )

        monkeypatch.setattr(PairProcessor, '_matched', blank_pairs)
    found = replay_recording(path, settings).results
    assert len(found) == len(clean) == 20
    assert math.isnan(found[7].range)
    assert found[7].flags & 1
    assert all(math.isfinite(r.range) for r in found if r.sweep_id != 7)


class Failing(Node):
    """A node one of whose callbacks fails."""

    def __init__(self):
        super().__init__('failing')
        self.calls = 0
        self.diagnostics = Diagnostics(self, 'x')
        self.create_timer(0.005, self.work)

    def work(self):
        self.calls += 1
        if self.calls == 20:
            raise Finished
        if self.calls % 2:
            raise ZeroDivisionError('no\nsuch thing')


def test_exception_in_a_callback_is_counted_and_survived():
    node = Failing()
    executor = Executor()
    executor.add_node(node)
    with pytest.raises(Finished):
        spin(executor, node)
    assert failures(node).count == 10
    assert failures(node).last.startswith('ZeroDivisionError: no such thing (')
    status = Status()
    node.diagnostics._report_failures(status)
    assert 'ZeroDivisionError' in status.messages[0]
    assert not node.diagnostics._report_failures(Status())
    node.destroy_node()


def test_exception_in_a_thread_beside_is_counted_and_survived():
    node = Failing()
    with spinning(node):
        end = time.monotonic() + 60.0
        while node.calls < 19 and time.monotonic() < end:
            time.sleep(0.01)
    assert failures(node).count >= 9, 'the thread went on after each'
    node.destroy_node()
