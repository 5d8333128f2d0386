"""What the stream sends to each view, without a browser."""

import dataclasses

import pytest

from drfmcw_host.state.readings import Diagnostic, Health
from drfmcw_host.state.store import Store
from drfmcw_host.web.live import Options
from drfmcw_host.web.views import stations
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import Mode, Role, SweepSettings

CALIBRATION = Calibration('master', alpha=1.000037, alpha_std=2e-8, delay=12.3e-9, delay_std=1.7e-11)


@pytest.fixture
def store():
    """A pair in the short-distance mode; only the first station is calibrated."""
    store = Store()
    store.pair('master/slave')
    for own, peer, role in (('master', 'slave', Role.FIRST), ('slave', 'master', Role.SECOND)):
        settings = SweepSettings(own, peer, role=role, mode=Mode.SHORT_DISTANCE, start_delay=3.41e-6)
        store.station(own).settings[peer] = settings
    store.stations['master'].calibration = CALIBRATION
    return store


def test_calibration_in_use_is_shown_with_its_uncertainty(store):
    texts = stations.update(store, Options('stations'), True)['text']
    assert texts['master.alpha'] == '+37.000 ± 0.02 ppm'
    assert texts['master.adc'] == '+0.000 ± ? ppm'  # a calibration states 0 for an unknown one
    assert texts['master.delay'] == '12.300 ± 0.017 ns'
    assert texts['master.uncertainty'].startswith('master → slave: ± 5.0') and texts['slave.calibrated'] == 'none'
    twice = dataclasses.replace(CALIBRATION, alpha_std=4e-8)
    store.stations['master'].calibration = twice
    german = stations.update(store, Options('stations', 'de'), True)['text']
    assert german['master.alpha'] == '+37,000 ± 0,04 ppm' and german['slave.calibrated'] == 'keine'


def test_clock_difference_is_that_of_the_shortest_way(store):
    """A clock 3 ms ahead; the ways take 1 ms to 40 ms. One that is set back shows after ten messages."""
    for way in (40, 7, 1, 12):
        store.add_health('master', Health(25.0, True, 10, 0, 1.0), 1_000_000_000, 997_000_000 + way * 1_000_000)
    assert stations.update(store, Options('stations'), True)['text']['master.clock'] == '-2.0 ms'
    for _ in range(10):
        store.add_health('master', Health(25.0, True, 10, 0, 1.0), 1_000_000_000, 9_000_000_000)
    assert stations.update(store, Options('stations'), True)['text']['master.clock'] == '+8000.0 ms'


def test_software_of_a_station_is_compared_with_the_host():
    store = Store(software={'python': '3.11.7', 'drfmcw_node': 'aa', 'drfmcw_host': 'cc'})

    def said(name, hardware, node_digest):
        values = (('python', '3.11.7'), ('drfmcw_node', node_digest), ('drfmcw_gateway', 'dd'))
        store.add_diagnostic(Diagnostic(0, name, 'drfmcw 0.1.0', hardware, values, store.clock()))

    for station in ('master', 'slave', 'tower'):
        store.station(station)
    said('/master/station: Software', 'master', 'aa')
    said('/pair_station: Software', 'slave', 'bb')
    said('/fusion: Software', 'fusion', 'bb')
    found = stations.update(store, Options('stations'), True)
    assert found['text']['master.software'] == 'drfmcw 0.1.0, the same as on the host'
    assert found['text']['slave.software'] == 'drfmcw 0.1.0, other than on the host: drfmcw_node'
    assert (found['state']['slave.software'], found['text']['tower.software']) == ('doubtful', '–')
