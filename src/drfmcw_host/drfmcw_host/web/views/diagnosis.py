"""View "Diagnosis": what the live diagnosis says now, findings over time, each report opened in place."""

import datetime
from typing import Any

from nicegui import ui

from ...files.findings import Effect, Finding, read_findings
from ...state.store import Store
from ...words.numbers import general
from ...words.phrases import PHRASES, phrase
from ..frame import Viewer, field, section, table, text

_WATCH = 'watch: Model '
_LEVELS = {0: 'good', 1: 'doubtful', 2: 'unusable', 3: 'stale'}


def build(viewer: Viewer) -> None:
    """Add the view."""
    say = viewer.say
    with section(say('diagnosis.watch')):
        field('p', 'watch.none', 'empty')
        table('watch', [say('stations.level'), say('stations.name'), say('stations.message')])
    with section(say('diagnosis.findings')):
        findings = read_findings(viewer.host.findings)
        if not findings:
            text('p', say('diagnosis.no-findings', directory=viewer.host.findings), 'empty')
        for finding in findings:
            _finding(viewer, finding)


def _finding(viewer: Viewer, finding: Finding) -> None:
    say = viewer.say
    key = f'verdict.{finding.verdict}'
    when = datetime.datetime.fromtimestamp(finding.when).isoformat(' ', 'seconds')
    with ui.element('article').classes('finding'):
        with ui.element('div').classes('line'):
            text('strong', say(key if key in PHRASES else 'verdict.other'))
            text('span', when, 'quiet')
        for effect in finding.effects:
            text('p', _described(effect, viewer.language))
        chance = general(finding.significance, 2, viewer.language) if finding.significance > 0.0 else '< 1e-300'
        text('p', f'{say("diagnosis.significance")}: {chance}', 'quiet')
        if finding.next_measurement:
            text('p', f'{say("diagnosis.next")}: {finding.next_measurement}')
        if finding.report:
            show_in_place(viewer, say('diagnosis.open'), f'/findings/{finding.name}/report.html')


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
    found = [d for d in store.current_diagnostics() if d.name.startswith(_WATCH)]
    rows = [
        [
            {'text': phrase(f'level.{min(d.level, 3)}', options.language), 'state': _LEVELS[min(d.level, 3)]},
            d.name.removeprefix(_WATCH),
            '; '.join([d.message, *(f'{key}: {value}' for key, value in d.values)]),
        ]
        for d in found
    ]
    none = '' if rows else phrase('diagnosis.no-watch', options.language)
    return {'rows': {'watch': rows}, 'text': {'watch.none': none}}
