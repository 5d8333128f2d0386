"""A calibration that a host stores on a station: used, published, there after the next start, or refused."""

import dataclasses

import pytest
import rclpy
from drfmcw_msgs.msg import StationCalibration
from drfmcw_msgs.srv import StoreCalibration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from drfmcw_node.station import StationNode
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.calibration.document import Clock, Delay, Document, Temperatures
from drfmcw_ros.calibration.store import CalibrationStore
from drfmcw_ros.graph import qos

WAIT = 20.0  # for an answer, on a busy machine [s]
DOCUMENT = Document(
    'master',
    temperature=Temperatures(25.0, -10.0, 45.0),
    reference_clock=Clock(1.000037, 2e-8, -2e-7),
    sample_clock=Clock(1.000018, 2e-8),
    delay=Delay(12.3e-9, 1.7e-11, peer='slave'),
)


@pytest.fixture(scope='module', autouse=True)
def context():
    rclpy.init()
    yield
    rclpy.try_shutdown()


class Host(Node):
    """Stores calibrations on a station in the same process, and hears what it publishes."""

    def __init__(self, state, **parameters):
        super().__init__('host')
        values = {'source': 'tcp', 'ip_port': 0, 'peer': 'slave', 'state_directory': str(state)} | parameters
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        self.station = StationNode(namespace='/master', parameter_overrides=overrides)
        self.heard = []
        qos.subscription(
            self, StationCalibration, '/master/calibration', self.heard.append, qos.latched_subscription(1)
        )
        self.client = self.create_client(StoreCalibration, '/master/store_calibration')
        self.executor_ = SingleThreadedExecutor()
        for node in (self, self.station):
            self.executor_.add_node(node)

    def until(self, condition):
        for _ in range(int(WAIT / 0.05)):
            if condition():
                return
            self.executor_.spin_once(timeout_sec=0.05)
        raise AssertionError('no answer in time')

    def store(self, document, operator='A. Operator'):
        self.until(self.client.service_is_ready)
        future = self.client.call_async(StoreCalibration.Request(document=document, operator_name=operator))
        self.until(future.done)
        return future.result()

    def close(self):
        self.station.destroy_node()
        self.destroy_node()


@pytest.fixture
def host(tmp_path):
    made = []

    def make(**parameters):
        made.append(Host(tmp_path, **parameters))
        return made[-1]

    yield make
    for each in made:
        each.close()


def test_stored_calibration_is_published_and_outlives_the_process(host, tmp_path):
    first = host()
    first.until(lambda: first.heard)
    assert first.heard[-1].alpha == 1.0 and first.heard[-1].version == 0
    answer = first.store(DOCUMENT.text())
    assert (answer.accepted, answer.version) == (True, 1)
    first.until(lambda: first.heard[-1].version == 1)
    message = first.heard[-1]
    assert (message.alpha, message.alpha_linear, message.delay_peer) == (1.000037, -2e-7, 'slave')
    assert (message.alpha_std, message.delay_std, message.temperature_high) == (2e-8, 1.7e-11, 45.0)
    first.close()
    assert CalibrationStore(tmp_path).read('master').operator == 'A. Operator'
    second = host()
    second.until(lambda: second.heard)
    assert second.heard[-1].version == 1 and second.heard[-1].alpha == 1.000037


def test_parameters_given_at_start_replace_single_values(host, tmp_path):
    CalibrationStore(tmp_path).add(DOCUMENT)
    station = host(**{'calibration.delay': 13e-9})
    station.until(lambda: station.heard)
    assert (station.heard[-1].delay, station.heard[-1].alpha) == (13e-9, 1.000037)


@pytest.mark.parametrize(
    ('document', 'reason'),
    [
        (dataclasses.replace(DOCUMENT, station='slave').text(), "is of station 'slave', this is 'master'"),
        (dataclasses.replace(DOCUMENT, delay=Delay(12.3)).text(), 'delay = 12.3 s is outside'),
        (DOCUMENT.text().replace('1.23e-08', '1.33e-08'), 'the checksum does not match'),
        ('x' * 70000, '70000 letters'),
        ('a: [', 'document line'),
    ],
)
def test_implausible_documents_are_refused_with_the_reason(host, tmp_path, document, reason):
    station = host()
    answer = station.store(document)
    assert (answer.accepted, answer.version) == (False, 0)
    assert reason in answer.reason and '\n' not in answer.reason
    assert not list(tmp_path.rglob('*.yaml'))
    station.until(lambda: station.heard)
    assert station.heard[-1].version == 0


def test_damaged_document_stops_the_start_in_one_line(tmp_path):
    store = CalibrationStore(tmp_path)
    store.add(DOCUMENT)
    path = store.path('master', 1)
    path.write_text(path.read_text().replace('1.23e-08', '1.33e-08'))
    with pytest.raises(ConfigurationError, match=r'000001\.yaml: the checksum does not match'):
        Host(tmp_path)
