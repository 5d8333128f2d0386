"""View "Diagnosis": what the live diagnosis says now and said before, findings over time, each opened in place."""

import collections
import datetime
import math
import time
from typing import Any
from urllib.parse import urlencode

from nicegui import ui

from ...files.findings import Effect, Finding
from ...state.history import WINDOWS
from ...state.store import Store
from ...state.verdicts import Span
from ...words.numbers import general
from ...words.numbers import span as span_of
from ...words.phrases import PHRASES, phrase
from ..frame import Viewer, field, link, section, set_text, table, text
from .strip import STATES, picture

_REFRESH = 2.0  # of findings and verdicts over time [s]
_SPANS = WINDOWS[2:]  # that can be shown: a look comes every 30 s
_STEPS = 1000  # in which the strip moves on


class DiagnosisView:
    """One browser's view; a finding that is added or goes leaves the others, and what is open in them, as they are."""

    def __init__(self, viewer: Viewer) -> None:
        """Add the view."""
        self._viewer = viewer
        self._entries: dict[Finding, ui.element] = {}
        self._strips: dict[str, ui.html] = {}
        self._span = viewer.span if viewer.span in _SPANS else _SPANS[1]
        say = viewer.say
        with section(say('diagnosis.watch')):
            field('p', 'watch.none', 'empty')
            headings = [say('stations.level'), say('time.pair'), say('stations.message')]
            table('watch', headings, english=(2,))
        with section(say('diagnosis.time')):
            self._choice()
            self._times = ui.element('div')
            with ui.element('div').classes('line scale'):
                self._begin, self._end = text('span', ''), text('span', '')
        with section(say('diagnosis.findings')):
            self._none = text('p', '', 'empty')
            self._list = ui.element('div')
        self._refresh()
        ui.timer(_REFRESH, self._refresh)

    def _choice(self) -> None:
        say = self._viewer.say
        with ui.element('nav').classes('line') as spans:
            spans.props['aria-label'] = say('time.span')
            for span in _SPANS:
                link(say(f'span.{span}'), f'/diagnosis?{urlencode({"span": span})}', 'choice', span == self._span)
        with ui.element('p').classes('legend'):
            for level, state in STATES.items():
                text('span', say(f'level.{level}'), 'key').props['data-state'] = state
            text('span', say('diagnosis.finding'), 'key key-mark')

    def _refresh(self) -> None:
        findings = self._viewer.host.findings.list()
        for gone in self._entries.keys() - set(findings):
            self._entries.pop(gone).delete()
        for finding in reversed(findings):
            if finding not in self._entries:
                with self._list:
                    self._entries[finding] = _finding(self._viewer, finding)
                self._entries[finding].move(target_index=0)
        none = (
            ''
            if findings
            else self._viewer.say('diagnosis.no-findings', directory=self._viewer.host.findings.directory)
        )
        set_text(self._none, none)
        self._show_times(findings)

    def _show_times(self, findings: list[Finding]) -> None:
        """Show what was said of each pair, up to now."""
        store = self._viewer.host.store
        step = self._span / _STEPS
        end = math.ceil(time.time() / step) * step
        begin = end - self._span
        with store.lock:
            said = {pair: verdicts.since(begin) for pair, verdicts in store.verdicts.items()}
        found = {f.pair: [g.when for g in findings if g.pair == f.pair] for f in findings if f.pair and f.when > begin}
        for pair in sorted({*said, *found}):
            if pair not in self._strips:
                with self._times:
                    text('h3', pair.replace('/', ' → '))
                    self._strips[pair] = ui.html('', sanitize=False)  # numbers, and a label that `picture` escapes
            label = f'{pair}: {self._shares(said.get(pair, []))}'
            self._strips[pair].set_content(picture(said.get(pair, []), found.get(pair, []), begin, end, label))
        set_text(self._begin, datetime.datetime.fromtimestamp(begin).isoformat(' ', 'minutes'))
        set_text(self._end, datetime.datetime.fromtimestamp(end).isoformat(' ', 'minutes'))

    def _shares(self, spans: list[Span]) -> str:
        """Return how long each level lasted."""
        lasted = collections.Counter[int]()
        for span in spans:
            lasted[min(span.level, 3)] += round(span.end - span.begin)
        return ', '.join(
            f'{self._viewer.say(f"level.{level}")} {span_of(seconds, self._viewer.language)}'
            for level, seconds in sorted(lasted.items())
        )


def _finding(viewer: Viewer, finding: Finding) -> ui.element:
    """Add one finding; return its element."""
    say = viewer.say
    key = f'verdict.{finding.verdict}'
    when = datetime.datetime.fromtimestamp(finding.when).isoformat(' ', 'seconds')
    with ui.element('article').classes('finding') as entry:
        with ui.element('div').classes('line'):
            text('strong', say(key if key in PHRASES else 'verdict.other'))
            text('span', ' · '.join(filter(None, (finding.pair.replace('/', ' → '), when))), 'quiet')
        for effect in finding.effects:
            text('p', _described(effect, viewer.language), english=True)
        chance = general(finding.significance, 2, viewer.language) if finding.significance > 0.0 else '< 1e-300'
        text('p', f'{say("diagnosis.significance")}: {chance}', 'quiet')
        if finding.next_measurement:
            with ui.element('p'):
                text('span', f'{say("diagnosis.next")}: ')
                text('span', finding.next_measurement, english=True)
        if finding.report:
            show_in_place(viewer, say('diagnosis.open'), f'/findings/{finding.name}/report.html')
    return entry


def _described(effect: Effect, language: str) -> str:
    """Return an effect as 'sweep_ripple of master: deviation = 1200 ± 40 Hz; period = 3.1 ± 0.2 µs'."""
    of = f' ({effect.station})' if effect.station else ''
    values = (
        f'{name} = {general(value, 4, language)} ± {general(std, 2, language)} {unit}'.strip()
        for name, value, std, unit in effect.parameters
    )
    return f'{effect.name}{of}: {"; ".join(values)}'


def show_in_place(viewer: Viewer, label: str, address: str) -> None:
    """Add a button that shows a page of this host below itself, in a frame without scripts."""
    place = ui.element('div')

    def show() -> None:
        place.clear()
        if shown[0]:
            shown[0] = False
            return
        shown[0] = True
        with place:
            inner = ui.element('iframe').classes('report')
            inner.props['src'], inner.props['sandbox'], inner.props['title'] = address, '', label

    shown = [False]
    ui.button(label, on_click=show).props('outline no-caps dense').move(target_index=-1)
    place.move(target_index=-1)


def update(store: Store, options: Any, whole: bool) -> dict[str, Any]:
    """Return what the watch nodes say."""
    if not whole:
        return {}
    found = [d for d in store.current_diagnostics() if d.watched]
    rows = [
        [
            {'text': phrase(f'level.{min(d.level, 3)}', options.language), 'state': STATES[min(d.level, 3)]},
            d.watched.replace('/', ' → '),
            '; '.join([d.message, *(f'{key}: {value}' for key, value in d.values)]),
        ]
        for d in found
    ]
    none = '' if rows else phrase('diagnosis.no-watch', options.language)
    return {'rows': {'watch': rows}, 'text': {'watch.none': none}}


def build(viewer: Viewer) -> None:
    """Add the view."""
    DiagnosisView(viewer)
