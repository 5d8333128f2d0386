"""What the stream sends to each view, without a browser."""

import asyncio
import dataclasses
import json
import time
from xml.etree import ElementTree

import numpy as np
import pytest

from drfmcw_host.state.readings import Diagnostic, Health, Line, RangeReading, SiteReading, SpectrumReading
from drfmcw_host.state.store import Store
from drfmcw_host.state.verdicts import Span
from drfmcw_host.web.live import Live, Options
from drfmcw_host.web.views import diagnosis, signals, stations, strip
from drfmcw_host.web.views import now as now_view
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


def test_live_diagnosis_is_shown_whichever_namespace_its_node_has():
    store = Store()
    for name in ('/watch: Model master/slave', '/a/b/watch: Model a/b', '/fusion: Range a/b'):
        store.add_diagnostic(
            Diagnostic(1, name, 'left out of the model', 'x', (('verdict', 'explained'),), store.clock())
        )
    rows = diagnosis.update(store, Options('diagnosis'), True)['rows']['watch']
    assert sorted(row[1] for row in rows) == ['a → b', 'master → slave']
    assert rows[0][2] == 'left out of the model; verdict: explained'


def test_strip_shows_levels_by_height_where_they_were():
    """From 100 s to 200 s, 1000 units wide; what reaches beyond is cut off, labels are text."""
    spans = [Span(50.0, 120.0, 0), Span(120.0, 120.0, 1), Span(150.0, 250.0, 9)]
    shown = ElementTree.fromstring(strip.picture(spans, [99.0, 150.0], 100.0, 200.0, '<b>"&'))
    bars = [(b.get('data-state'), float(b.get('x')), float(b.get('width'))) for b in shown.findall('rect')]
    assert bars == [('good', 0.0, 200.0), ('doubtful', 200.0, 1.0), ('stale', 500.0, 500.0)]
    heights = [float(b.get('height')) for b in shown.findall('rect')]
    assert len(set(heights)) == 3 and shown.get('aria-label') == '<b>"&'
    assert [mark.get('d') for mark in shown.findall('path')] == ['M496.0 0h8l-4 10z']


@pytest.fixture
def live(store):
    """The same pair with ranges, lines and spectra ten times a second, and a clock to be set."""
    now = [100.0]
    store.clock = lambda: now[0]
    for i in range(5):
        now[0] = 100.0 + 0.1 * i
        store.add_ranges('master/slave', [RangeReading(i, i, 0, 0, 0, 100.0, 1e-3, 0.0, 1e-2)], [time.time_ns()])
        for own, peer in (('master', 'slave'), ('slave', 'master')):
            store.stations[own].add_line(peer, Line(i, 0, 6e5, 2.0, -60.0, 40.0), now[0])
            store.stations[own].add_spectrum(peer, SpectrumReading(i, 0.0, 1e3, np.full(512, -90.0)), now[0])
    return store, now


def test_signals_that_nothing_renews_are_stale(live):
    """Each station by its own; what was last heard stays, faded, and the waterfall stands."""
    store, now = live
    fresh = signals.update(store, Options('signals'), True)
    assert fresh['state']['spectra'] == 'good' and set(fresh['waterfall']) == {'master.waterfall', 'slave.waterfall'}
    assert fresh['rows']['budget'][0][1] == '-60.0 dBm'
    now[0] += 0.2
    store.stations['slave'].add_line('master', Line(9, 0, 6e5, 2.0, -60.0, 40.0), now[0])
    store.stations['slave'].add_spectrum('master', SpectrumReading(9, 0.0, 1e3, np.full(512, -90.0)), now[0])
    now[0] += 0.1
    found = signals.update(store, Options('signals'), True)
    assert found['state']['master.spectrum'] == 'stale' and found['state']['slave.spectrum'] == 'good'
    assert found['text']['master.spectrum'] == 'STALE: nothing for 0.3 s' and list(found['waterfall']) == [
        'slave.waterfall'
    ]
    first, second = found['rows']['budget']
    assert first[1] == {'text': '-60.0 dBm', 'state': 'stale'} and second[1] == '-60.0 dBm'
    faded = [
        s['lineStyle']['opacity'] + s['markLine']['lineStyle']['opacity'] for s in found['chart']['spectra']['series']
    ]
    assert faded == [0.6, 2.0]
    now[0] += 0.2
    assert signals.update(store, Options('signals'), False)['state']['spectra'] == 'stale'
    store.stations['master'].forget_signals()
    assert signals.update(store, Options('signals'), True)['rows']['budget'][0][1] == '–'


def test_a_browser_gets_along_when_a_range_becomes_stale(live):
    """So that it is grey in time although the host falls silent."""
    store, now = live
    now[0] += 0.1
    (expiry,) = now_view.update(store, Options('now'), True)['expire']
    assert expiry['after'] == pytest.approx(0.15, abs=0.03) and expiry['text']['hero.fresh'].startswith(
        'STALE: no range for 0.'
    )
    assert set(expiry['state'].values()) == {'stale'} and 'master/slave.card' in expiry['state']
    now[0] += 0.2
    stale = now_view.update(store, Options('now'), True)
    assert (
        stale['expire'] == [] and stale['state'].keys() >= expiry['state'].keys() and stale['state']['hero'] == 'stale'
    )


def test_weather_says_how_old_it_is(live):
    store, now = live
    store.site['/site/temperature'] = SiteReading(15.0, 0, now[0])
    now[0] += 187.5
    assert now_view.weather(store, 'de') == ('Wetter: 15,0 °C (vor 3:07 min) · – · –', 'good')
    now[0] += 800.0
    assert now_view.weather(store, 'en') == ('Weather, STALE: 15.0 °C (16:27 min ago) · – · –', 'stale')


class Socket:
    """A browser that takes messages until it leaves."""

    def __init__(self, address):
        self.client = type('Client', (), {'host': address})
        self.query_params = {'view': 'stations'}
        self.leaves = asyncio.Event()
        self.state = 'new'

    async def accept(self):
        self.state = 'open'

    async def close(self, code):
        self.state = code

    async def receive(self):
        await self.leaves.wait()

    async def send_text(self, text):
        assert 'layout' in json.loads(text)


def test_one_address_does_not_take_all_streams():
    async def watch():
        live = Live(Store())
        greedy, other = [Socket('10.0.7.9') for _ in range(60)], [Socket(f'10.0.8.{i}') for i in range(60)]
        serving = [asyncio.ensure_future(live.serve(socket)) for socket in (*greedy, *other)]
        await asyncio.sleep(0.1)
        assert [s.state for s in greedy] == ['open'] * 50 + [1013] * 10
        assert [s.state for s in other] == ['open'] * 50 + [1013] * 10
        for socket in greedy:
            socket.leaves.set()
        await asyncio.gather(*serving[:60])
        again = Socket('10.0.7.9')
        serving.append(asyncio.ensure_future(live.serve(again)))
        await asyncio.sleep(0.1)
        assert again.state == 'open'
        for socket in (*other, again):
            socket.leaves.set()
        await asyncio.gather(*serving)

    asyncio.run(watch())
