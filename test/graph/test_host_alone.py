"""The host without stations, served by TLS: sockets refuse other pages, sessions end, recordings are diagnosed."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from checkout import practice_recording
from hosted import Pages, chromium, inaccessible
from playwright.sync_api import expect
from ports import free_port

from drfmcw_bringup.graph import Graph, private_environment
from drfmcw_host.files.recordings import Recordings

pytestmark = [
    pytest.mark.graph,
    pytest.mark.slow,
    pytest.mark.skipif(not shutil.which('openssl'), reason='no openssl to make a certificate with'),
]
KEPT = 'kept'
SOCKETS = ('/_nicegui_ws/socket.io/?EIO=4&transport=websocket', '/live?view=now')
UPGRADE = {
    'Connection': 'Upgrade',
    'Upgrade': 'websocket',
    'Sec-WebSocket-Version': '13',
    'Sec-WebSocket-Key': 'AAAAAAAAAAAAAAAAAAAAAA==',
}


@pytest.fixture(scope='module')
def secure(tmp_path_factory):
    """A host with a certificate of its own, no stations, and one recording."""
    directory = tmp_path_factory.mktemp('tls')
    subprocess.run(
        [
            *'openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=crane7'.split(),
            *'-addext subjectAltName=IP:127.0.0.1 -keyout host.key -out host.pem'.split(),
        ],
        cwd=directory,
        check=True,
        capture_output=True,
        timeout=60,
    )
    with Graph(private_environment(), directory / 'log') as graph, chromium() as browser:
        opened = Pages(
            graph=graph,
            state=directory / 'state',
            port=free_port(),
            browser=browser,
            certificate=directory / 'host.pem',
        )
        shutil.copytree(practice_recording(0), opened.state / 'recordings' / KEPT)
        opened.start_host()
        yield opened


def test_page_works_and_its_cookie_stays_on_tls(secure):
    """What a button does comes back through NiceGUI's socket."""
    with secure.page('/recordings', user=True) as page:
        assert secure.cookies[0]['secure']
        page.get_by_label('Name').fill('../outside')
        page.get_by_role('button', name='Start recording').click()
        page.get_by_text("name '../outside'").wait_for()
        expect(page.locator('html')).to_have_attribute('data-lost', 'false')
    assert [e['refused'] for e in secure.audit() if e['action'] == 'record']


def test_host_gives_way_to_the_graph(secure):
    """Every thread that works, those of the middleware and of the pages too."""
    tasks = Path(f'/proc/{secure.graph.members["host"].process.pid}/task')
    used = {
        int(t.name): sum(map(int, (t / 'stat').read_text().rsplit(')', 1)[1].split()[11:13])) for t in tasks.iterdir()
    }
    niceness = {t: os.getpriority(os.PRIO_PROCESS, t) for t, ticks in used.items() if ticks > 1}
    assert niceness
    assert min(niceness.values()) > os.getpriority(os.PRIO_PROCESS, 0), niceness


@pytest.mark.parametrize('path', SOCKETS)
def test_sockets_take_the_own_page_only(secure, path):
    """The own Origin is https; neither the same address without TLS nor another one may shake hands."""
    own = secure.url
    assert secure.request('GET', path, Origin=own, **UPGRADE)[0] == 101
    for origin in (own.replace('https', 'http'), f'{own}0', 'https://evil.example', 'null'):
        assert secure.request('GET', path, Origin=origin, **UPGRADE)[0] == 403
    assert secure.request('GET', path, **UPGRADE)[0] == 403


def test_polling_takes_the_own_page_only(secure):
    """The socket's other transport: what it sends needs the Origin, what it reads no other page may."""
    path = '/_nicegui_ws/socket.io/?EIO=4&transport=polling'
    assert secure.request('POST', path, Origin='https://evil.example')[0] == 403
    assert secure.request('POST', path)[0] == 403
    assert secure.request('GET', path, Origin='https://evil.example')[0] == 403
    headers = secure.request('GET', path)[1]
    assert headers['cross-origin-resource-policy'] == 'same-origin' and 'access-control-allow-origin' not in headers


def test_recording_is_diagnosed_and_its_report_opened(secure):
    with secure.page('/recordings', user=True) as page:
        entry = page.locator(f'[data-recording={KEPT}]')
        entry.get_by_role('button', name='Diagnose', exact=True).click()
        page.get_by_text(re.compile(rf'Diagnosis of {KEPT}: running for ([2-9]|\d\d)')).wait_for()  # its age counts
        page.get_by_text(f'Diagnosis of {KEPT}: done').wait_for(timeout=250_000)
        entry.get_by_role('button', name='Show result: Diagnose').click()
        report = page.locator('iframe.report')
        assert report.get_attribute('sandbox') == ''
        expect(report.content_frame.locator('h1')).to_have_text('The model explains this recording')


@pytest.mark.parametrize('theme', ['light', 'dark'])
def test_recordings_and_login_keep_the_rules_of_accessibility(secure, theme):
    with secure.page('/recordings', user=True) as page:
        page.goto(f'{secure.url}/preference?theme={theme}&back=/recordings')
        page.locator(f'[data-recording={KEPT}]').get_by_role('button', name='Delete').wait_for()
        found = inaccessible(page, 'recordings')
        page.goto(f'{secure.url}/login')
        found |= inaccessible(page, 'login')
        assert not found, found


def test_open_page_can_change_nothing_after_a_log_out_elsewhere(secure):
    with secure.page('/recordings', user=True) as page:
        start = page.get_by_role('button', name='Start recording')
        start.wait_for()
        other = page.context.new_page()
        other.goto(f'{secure.url}/')
        other.locator('form[action="/logout"] button').click()
        other.wait_for_selector('.badge')
        page.get_by_label('Name').fill('unasked')
        start.click()
        page.get_by_text('Log in to change anything.').wait_for()
    secure.cookies = []
    refused = secure.audit()[-1]
    assert (refused['action'], refused['what'], refused['address']) == ('refused', 'record unasked', '127.0.0.1')
    assert [r.name for r in Recordings(secure.state / 'recordings').list()] == [KEPT]
