"""The host in a graph, and a real Chromium that opens its pages; without one the modules that need it are skipped."""

import contextlib
import dataclasses
import http.client
import json
import shutil
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect, sync_playwright

from drfmcw_bringup.graph import HOST, Graph
from drfmcw_host.access.passwords import Passwords

CHROMIUM = next(filter(None, map(shutil.which, ('chromium', 'chromium-browser', 'google-chrome'))), None)
if CHROMIUM is None:
    pytest.skip('no Chromium on this machine', allow_module_level=True)

LIMIT = 90.0  # for anything that is waited for, on a busy machine [s]
expect.set_options(timeout=LIMIT * 1000)
USER, PASSWORD = 'anna', 'correct horse battery'


def wait(condition: Callable[[], Any], what: str, words: Callable[[], str] = lambda: '') -> None:
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end, f'waited {LIMIT:g} s for {what}; {words()}'
        time.sleep(0.05)


@contextlib.contextmanager
def repeated(publish: Callable[[], object]) -> Iterator[None]:
    """Publish ten times a second, until the publishers may be destroyed."""
    ended = threading.Event()

    def turn() -> None:
        while not ended.wait(0.1):
            publish()

    thread = threading.Thread(target=turn)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        yield browser
        browser.close()


def inaccessible(page: Page, name: str) -> dict[tuple[str, str, str], str]:
    """What keeps a page from WCAG 2.2 level AA as far as axe-core can judge: by page, rule and element."""
    page.wait_for_function('() => !document.getAnimations().length')  # what appears is transparent at first
    rules = {'runOnly': ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa']}
    violations = Axe().run(page, options=rules).response['violations']
    return {(name, v['id'], n['html'][:200]): n['failureSummary'] for v in violations for n in v['nodes']}


@dataclasses.dataclass(kw_only=True)
class Pages:
    """A host in a graph, with one user, and a browser."""

    graph: Graph
    state: Path
    port: int
    browser: Browser
    certificate: Path | None = None  # its key lies beside it
    cookies: list[Any] = dataclasses.field(default_factory=list)

    @property
    def url(self) -> str:
        return f'{"https" if self.certificate else "http"}://127.0.0.1:{self.port}'

    def start_host(self) -> None:
        Passwords(self.state / 'passwords.json').set(USER, PASSWORD)
        arguments = ['--port', str(self.port), '--state', str(self.state)]
        if self.certificate is not None:
            arguments += ['--tls-cert', str(self.certificate), '--tls-key', str(self.certificate.with_suffix('.key'))]
        host = self.graph.start('host', HOST, *arguments)
        wait(lambda: 'host: ' in self.graph.last_words(host), 'the page', lambda: self.graph.last_words(host))

    @contextlib.contextmanager
    def page(self, path: str = '/', user: bool = False, **options: Any) -> Iterator[Page]:
        """A page of its own, with the session of the user or without any."""
        context = self.browser.new_context(ignore_https_errors=True, **{'locale': 'en-GB'} | options)
        context.set_default_timeout(LIMIT * 1000)
        page = context.new_page()
        if user and not self.cookies:
            page.goto(f'{self.url}/login')
            page.fill('[name=user]', USER)
            page.fill('[name=password]', PASSWORD)
            page.click('button[type=submit]')
            self.cookies = [c for c in context.cookies() if c['name'] == 'drfmcw_session']
            assert self.cookies and self.cookies[0]['httpOnly'] and self.cookies[0]['sameSite'] == 'Strict'
        elif user:
            context.add_cookies(self.cookies)
        page.goto(self.url + path)
        page.wait_for_selector('.content')
        try:
            yield page
        finally:
            context.close()

    def request(self, method: str, path: str, **headers: str) -> tuple[int, dict[str, str]]:
        """Status and headers of the answer to a request as no browser makes it."""
        connection = http.client.HTTPConnection('127.0.0.1', self.port, timeout=LIMIT)
        if self.certificate is not None:
            trusting = ssl.create_default_context(cafile=str(self.certificate))
            connection = http.client.HTTPSConnection('127.0.0.1', self.port, timeout=LIMIT, context=trusting)
        try:
            connection.request(method, path, headers={'Host': f'127.0.0.1:{self.port}'} | headers)
            answer = connection.getresponse()
            answer.read()
            return answer.status, {name.lower(): value for name, value in answer.getheaders()}
        finally:
            connection.close()

    def audit(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (self.state / 'audit.jsonl').read_text().splitlines()]
