"""The host served by TLS: the page can be used, and its sockets refuse other pages all the same."""

import shutil
import subprocess

import pytest
from hosted import Pages, chromium
from playwright.sync_api import expect
from ports import free_port

from drfmcw_bringup.graph import Graph, private_environment

pytestmark = [
    pytest.mark.graph,
    pytest.mark.slow,
    pytest.mark.skipif(not shutil.which('openssl'), reason='no openssl to make a certificate with'),
]
SOCKETS = ('/_nicegui_ws/socket.io/?EIO=4&transport=websocket', '/live?view=now')
UPGRADE = {
    'Connection': 'Upgrade',
    'Upgrade': 'websocket',
    'Sec-WebSocket-Version': '13',
    'Sec-WebSocket-Key': 'AAAAAAAAAAAAAAAAAAAAAA==',
}


@pytest.fixture(scope='module')
def secure(tmp_path_factory):
    """A host with a certificate of its own, and no stations."""
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
