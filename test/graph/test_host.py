"""The host's page in a real Chromium, beside a real graph: what it shows is true, and who may not change does not."""

import contextlib
import dataclasses
import json
import re
import shutil
import signal
from pathlib import Path

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from drfmcw_msgs.msg import RangeEstimate
from hosted import PASSWORD, USER, Pages, chromium, inaccessible, repeated, wait
from playwright.sync_api import Page, expect
from ports import free_port
from rcl_interfaces.msg import Log
from rclpy.parameter import parameter_dict_from_yaml_file
from scenes import mapping

from drfmcw_bringup.graph import Graph, private_environment
from drfmcw_bringup.monitor import RangeMonitor, monitored
from drfmcw_bringup.run import start_graph
from drfmcw_host.files.recordings import Recordings
from drfmcw_host.web.frame import VIEWS, path_of
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_ros.calibration.store import CalibrationStore
from drfmcw_ros.commands.cli import write_atomically
from drfmcw_ros.graph import qos
from drfmcw_sim.scenario import read_scenario

pytestmark = [pytest.mark.graph, pytest.mark.slow]

HOSTILE = '<img src=x onerror="window.hacked=1">{{ constructor }}<script>window.hacked=1</script>'
STANDING = {'standing': {'distances': [100.0], 'sweeps': 1_000_000}}
SHOWN = """() => {
  const text = (key) => document.querySelector(`[data-field="hero.${key}"]`).textContent;
  return [document.querySelector('[data-field="hero.range"]').dataset.sweep, text('range'), text('std'),
          document.querySelector('[data-field=hero]').dataset.state];
}"""


@dataclasses.dataclass(kw_only=True)
class Site(Pages):
    """A simulated site beside the host."""

    monitor: RangeMonitor
    stations: Path  # where the stations keep their calibrations


@pytest.fixture(scope='module')
def site(tmp_path_factory):
    """One simulated site with its host for all tests."""
    directory = tmp_path_factory.mktemp('site')
    scenario = directory / 'scenario.yaml'
    scenario.write_text(yaml.safe_dump(mapping(STANDING, timing={'sweep_interval': 0.05})))
    stations = directory / 'drfmcw'
    environment = private_environment() | {'XDG_STATE_HOME': str(directory)}
    with (
        Graph(environment, directory / 'log') as graph,
        monitored(['master/slave'], int(environment['ROS_DOMAIN_ID']), keep=True) as monitor,
        chromium() as browser,
    ):
        start_graph(graph, scenario, read_scenario(scenario), {'state_directory': str(stations)}, monitor)
        opened = Site(
            graph=graph,
            state=directory / 'state',
            port=free_port(),
            browser=browser,
            monitor=monitor,
            stations=stations,
        )
        opened.start_host()
        wait(lambda: monitor.total, 'the first range')
        yield opened


def fresh(page: Page) -> None:
    """Wait until the page shows a current range."""
    expect(page.locator('[data-field="hero"]')).not_to_have_attribute('data-state', 'stale')
    page.wait_for_function('() => document.querySelector(\'[data-field="hero.range"]\').dataset.sweep')


def test_page_shows_the_values_of_the_topic(site):
    """Text, standard deviation and state are those of the message of the same sweep, for ten different sweeps."""
    seen: dict[int, list[str]] = {}
    with site.page() as page:
        fresh(page)
        while len(seen) < 10:
            sweep, *shown = page.evaluate(SHOWN)
            seen[int(sweep)] = shown
            page.wait_for_timeout(60)
    messages = {a.sweep_id: a.message for a in site.monitor.arrivals}
    for sweep, (distance, std, state) in seen.items():
        message = messages[sweep]
        assert distance == f'{message.range:.3f}' and std == f'{message.range_std * 1e3:.2f} mm'
        assert state in ('good' if not message.flags else 'doubtful', 'stale')


@contextlib.contextmanager
def silenced(site, name='simulator'):
    """Stop a process for a while."""
    process = site.graph.members[name].process
    process.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        process.send_signal(signal.SIGCONT)


def test_page_says_when_nothing_arrives_and_recovers(site):
    """The age counts although no message comes; afterwards the page is current again."""
    with site.page() as page:
        colour = 'getComputedStyle(document.querySelector(".hero .big")).color.match(/[0-9]+/g).map(Number)'
        # state and colour at one instant: a busy machine's page may turn grey between two questions
        current = 'document.querySelector("[data-field=hero]").dataset.state !== "stale"'
        fresh(page)
        black = page.wait_for_function(f'() => {current} && {colour}').json_value()
        with silenced(site):
            chip = page.locator('[data-field="hero.fresh"]')
            expect(chip).to_have_text(re.compile('STALE: no range for [1-9]'))  # what was on its way has arrived
            before = chip.text_content()
            expect(chip).not_to_have_text(before)
            expect(page.locator('[data-field="hero"]')).to_have_attribute('data-state', 'stale')
            grey = page.evaluate(colour)
            assert max(grey) - min(grey) < 30 and min(grey) > max(black) + 30
        fresh(page)


CLOCKED = """() => new Promise((grey) => {
  const hero = document.querySelector('[data-field=hero]'), range = document.querySelector('[data-field="hero.range"]');
  let newest = performance.now();
  new MutationObserver(() => { newest = performance.now(); }).observe(range, {attributeFilter: ['data-sweep']});
  const look = () => {
    const stale = hero.dataset.state === 'stale' || document.documentElement.dataset.lost === 'true';
    if (stale) grey(performance.now() - newest); else setTimeout(look, 5);
  };
  look();
})"""


@pytest.mark.parametrize('silent', ['simulator', 'host'])
def test_page_is_grey_within_half_a_second(site, silent):
    """By the page's own clock, from the last range that it showed; a busy machine may delay some of the tries."""
    took = []
    with site.page() as page:
        while not took or (min(took) > 500.0 and len(took) < 5):
            fresh(page)
            page.evaluate(f'window.grey = ({CLOCKED})(); 0')
            with silenced(site, silent):
                took.append(page.evaluate('window.grey'))
                expect(page.locator('[data-field="hero"]')).to_have_attribute('data-state', 'stale')
    assert min(took) <= 500.0, took


def test_signals_become_stale_too(site):
    """What is shown stays, greyed, and says since when."""
    with site.page('/signals') as page:
        for station in ('master', 'slave'):
            expect(page.locator(f'[data-field="{station}.spectrum"]')).to_have_text('current')
        row = page.locator('tbody[data-field=budget] tr', has_text='slave').locator('td')
        expect(row.nth(1)).to_contain_text('dBm')  # it comes later than the spectra
        with silenced(site):
            expect(page.locator('[data-field="master.spectrum"]')).to_have_text(re.compile('STALE: nothing for [1-9]'))
            expect(page.locator('[data-field="spectra"]')).to_have_attribute('data-state', 'stale')
            expect(row.last).to_have_text(re.compile('STALE: nothing for [1-9]'))
            expect(row.nth(1)).to_have_attribute('data-state', 'stale')
            assert 'dBm' in row.nth(1).text_content()
        expect(page.locator('[data-field="master.spectrum"]')).to_have_text('current')


def parameter_row(page: Page, name: str):
    row = page.locator(f'[data-parameter="{name}"]')
    row.wait_for()
    return row


def test_parameter_is_changed_refused_undone_and_saved(site):
    """All as the node itself says; the log has time, user and the node's reason."""
    name = 'maximum_range'
    with site.page('/configuration', user=True) as page:
        row = parameter_row(page, name)
        before = row.locator('input').input_value()
        row.locator('input').fill('4321.5')
        row.locator('input').press('Enter')
        page.get_by_text(f'/fusion: {name} = 4321.5').first.wait_for()
        expect(parameter_row(page, name).locator('input')).to_have_value('4321.5')
        row = parameter_row(page, name)
        row.locator('input').fill('-5')
        row.locator('input').press('Enter')
        page.get_by_text(f'/fusion refused {name} = -5').first.wait_for()
        page.get_by_role('button', name='Reload').click()
        expect(parameter_row(page, name).locator('input')).to_have_value('4321.5')
        page.get_by_role('button', name='Save as parameter file').click()
        page.get_by_text('./drfmcw run --parameters').first.wait_for()
        page.get_by_role('button', name='Undo').first.click()
        expect(parameter_row(page, name).locator('input')).to_have_value(before)
    changes = [entry for entry in site.audit() if entry['action'] == 'parameter']
    assert [(c['user'], c['to'], c['taken']) for c in changes] == [
        (USER, '4321.5', True),
        (USER, '-5.0', False),
        (USER, before, True),
    ]
    assert changes[1]['reason'] and all(c['time'] and c['address'] == '127.0.0.1' for c in changes)
    saved = parameter_dict_from_yaml_file(str(site.state / 'parameters' / 'site.yaml'), target_nodes=['/fusion'])
    assert saved[name].value.double_value == 4321.5


def ranges_reach(site: Site, distance: float) -> None:
    begun = site.monitor.total
    wait(
        lambda: site.monitor.total > begun and abs(site.monitor.arrivals[-1].message.range - distance) < 0.02,
        f'ranges of {distance:g} m',
    )


def test_calibration_is_compared_stored_refused_and_taken_back(site):
    """What the page predicts for the range happens when it is stored, and is undone by storing the older one."""
    delay = 2e-9
    shift = -delay * SPEED_OF_LIGHT / 1.0003
    with site.page('/calibration', user=True) as page:
        card = page.locator('[data-station=master]')
        expect(card.locator('[data-key=version]')).to_have_text('not stored')
        card.get_by_role('button', name='Copy into the editor').click()
        editor = page.get_by_label('Document')
        expect(editor).to_have_value(re.compile('station: master'))
        content = yaml.safe_load(editor.input_value())
        content['delay']['value'] += delay
        content['note'] = HOSTILE
        compared = page.locator('[data-comparison=master]')
        row = compared.locator('[data-value="delay.value"] td')
        for _ in range(3):  # a busy page may take the copy over once more, in the place of what was typed
            editor.fill(json.dumps(content))
            page.get_by_role('button', name='Compare with the one in use').last.click()
            row.first.wait_for()
            with contextlib.suppress(AssertionError):
                expect(row.nth(3)).to_have_text('14')
                break
        assert row.all_text_contents()[1:] == ['ns', '12', '14', '+2']
        effect = compared.locator('[data-effect="master/slave 1000"] td')
        assert float(effect.nth(2).text_content().split()[0]) == pytest.approx(1e3 * shift, abs=0.5)
        expect(card.locator('[data-key=version]')).to_have_text('not stored')
        compared.get_by_role('button', name='Store on master').click()
        expect(card.locator('[data-key=version]')).to_have_text('1')
        expect(card.locator('[data-key=operator]')).to_have_text(USER)
        ranges_reach(site, 100.0 + shift)
        assert page.evaluate('() => window.hacked') is None

        editor.fill(json.dumps(content | {'delay': {'value': 12.3}}))
        page.get_by_role('button', name='Compare with the one in use').last.click()
        page.get_by_text('delay = 12.3 s is outside').first.wait_for()
        blocked = site.stations / 'calibration' / 'slave'
        blocked.write_text('')  # where the station keeps its calibrations
        editor.fill(json.dumps(content | {'station': 'slave'}))
        page.get_by_role('button', name='Compare with the one in use').last.click()
        page.get_by_role('button', name='Store on slave').click()
        page.get_by_text(f'Refused: {blocked}').first.wait_for()
        blocked.unlink()

        card.locator('[data-version="0"]').get_by_role('button', name='Compare').click()
        page.get_by_role('button', name='Store on master').click()
        expect(card.locator('[data-key=version]')).to_have_text('2')
        ranges_reach(site, 100.0)
    kept = CalibrationStore(site.stations).read('master')
    assert (kept.version, kept.operator, kept.note) == (2, USER, 'version 0 again')
    changes = [entry for entry in site.audit() if entry['action'] == 'calibration']
    assert [(c['user'], c['station'], c['from'], c['to'], c['taken']) for c in changes] == [
        (USER, 'master', 0, 1, True),
        (USER, 'slave', 0, 0, False),
        (USER, 'master', 1, 2, True),
    ]


def test_calibration_is_imported_from_a_file(site):
    """A document as ./drfmcw calibrate writes it; what is none or too large is refused."""
    with site.page('/calibration', user=True) as page:
        page.locator('[data-station=slave]').get_by_role('button', name='Copy into the editor').click()
        editor = page.get_by_label('Document')
        expect(editor).to_have_value(re.compile('station: slave'))
        document = editor.input_value()
        chooser = page.get_by_label('File')
        for content, said in ((b'\x93\xff', 'the file is no text'), (b' ' * 70_000, 'larger than 64 kB')):
            chooser.set_input_files({'name': 'wrong.yaml', 'mimeType': 'text/yaml', 'buffer': content})
            page.get_by_text(said).first.wait_for()
        expect(editor).to_have_value(document)
        given = document.replace('note: ', 'note: imported') if 'note: ' in document else f'{document}note: imported\n'
        chooser.set_input_files({'name': 'slave.yaml', 'mimeType': 'text/yaml', 'buffer': given.encode()})
        expect(editor).to_have_value(given)
        page.locator('[data-comparison=slave]').wait_for()


def test_calibration_is_only_shown_without_login(site):
    with site.page('/calibration') as page:
        page.locator('[data-station=master] [data-key=delay]').wait_for()
        assert page.locator('textarea').count() == 0 and page.get_by_role('button', name='Store').count() == 0


def test_without_login_nothing_can_be_changed(site):
    with site.page('/configuration') as page:
        parameter_row(page, 'maximum_range')
        assert page.locator('tbody input').count() == 0
        page.goto(f'{site.url}/recordings')
        page.wait_for_selector('.recorder')
        assert page.get_by_role('button').count() == 0
    assert site.request('GET', '/recordings/any.tar')[0] == 403
    assert site.request('GET', '/', Host='evil.example')[0] == 403
    assert site.request('POST', '/login', Origin='http://evil.example')[0] == 403
    assert site.request('POST', '/logout')[0] == 403
    upgrade = {'Connection': 'Upgrade', 'Upgrade': 'websocket', 'Sec-WebSocket-Version': '13'}
    upgrade |= {'Sec-WebSocket-Key': 'AAAAAAAAAAAAAAAAAAAAAA==', 'Origin': 'http://evil.example'}
    assert site.request('GET', '/live?view=now', **upgrade)[0] == 403
    assert site.request('GET', '/_nicegui_ws/socket.io/?EIO=4&transport=websocket', **upgrade)[0] == 403


def test_wrong_password_is_refused_and_logged_without_it(site):
    with site.page('/login') as page:
        page.fill('[name=user]', USER)
        page.fill('[name=password]', 'wrong wrong wrong')
        page.click('button[type=submit]')
        expect(page.locator('[role=alert]')).to_contain_text('wrong')
        assert not [c for c in page.context.cookies() if c['name'] == 'drfmcw_session']
    log = (site.state / 'audit.jsonl').read_text()
    assert 'login failed' in log and 'wrong wrong' not in log and PASSWORD not in log


def test_logout_ends_the_session(site):
    with site.page('/recordings', user=True) as page:
        page.get_by_role('button', name='Start recording').wait_for()
        page.locator('form[action="/logout"] button').click()
        page.wait_for_selector('.badge')
        page.context.add_cookies(site.cookies)  # the old cookie again
        page.goto(f'{site.url}/recordings')
        page.wait_for_selector('.badge')
    site.cookies = []


def test_hostile_names_are_text(site):
    """Names in messages come from anywhere on the network; none becomes markup."""
    node = site.monitor
    diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', qos.RELIABLE)
    ranges = node.create_publisher(RangeEstimate, '/evil/twin/range', qos.RELIABLE)
    logs = node.create_publisher(Log, '/rosout', qos.LATCHED)
    status = DiagnosticStatus(level=DiagnosticStatus.ERROR, name=HOSTILE, message=HOSTILE, hardware_id=HOSTILE)
    status.values = [KeyValue(key=HOSTILE, value=HOSTILE)]
    message = RangeEstimate(first_station=HOSTILE, second_station=HOSTILE, range=1.0, flags=255)

    def publish() -> None:
        diagnostics.publish(DiagnosticArray(status=[status]))
        ranges.publish(message)
        logs.publish(Log(level=255, name=HOSTILE, msg=HOSTILE))

    try:
        with repeated(publish), site.page('/stations') as page:
            cell = page.locator('tbody[data-field=diagnostics] td', has_text='onerror').first
            cell.wait_for()
            assert HOSTILE in cell.text_content()
            logged = page.locator('tbody[data-field=logs] tr', has_text='onerror').first.locator('td')
            expect(logged.nth(3)).to_have_text(HOSTILE)
            for view in ('/', '/diagnosis', '/signals', '/over-time?pair=evil/twin', f'/?pair={HOSTILE}'):
                page.goto(site.url + view)
                page.wait_for_selector('.content')
                page.wait_for_timeout(300)
                assert page.evaluate('() => window.hacked') is None
                assert page.locator('img[src=x]').count() == 0
    finally:
        node.destroy_publisher(diagnostics)
        node.destroy_publisher(ranges)
        node.destroy_publisher(logs)


def test_stations_say_what_they_run(site):
    with site.page('/stations') as page:
        for station in ('master', 'slave'):
            expect(page.locator(f'[data-field="{station}.software"]')).to_have_text(
                re.compile(r'drfmcw \d\S+, the same as on the host')
            )


def test_logs_of_all_nodes_are_shown_from_a_level_on(site):
    logger = site.monitor.get_logger()
    with site.page('/stations') as page:
        lines = page.locator('tbody[data-field=logs] tr')
        logger.info('a node says this')
        logger.error('a node fails')
        lines.filter(has_text='a node says this').wait_for()
        page.get_by_role('button', name='Errors').click()
        expect(lines.filter(has_text='a node says this')).to_have_count(0)
        expect(lines.filter(has_text='a node fails')).to_be_visible()
        expect(page.get_by_role('button', name='Errors')).to_have_attribute('aria-pressed', 'true')
        page.get_by_role('button', name='All').click()
        lines.filter(has_text='a node says this').wait_for()
        expect(page.locator('html')).to_have_attribute('data-lost', 'false')


def keep_finding(directory, name, pair):
    """Keep a finding as the watch does."""
    effect = {'effect': 'sweep_ripple', 'station': 'master', 'parameters': {}}
    content = {'verdict': 'explained', 'significance': 1e-9, 'effects': [effect], 'window': {'pair': pair}}
    (directory / name).mkdir(parents=True)
    write_atomically(directory / name / 'report.html', f'<h1>{name}</h1><script>window.hacked = 1</script>')
    write_atomically(directory / name / 'finding.json', json.dumps(content))


def test_findings_appear_by_themselves_beside_what_is_open(site):
    node, findings = site.monitor, site.state / 'findings'
    diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', qos.RELIABLE)
    status = DiagnosticStatus(level=DiagnosticStatus.WARN, name='/master/slave/watch: Model master/slave')
    status.message = 'left out of the model: sweep ripple at master'
    try:
        with (
            repeated(lambda: diagnostics.publish(DiagnosticArray(status=[status]))),
            site.page('/diagnosis') as page,
        ):
            row = page.locator('tbody[data-field=watch] tr', has_text='sweep ripple')
            expect(row.locator('td').first).to_have_text('Warning')
            page.locator('svg.strip rect[data-state=doubtful]').wait_for(state='attached')
            entries = page.locator('.finding')
            expect(entries).to_have_count(0)
            keep_finding(findings, '20260101T000000Z-master-slave', 'master/slave')
            expect(entries).to_have_count(1)
            expect(entries).to_contain_text('master → slave')
            page.locator('svg.strip .mark').wait_for(state='attached')
            page.get_by_role('button', name='Open report').click()
            heading = page.frame_locator('iframe.report').locator('h1')
            expect(heading).to_have_text('20260101T000000Z-master-slave')
            keep_finding(findings, '20260102T000000Z-master-slave', 'master/slave')
            expect(entries).to_have_count(2)
            expect(entries.last.locator('iframe.report')).to_be_visible()
            shutil.rmtree(findings / '20260102T000000Z-master-slave')
            expect(entries).to_have_count(1)
            expect(heading).to_be_visible()
    finally:
        node.destroy_publisher(diagnostics)


NEEDED = [
    rb'/master/if_samples(?!_)', rb'/slave/if_samples(?!_)', rb'/master/sweep_config', rb'/slave/sweep_config',
    rb'/master/calibration', rb'/slave/calibration', rb'/master/slave/range(?!_)',
]  # fmt: skip
"""Topics without which a recording cannot be recomputed; the recorder finds them one after another."""


def contents(kept, name):
    """Return the bytes of a recording so far."""
    return b''.join(file.read_bytes() for file in (kept.directory / name).glob('*.mcap'))


def test_recording_is_made_recomputed_and_deleted(site):
    kept = Recordings(site.state / 'recordings')
    with site.page('/recordings', user=True) as page:
        page.get_by_label('Name').fill('../outside')
        page.get_by_role('button', name='Start recording').click()
        page.get_by_text("name '../outside'").wait_for()
        page.get_by_label('Name').fill('yard')
        page.get_by_role('button', name='Start recording').click()
        expect(page.locator('.recorder')).to_contain_text('yard')
        wait(lambda: all(re.search(topic, contents(kept, 'yard')) for topic in NEEDED), 'every topic in the recording')
        size = kept.size('yard')
        wait(lambda: kept.size('yard') > size + 500_000, 'sweeps in the recording')
        page.get_by_role('button', name='Stop recording').click()
        entry = page.locator('[data-recording=yard]')
        entry.wait_for()
        with page.expect_download() as download:
            entry.get_by_text('Download').click()
        assert download.value.path().stat().st_size > kept.size('yard')
        entry.get_by_role('button', name='Recompute').click()
        page.get_by_text('Recomputing yard: done').wait_for()
        entry.get_by_role('button', name='Show result').click()
        frame = page.locator('iframe.report')
        frame.wait_for()
        assert frame.get_attribute('sandbox') == ''
        entry.get_by_role('button', name='Delete').click()
        page.get_by_role('dialog').get_by_role('button', name='Delete').click()
        expect(entry).to_have_count(0)
    assert kept.list() == [] and [e['recording'] for e in site.audit() if e['action'] == 'delete'] == ['yard']


def test_page_is_german_where_the_browser_is(site):
    with site.page('/', locale='de-DE') as page:
        expect(page.locator('header nav')).to_contain_text('Aufzeichnungen')
        expect(page.locator('.hero')).to_contain_text('Standardabweichung')
        expect(page.locator('[data-field="hero.range"]')).to_have_text(re.compile(r'\d+,\d{3}'))
        page.goto(f'{site.url}/stations')
        expect(page.locator('[data-field=diagnostics] td:nth-child(3)').first).to_have_attribute('lang', 'en')
        page.goto(f'{site.url}/configuration')
        expect(parameter_row(page, 'maximum_range').locator('td').last).to_have_attribute('lang', 'en')
        page.goto(site.url)
        page.get_by_text('English').click()
        expect(page.locator('.hero')).to_contain_text('Standard deviation')


@pytest.mark.parametrize(('theme', 'locale'), [('light', 'en-GB'), ('dark', 'de-DE')])
def test_pages_keep_the_rules_of_accessibility(site, theme, locale):
    """WCAG 2.2 level AA, as far as axe-core can judge: contrast, labels, names, language; also while data are stale."""
    found = {}
    with site.page('/', user=True, locale=locale) as page:
        page.goto(f'{site.url}/preference?theme={theme}&back=/')
        assert page.locator('html').get_attribute('lang')[:2] == locale[:2]
        for view in VIEWS:
            page.goto(f'{site.url}{path_of(view)}')
            page.wait_for_selector('.content')
            page.wait_for_timeout(500)  # what the stream fills
            found |= inaccessible(page, view)
        with silenced(site):
            for view in ('now', 'signals', 'stations'):
                page.goto(f'{site.url}{path_of(view)}')
                page.locator('[data-state=stale]').first.wait_for()
                page.wait_for_timeout(4000 if view == 'stations' else 500)
                found |= inaccessible(page, f'{view}, stale')
    assert found == {}


def test_page_can_be_used_by_keyboard_on_a_tablet(site):
    """The first Tab leads to the content; no page is wider than the screen."""
    with site.page('/', viewport={'width': 768, 'height': 1024}) as page:
        page.keyboard.press('Tab')
        assert page.evaluate('() => document.activeElement.className') == 'skip'
        for view in ('/', '/over-time', '/signals', '/stations', '/configuration', '/calibration', '/recordings'):
            page.goto(site.url + view)
            page.wait_for_selector('.content')
            assert page.evaluate('() => document.documentElement.scrollWidth <= innerWidth + 1'), view


def test_page_survives_a_restart_of_the_server(site):
    """Last of all: the page says that it is cut off, and is current again by itself afterwards."""
    with site.page() as page:
        fresh(page)
        site.graph.stop('host')
        page.wait_for_function("() => document.documentElement.dataset.lost === 'true'")
        expect(page.locator('.lost')).to_be_visible()
        site.start_host()
        page.wait_for_function("() => document.documentElement.dataset.lost === 'false'")
        fresh(page)
