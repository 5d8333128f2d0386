"""What all pages share: head, navigation, the user, and small elements whose content the stream fills."""

import contextlib
import copy
import dataclasses
import html
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from nicegui import ui
from starlette.requests import Request

from ..access.attempts import Attempts
from ..access.audit import Audit
from ..access.passwords import Passwords
from ..access.sessions import Session, Sessions
from ..configure.calibration import RemoteCalibrations
from ..configure.remote import RemoteParameters
from ..files.calibrations import Calibrations
from ..files.findings import Findings
from ..files.recordings import Recordings
from ..files.work import Work
from ..state.history import WINDOWS
from ..state.store import Store
from ..words.phrases import LANGUAGES, phrase
from .charts import colours

VIEWS = ('now', 'over-time', 'signals', 'stations', 'diagnosis', 'configuration', 'calibration', 'recordings')
"""Last part of each page's path, in the order of the navigation; the first one is also '/'."""

COOKIE, LANGUAGE, THEME = 'drfmcw_session', 'drfmcw_language', 'drfmcw_theme'
"""Names of the cookies."""

_CODES: dict[str, Any] = {'en': 'en-US', 'de': 'de'}  # of NiceGUI

STATIC = Path(__file__).parents[1] / 'static'


@dataclasses.dataclass
class Host:
    """Everything that the pages work with."""

    store: Store
    passwords: Passwords
    sessions: Sessions
    attempts: Attempts
    audit: Audit
    recordings: Recordings
    work: Work
    remote: RemoteParameters
    calibrations: Calibrations
    stations: RemoteCalibrations
    findings: Findings
    state: Path
    read_only: bool
    secure: bool
    version: str
    asset: str  # changes with the static files, so that a browser does not keep old ones


@dataclasses.dataclass(frozen=True)
class Viewer:
    """Who looks at a page, and how."""

    host: Host
    session: Session | None
    address: str
    language: str
    theme: str
    view: str
    pair: str
    span: int

    def say(self, key: str, **values: Any) -> str:
        """Return a phrase in the viewer's language."""
        text = phrase(key, self.language)
        return text.format(**values) if values else text

    @property
    def may_change(self) -> bool:
        """Whether the viewer may change anything now: logged in, and not logged out since."""
        return not self.host.read_only and self.session is not None and self.host.sessions.lives(self.session)

    def record(self, action: str, **details: Any) -> None:
        """Write what the viewer does into the audit log."""
        self.host.audit.write(self.session.user if self.session else '', self.address, action, **details)

    def allowed(self, action: str) -> bool:
        """Return whether the viewer may change anything; where not, say so and log the attempt."""
        if self.may_change:
            return True
        self.record('refused', what=action)
        ui.notify(self.say('login.needed'), type='warning')
        return False


def viewer_of(host: Host, request: Request, view: str) -> Viewer:
    """Return who sent a request, from its cookies and query."""
    cookies, query = request.cookies, request.query_params
    language = cookies.get(LANGUAGE) or preferred(request.headers.get('accept-language', ''))
    return Viewer(
        host,
        None if host.read_only else host.sessions.of(cookies.get(COOKIE)),
        request.client.host if request.client else '',
        language if language in LANGUAGES else 'en',
        'dark' if cookies.get(THEME) == 'dark' else 'light',
        view,
        host.store.chosen(query.get('pair', '')),
        span_in(query),
    )


def span_in(query: Mapping[str, str]) -> int:
    """Return the time span that a query names [s], a minute where it names none that can be shown."""
    return next((window for window in WINDOWS if str(window) == query.get('span')), WINDOWS[1])


def preferred(header: str) -> str:
    """Return the first language of an Accept-Language header that the page has, else 'en'."""
    for part in header.split(','):
        code = part.partition(';')[0].strip().lower()[:2]
        if code in LANGUAGES:
            return code
    return 'en'


def field(tag: str, key: str, classes: str = '', text: str = '') -> ui.element:
    """Add an element whose text or state the stream fills under `key`; `text` stands there until then."""
    element = ui.element(tag).classes(classes)
    element.props['data-field'] = key
    element.props['textContent'] = text
    return element


def text(tag: str, content: str, classes: str = '', english: bool = False) -> ui.element:
    """Add an element with a fixed text; `english` where it comes from a node, whatever the page's language is."""
    element = ui.element(tag).classes(classes)
    element.props['textContent'] = content
    if english:
        element.props['lang'] = 'en'
    return element


def set_text(element: ui.element, content: str) -> None:
    """Give an element another text; where it is the same, nothing is sent."""
    if element.props.get('textContent') != content:
        element.props['textContent'] = content
        element.update()


def link(content: str, target: str, classes: str = '', current: bool = False) -> None:
    """Add a link."""
    element = text('a', content, classes)
    element.props['href'] = target
    if current:
        element.props['aria-current'] = 'page'


def choice(option: str, value: object, content: str, chosen: bool) -> None:
    """Add a button that sets an option of the stream, one of several in an element around them."""
    element = text('button', content, 'choice')
    element.props['type'] = 'button'
    element.props['data-option'], element.props['data-value'] = option, str(value)
    element.props['aria-pressed'] = 'true' if chosen else 'false'


def section(title: str, classes: str = '') -> ui.element:
    """Add a section with its heading, to be used as a context."""
    element = ui.element('section').classes(f'card {classes}')
    with element:
        text('h2', title)
    return element


def table(key: str, headings: list[str], classes: str = '', limited: bool = False, english: Sequence[int] = ()) -> None:
    """Add a table whose rows the stream fills under `key`.

    Args:
        key: of the stream.
        headings: of the columns.
        classes: of the table.
        limited: it scrolls within a height of its own.
        english: columns whose texts come from nodes, whatever the page's language is.
    """
    around = ui.element('div').classes('scroll limited' if limited else 'scroll')
    if limited:
        around.props('tabindex=0')  # so that the arrow keys scroll it
    with around, ui.element('table').classes(classes):
        with ui.element('thead'), ui.element('tr'):
            for heading in headings:
                text('th', heading)
        body = ui.element('tbody')
        body.props['data-field'], body.props['data-english'] = key, ' '.join(map(str, english))


def chart(name: str, options: dict[str, Any], label: str) -> None:
    """Add a chart that the stream fills under `name`."""
    element = ui.echart(options).classes(f'chart chart-{name}')
    element.props['role'] = 'img'
    element.props['aria-label'] = label


def path_of(view: str) -> str:
    """Return the path of a view."""
    return '/' if view == VIEWS[0] else f'/{view}'


@contextlib.contextmanager
def frame(viewer: Viewer, layout: str) -> Iterator[None]:
    """Build a page's head and navigation; what is added inside becomes its content."""
    say, view = viewer.say, viewer.view
    client = ui.context.client
    client.page = copy.copy(client.page)  # that of the route is shared by all viewers
    client.page.language = _CODES[viewer.language]
    asset = viewer.host.asset
    ui.colors(primary=colours(viewer.theme).lines[0], positive='#00654d', negative='#a52a00', warning='#8a5a00')
    ui.page_title(f'{say(f"view.{view}")} · {say("title")}')
    ui.add_head_html(f'<link rel="stylesheet" href="/static/host.css?{asset}">')
    ui.add_body_html(f'<noscript>{html.escape(say("frame.script"))}</noscript>')
    ui.add_body_html(f'<script defer src="/static/live.js?{asset}"></script>')
    with ui.element('div').classes(f'page {viewer.theme}').props(f'lang={viewer.language}'):
        link(say('frame.skip'), '#content', 'skip')
        with ui.element('header'):
            _navigation(viewer)
            _tools(viewer)
        with ui.element('div').classes('lost').props('role=alert'):
            text('span', say('frame.lost'))
            field('b', 'lost', '', '')
        content = ui.element('div').classes('content').props('id=content tabindex=-1')
        content.props['data-layout'] = layout
        content.props['data-live'] = urlencode(
            {'view': view, 'language': viewer.language, 'pair': viewer.pair, 'span': viewer.span}
        )
        with content:
            text('h1', say(f'view.{view}'), 'hidden')
            yield


def _navigation(viewer: Viewer) -> None:
    text('strong', 'drfmcw', 'brand')
    nav = ui.element('nav')
    nav.props['aria-label'] = viewer.say('frame.navigation')
    with nav:
        for view in VIEWS:
            link(viewer.say(f'view.{view}'), path_of(view), current=view == viewer.view)


def _tools(viewer: Viewer) -> None:
    back = {'back': path_of(viewer.view)}
    other = 'de' if viewer.language == 'en' else 'en'
    theme = 'light' if viewer.theme == 'dark' else 'dark'
    with ui.element('div').classes('tools'):
        link(viewer.say(f'frame.{theme}'), f'/preference?{urlencode({"theme": theme, **back})}')
        link(LANGUAGES[other], f'/preference?{urlencode({"language": other, **back})}')
        if viewer.session is not None:
            with ui.element('form').props('method=post action=/logout'):
                text('span', viewer.session.user, 'user')
                button = text('button', viewer.say('frame.logout'))
                button.props['type'] = 'submit'
        else:
            text('span', viewer.say('frame.read-only'), 'badge')
            link(viewer.say('frame.login'), f'/login?{urlencode(back)}')
