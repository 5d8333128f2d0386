"""The host's pages in a real Chromium: first paint, bytes, updates and frames."""

import dataclasses
import os
import shutil
import statistics
from typing import Any

from playwright.sync_api import Browser, sync_playwright

VIEWS = ('', 'over-time', 'signals', 'stations', 'diagnosis', 'configuration', 'calibration', 'recordings')
"""Paths of the views."""

_SETTLE = 1500  # for what a page loads after its first paint [ms]
_SCREEN = 60.0  # frames of the screen per second
_OPENED = 3  # times that each view is opened anew
FRAMES = """seconds => new Promise((done) => {
  const range = document.querySelector('[data-field="hero.range"]');
  let updates = 0, begun, last;
  const gaps = [];
  const seen = new MutationObserver(() => { updates += 1; });
  seen.observe(range, { attributeFilter: ['data-sweep'] });
  const frame = (now) => {
    if (begun === undefined) begun = now; else gaps.push(now - last);
    last = now;
    if (now - begun < 1000 * seconds) requestAnimationFrame(frame);
    else { seen.disconnect(); done({ updates, gaps, took: (now - begun) / 1000 }); }
  };
  requestAnimationFrame(frame);
})"""
"""Counts for some seconds how often the distance changes, and times the frames of the screen [ms]."""


@dataclasses.dataclass(frozen=True)
class Opened:
    """What opening the pages cost: the worst of all views, each the median of three times, nothing kept."""

    paint: float  # until something shows [s]
    size: float  # of what comes over the network, compressed as it comes [MB]


@dataclasses.dataclass(frozen=True)
class Shown:
    """What a browser shows of the distance."""

    updates: float  # [1/s]
    dropped: float  # frames of the screen without a picture of their own [1]


def chromium() -> str | None:
    """Return the path of the system's Chromium, None where there is none."""
    return next(filter(None, map(shutil.which, ('chromium', 'chromium-browser', 'google-chrome'))), None)


def _open(browser: Browser, address: str) -> tuple[float, float]:
    """Return (time to the first paint [s], bytes) of a page that is opened for the first time."""
    context = browser.new_context(viewport={'width': 1280, 'height': 900})
    try:
        page = context.new_page()
        session = context.new_cdp_session(page)
        session.send('Network.enable')
        received = [0.0]

        def add(event: dict[str, Any]) -> None:
            received[0] += event['encodedDataLength']

        session.on('Network.loadingFinished', add)
        page.goto(address)
        page.wait_for_selector('.content')
        page.wait_for_timeout(_SETTLE)
        painted = page.evaluate("() => performance.getEntriesByName('first-contentful-paint')[0].startTime")
        return painted * 1e-3, received[0]
    finally:
        context.close()


def open_pages(executable: str, address: str) -> Opened:
    """Open every view of a host three times in a browser that has kept nothing."""
    with sync_playwright() as playwright:
        browser = _launched(playwright, executable)
        opened = {view: [_open(browser, f'{address}/{view}') for _ in range(_OPENED)] for view in VIEWS}
        browser.close()
    return Opened(
        max(statistics.median(paint for paint, _ in times) for times in opened.values()),
        max(statistics.median(size for _, size in times) for times in opened.values()) * 1e-6,
    )


def show_distance(executable: str, address: str, seconds: float) -> Shown:
    """Show "Now" for a time."""
    with sync_playwright() as playwright:
        browser = _launched(playwright, executable)
        page = browser.new_page(viewport={'width': 1280, 'height': 900})
        page.goto(address)
        page.wait_for_function('() => document.querySelector(\'[data-field="hero.range"]\')?.dataset.sweep')
        page.wait_for_timeout(_SETTLE)
        found = page.evaluate(FRAMES, seconds)
        browser.close()
    missed = sum(max(0, round(gap * 1e-3 * _SCREEN) - 1) for gap in found['gaps'])
    return Shown(found['updates'] / found['took'], missed / (missed + len(found['gaps'])))


def _launched(playwright: Any, executable: str) -> Browser:
    arguments = ['--no-sandbox'] if os.geteuid() == 0 else []  # root has none
    return playwright.chromium.launch(executable_path=executable, args=arguments)
