"""What the stream sends to each view, without a browser."""

import dataclasses

import pytest

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
