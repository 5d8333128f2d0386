"""Access: passwords, sessions, rate limit, refused requests, audit log."""

import asyncio
import json
import os
import stat

import pytest

from drfmcw_host.access.attempts import FREE, Attempts
from drfmcw_host.access.audit import Audit
from drfmcw_host.access.guard import Guard
from drfmcw_host.access.passwords import Passwords
from drfmcw_host.access.requests import Requests
from drfmcw_host.access.sessions import LIFETIME, Sessions
from drfmcw_host.host import main
from drfmcw_physics.settings import ConfigurationError

PASSWORD = 'correct horse battery'


@pytest.fixture
def passwords(tmp_path):
    kept = Passwords(tmp_path / 'passwords.json')
    kept.set('anna', PASSWORD)
    return kept


def test_password_is_verified_and_kept_as_argon2_only(passwords):
    assert passwords.verify('anna', PASSWORD)
    assert not passwords.verify('anna', PASSWORD + ' ')
    assert not passwords.verify('bert', PASSWORD)
    content = passwords.path.read_text()
    assert PASSWORD not in content and '$argon2id$' in content
    assert stat.S_IMODE(passwords.path.stat().st_mode) == 0o600


@pytest.mark.parametrize('user', ['', '../x', 'a b', '<b>', 'x' * 33])
def test_user_names_that_are_none_are_refused(passwords, user):
    with pytest.raises(ConfigurationError, match='user'):
        passwords.set(user, PASSWORD)


def test_short_password_and_open_file_are_refused(passwords):
    with pytest.raises(ConfigurationError, match='10'):
        passwords.set('anna', 'short')
    passwords.path.chmod(0o644)
    with pytest.raises(ConfigurationError, match='chmod 600'):
        passwords.users()


def test_session_ends_with_logout_password_and_time(passwords, tmp_path, monkeypatch):
    sessions = Sessions(tmp_path, passwords)
    cookie, other, late = (sessions.begin('anna') for _ in range(3))
    assert sessions.of(cookie).user == 'anna'
    sessions.end(sessions.of(cookie))
    assert sessions.of(cookie) is None and sessions.of(other) is not None
    now = __import__('time').time()
    with monkeypatch.context() as later:
        later.setattr('time.time', lambda: now + LIFETIME + 2)
        assert sessions.of(late) is None
    passwords.set('anna', PASSWORD + '2')
    assert sessions.of(other) is None


def test_session_survives_a_restart_but_not_another_secret(passwords, tmp_path):
    cookie = Sessions(tmp_path, passwords).begin('anna')
    assert Sessions(tmp_path, passwords).of(cookie).user == 'anna'
    assert stat.S_IMODE((tmp_path / 'secret').stat().st_mode) == 0o600
    (tmp_path / 'secret').unlink()
    assert Sessions(tmp_path, passwords).of(cookie) is None


def test_forged_cookies_are_none(passwords, tmp_path):
    sessions = Sessions(tmp_path, passwords)
    cookie = sessions.begin('anna')
    for forged in ('', 'x', cookie[:-1], cookie.replace(cookie[3], 'Z', 1), 'a' * 5000, None):
        assert sessions.of(forged) is None


def test_secret_that_others_may_read_is_refused(passwords, tmp_path):
    Sessions(tmp_path, passwords)
    (tmp_path / 'secret').chmod(0o640)
    with pytest.raises(ConfigurationError, match='others may read'):
        Sessions(tmp_path, passwords)


def test_guessing_is_slowed_down_and_forgiven():
    now = [0.0]
    attempts = Attempts(clock=lambda: now[0])
    for _ in range(FREE):
        assert attempts.wait('address', 'user') == 0
        attempts.failed('address', 'user')
    waits = []
    for _ in range(12):
        waits.append(attempts.wait('address', 'other'))
        now[0] += waits[-1]
        attempts.failed('address')
    assert waits[0] == 2 and waits[1] == 4 and max(waits) == 900 and sorted(waits) == waits
    assert attempts.wait('elsewhere') == 0
    attempts.succeeded('address')
    assert attempts.wait('address') == 0


def serve(method='GET', kind='http', secure=False, requests=None, client='10.0.7.9', path='/', **headers):
    """Return (status or close code, headers) of one request to a guarded application that answers 200."""
    sent = []

    async def application(scope, receive, send):
        if scope['type'] == 'websocket':
            await send({'type': 'websocket.accept'})
            return
        await send({'type': 'http.response.start', 'status': 200, 'headers': []})
        await send({'type': 'http.response.body', 'body': b''})

    async def send(message):
        sent.append(message)

    fields = {'host': '127.0.0.1:8400'} | headers
    scope = {'type': kind, 'headers': [(k.encode(), v.encode()) for k, v in fields.items()]}
    scope |= {'client': (client, 40_000), 'path': path}
    scope |= {'method': method} if kind == 'http' else {}
    asyncio.run(Guard(application, ['crane.local'], secure, requests)(scope, None, send))
    answer = {k.decode(): v.decode() for k, v in sent[0].get('headers', [])}
    return sent[0].get('status', sent[0].get('code', 200)), answer


@pytest.mark.parametrize('host', ['127.0.0.1:8400', 'localhost', '[::1]:8400', 'crane.local:8400', '10.0.7.1'])
def test_own_names_are_served(host):
    assert serve(host=host)[0] == 200


@pytest.mark.parametrize('host', ['evil.example', 'localhost.evil.example', '', '[', '127.0.0.1.evil.example:8400'])
def test_rebound_names_are_refused(host):
    assert serve(host=host)[0] == 403


@pytest.mark.parametrize('kind', ['http', 'websocket'])
@pytest.mark.parametrize('origin', ['http://evil.example', 'null', 'https://127.0.0.1:8400', 'http://127.0.0.1', None])
def test_changing_requests_of_another_origin_are_refused(kind, origin):
    headers = {} if origin is None else {'origin': origin}
    assert serve('POST', kind, **headers)[0] in (403, 1008)


@pytest.mark.parametrize('kind', ['http', 'websocket'])
def test_changing_requests_of_the_own_page_are_served(kind):
    assert serve('POST', kind, origin='http://127.0.0.1:8400')[0] == 200
    assert serve('POST', kind, secure=True, origin='https://127.0.0.1:8400')[0] == 200


def test_too_many_requests_of_one_address_are_refused_and_others_served():
    """Twenty browsers behind one address open a page with all that belongs to it; a flood gets 429 and waits."""
    now = [0.0]
    requests = Requests(clock=lambda: now[0])
    for _ in range(20):
        assert serve(requests=requests)[0] == 200
        assert all(serve(requests=requests, path='/static/host.css')[0] == 200 for _ in range(20))
    origin = 'http://127.0.0.1:8400'
    answers = [serve(requests=requests) for _ in range(100)]
    assert [status for status, _ in answers].count(200) == 40
    status, headers = answers[-1]
    assert status == 429 and headers['retry-after'] == '1' and headers['x-frame-options'] == 'DENY'
    assert serve('', 'websocket', requests=requests, path='/live', origin=origin)[0] == 1008
    assert serve(requests=requests, client='10.0.7.10')[0] == 200
    now[0] += 1.0
    assert [serve(requests=requests)[0] for _ in range(11)] == [200] * 10 + [429]


def test_addresses_that_are_remembered_are_bounded():
    requests = Requests(clock=lambda: 0.0)
    for i in range(30_000):
        requests.wait(str(i), 1.0)
    assert len(requests._buckets) == 10_000


def test_every_answer_has_the_headers():
    for status, headers in (serve(), serve(host='evil.example')):
        assert status in (200, 403)
        assert headers['x-frame-options'] == 'DENY' and headers['x-content-type-options'] == 'nosniff'
        policy = headers['content-security-policy']
        assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy and '*' not in policy
    assert 'strict-transport-security' in serve(secure=True)[1]


def test_too_large_a_body_is_refused():
    length = {'content-length': '99999999'}
    assert serve('POST', origin='http://127.0.0.1:8400', **length)[0] == 403


def test_audit_log_is_json_lines_that_survive_a_crash(tmp_path):
    path = tmp_path / 'audit.jsonl'
    audit = Audit(path)
    audit.write('anna', '10.0.0.1', 'parameter', name='x\n"y', reason='z' * 9999)
    with path.open('a') as file:
        file.write('{"cut off')
    entries = list(Audit(path).entries)
    assert [e['action'] for e in entries] == ['parameter']
    assert entries[0]['user'] == 'anna' and entries[0]['address'] == '10.0.0.1' and len(entries[0]['reason']) == 500
    assert json.loads(path.read_text().splitlines()[0])['time'].endswith('+00:00')
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (['--bind', '0.0.0.0'], '--set-password'),
        (['--tls-cert', 'nothing.pem'], 'belong together'),
        (['--tls-cert', 'nothing.pem', '--tls-key', 'nothing.pem'], 'nothing.pem'),
        (['--bind', '203.0.113.7', '--read-only'], '203.0.113.7'),
        (['--port', '99999'], '99999'),
    ],
)
def test_unsafe_or_impossible_starts_are_refused_in_one_line(arguments, reason, tmp_path, capsys):
    assert main([*arguments, '--state', str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert reason in said and said.count('\n') == 1 and 'Traceback' not in said


def test_password_comes_from_a_pipe_and_never_shows(tmp_path, capsys, monkeypatch):
    read, write = os.pipe()
    os.write(write, f'{PASSWORD}\n'.encode())
    os.close(write)
    with os.fdopen(read) as pipe:
        monkeypatch.setattr('sys.stdin', pipe)
        assert main(['--set-password', 'anna', '--state', str(tmp_path)]) == 0
    assert PASSWORD not in ''.join(capsys.readouterr())
    assert Passwords(tmp_path / 'passwords.json').verify('anna', PASSWORD)
