"""As fast as the graph goes, the simulator keeps a bounded number of sweeps under way, whoever falls behind."""

import signal
import time

import pytest
from drfmcw_msgs.msg import BeatFrequency
from test_graph import STANDING, scenario_file, site

from drfmcw_bringup.graph import FUSION, SIMULATOR, STATION, parameters
from drfmcw_bringup.run import PATIENT
from drfmcw_ros.graph import qos

pytestmark = pytest.mark.graph

WINDOW = 5


def beats_of(live):
    """Return a list whose last entry is the newest sweep that the slave has evaluated."""
    found = [-1]
    live.monitor.create_subscription(
        BeatFrequency, '/slave/beat_frequency', lambda m: found.append(m.sweep_id), qos.DEEP
    )
    return found


def test_slow_fusion_is_waited_for_and_a_dead_one_is_not(tmp_path):
    """Fusion that stands still holds up the sweeps and misses none; without it the simulation goes on."""
    path = scenario_file(tmp_path, STANDING)
    with site(tmp_path) as live:
        beats = beats_of(live)
        live.start(path, {'pace': 'subscribers', 'window': WINDOW, 'acknowledge_timeout': 15.0})
        live.wait(lambda: live.monitor.total > 50, 'the first ranges')
        fusion = live.graph.members['fusion'].process
        for _ in range(2):
            fusion.send_signal(signal.SIGSTOP)
            time.sleep(1.0)  # for more sweeps than the window, unless something holds them up
            ahead = beats[-1] - live.monitor.newest['master/slave'].sweep_id
            count = live.monitor.total
            fusion.send_signal(signal.SIGCONT)
            assert ahead <= 2 * WINDOW
            live.wait(lambda count=count: live.monitor.total > count + 50, 'ranges as before')
        ids = [arrival.sweep_id for arrival in live.monitor.arrivals]
        assert ids == list(range(ids[0], ids[0] + len(ids)))
        assert 'going on without' not in live.log('simulator')
        fusion.send_signal(signal.SIGKILL)
        live.wait(lambda: 'no range of master/slave: going on' in live.log('simulator'), 'the simulator to go on')
        reached = beats[-1]
        live.wait(lambda: beats[-1] > reached + 4 * WINDOW, 'sweeps without fusion')
        live.graph.stop('fusion')
        live.graph.start('fusion', FUSION, '--pair', 'master/slave', *PATIENT)  # as the first one: it begins behind
        live.wait(lambda: 'master/slave has ranges again' in live.log('simulator'), 'ranges of another fusion')


def test_graph_without_fusion_goes_on(tmp_path):
    """Stations alone set the pace, and nobody misses the ranges."""
    path = scenario_file(tmp_path, STANDING)
    with site(tmp_path) as live:
        beats = beats_of(live)
        for name in ('master', 'slave'):
            live.graph.start(f'station_{name}', STATION, '--station', name)
        settings = {'pace': 'subscribers', 'acknowledge_timeout': 0.5, 'mode_control': 'range'}
        live.graph.start('simulator', SIMULATOR, *parameters({'scenario': path} | settings))
        live.wait(lambda: beats[-1] > 100, 'sweeps')
        assert 'no range' not in live.log('simulator')
