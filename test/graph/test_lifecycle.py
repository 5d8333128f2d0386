"""The life cycle of station and fusion, through the services that `ros2 lifecycle` calls, with real processes."""

import pytest
from drfmcw_msgs.msg import BeatFrequency
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from test_graph import STANDING, scenario_file, site

from drfmcw_bringup.graph import FUSION, SIMULATOR, STATION, parameters

pytestmark = [pytest.mark.graph, pytest.mark.timeout(180)]

MASTER = '/master/station'
UNCONFIGURED, INACTIVE, ACTIVE = (
    State.PRIMARY_STATE_UNCONFIGURED,
    State.PRIMARY_STATE_INACTIVE,
    State.PRIMARY_STATE_ACTIVE,
)
CONFIGURE, CLEANUP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE


def call(live, kind, service, request):
    """The answer of a service."""
    client = live.monitor.create_client(kind, service)
    live.wait(client.service_is_ready, service)
    future = client.call_async(request)
    live.wait(future.done, f'the answer of {service}')
    live.monitor.destroy_client(client)
    return future.result()


def change(live, node, transition):
    """Whether a node makes a transition."""
    request = ChangeState.Request(transition=Transition(id=transition))
    return call(live, ChangeState, f'{node}/change_state', request).success


def state(live, node):
    return call(live, GetState, f'{node}/get_state', GetState.Request()).current_state.id


def rests(live, counted, going_on):
    """Whether one count stays as it is while another one grows by 25; what was under way has arrived after 10."""
    begun = going_on()
    live.wait(lambda: going_on() >= begun + 10, 'what goes on')
    count = counted()
    live.wait(lambda: going_on() >= begun + 35, 'what goes on')
    return counted() == count


def test_station_and_fusion_go_through_their_states(tmp_path):
    """Unconfigured without topics, inactive without a message, active as always, and all of it once more."""
    waiting = parameters({'autostart': False})
    with site(tmp_path) as live:
        live.listen()
        live.graph.start('slave', STATION, '--station', 'slave')
        live.graph.start('master', STATION, '--station', 'master', *waiting)
        live.graph.start('fusion', FUSION, '--pair', 'master/slave', *waiting)
        scenario = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.02})
        live.graph.start('simulator', SIMULATOR, *parameters({'scenario': str(scenario)}))
        monitor = live.monitor
        beats = {'master': [], 'slave': []}
        for station, heard in beats.items():
            monitor.create_subscription(BeatFrequency, f'/{station}/beat_frequency', heard.append, 100)
        live.wait(lambda: len(beats['slave']) > 10, 'the station that starts by itself')
        assert state(live, '/slave/station') == ACTIVE
        for node in (MASTER, '/fusion'):
            assert state(live, node) == UNCONFIGURED
        assert monitor.count_publishers('/master/beat_frequency') == 0
        assert monitor.count_publishers('/master/slave/range') == 0
        assert not change(live, MASTER, ACTIVATE), 'not before it is configured, and it says so'
        key = 'fusion', '/fusion: Pairing'
        for round_number in (1, 2):
            for node in (MASTER, '/fusion'):
                assert change(live, node, CONFIGURE)
                assert state(live, node) == INACTIVE
            live.wait(lambda: monitor.count_publishers('/master/slave/range') == 1, 'the topics')
            assert rests(live, lambda: len(beats['master']), lambda: len(beats['slave']))
            live.wait(lambda: key in live.diagnostics and live.diagnostics[key].message == 'inactive', 'diagnostics')
            assert change(live, MASTER, ACTIVATE)
            assert rests(live, lambda: monitor.total, lambda: len(beats['master']))
            assert change(live, '/fusion', ACTIVATE)
            before = monitor.total
            live.wait(lambda n=before: monitor.total > n + 50, f'ranges, round {round_number}')
            assert abs(monitor.newest['master/slave'].range - 100.0) < 0.1
            assert change(live, '/fusion', DEACTIVATE)
            assert rests(live, lambda: monitor.total, lambda: len(beats['master']))
            assert change(live, MASTER, DEACTIVATE)
            assert rests(live, lambda: len(beats['master']), lambda: len(beats['slave']))
            for node in (MASTER, '/fusion'):
                assert change(live, node, CLEANUP)
                assert state(live, node) == UNCONFIGURED
            live.wait(lambda: monitor.count_publishers('/master/slave/range') == 0, 'the end of the topics')
        for name in ('master', 'fusion'):
            assert 'Traceback' not in live.log(name)


def test_station_with_a_digitiser_opens_its_port_while_it_is_active(tmp_path):
    """A port that another one holds refuses the activation, with the reason; once it is free, the call succeeds."""
    with site(tmp_path) as live:
        feed = {'source': 'tcp', 'ip_port': 0, 'peer': 'slave', 'ip_address': '127.0.0.1'}
        live.graph.start('master', STATION, '--station', 'master', *parameters(feed))
        live.wait(lambda: 'listening for sweeps at' in live.log('master'), 'the first station')
        port = int(live.log('master').rpartition('tcp://127.0.0.1:')[2].split()[0])
        other = feed | {'ip_port': port, 'peer': 'master', 'autostart': False}
        live.graph.start('slave', STATION, '--station', 'slave', *parameters(other))
        node = '/slave/station'
        assert change(live, node, CONFIGURE)
        assert not change(live, node, ACTIVATE)
        assert state(live, node) == INACTIVE
        assert f'{port}' in live.log('slave')
        assert change(live, MASTER, DEACTIVATE)
        assert change(live, node, ACTIVATE)
        live.wait(lambda: live.monitor.count_publishers('/slave/status') == 1, 'the status')
        assert change(live, node, DEACTIVATE)
        live.wait(lambda: live.monitor.count_publishers('/slave/status') == 0, 'the end of the status')
        assert change(live, MASTER, ACTIVATE), 'the port is free again'
        for name in ('master', 'slave'):
            assert 'Traceback' not in live.log(name)
