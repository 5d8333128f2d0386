"""View "Calibration": what each station uses, earlier ones, and what another one would change before it is stored."""

import dataclasses
import datetime
import math
import time
from collections.abc import Callable
from typing import Any

import yaml
from nicegui import events, ui

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.calibration.document import Document, now

from ...configure.calibration import typed_document
from ...configure.calls import Unreachable
from ...configure.comparison import Effect, Shown, effects, side_by_side
from ...files.calibrations import key_of
from ...words.numbers import NONE, clock, deviation, general, number, plus_minus, span
from ..frame import Viewer, section, set_text, text

_CALIBRATION = 'calibration'
"""Action in the audit log."""

_LARGEST = 1 << 16  # of a document [letters]
_NO_TEXT = '\N{REPLACEMENT CHARACTER}'  # in place of bytes that are no UTF-8
_READ_FILE = f"""async (event) => {{
  const [file] = event.target.files;
  if (file) emit(file.size > {_LARGEST} ? null : await file.text());
  event.target.value = '';
}}"""
"""Hands over the text of a chosen file, null for one that is too large."""

_READ_EDITOR = "(event) => emit(event.target.closest('section').querySelector('textarea').value)"
"""Hands over the text that the browser shows: the editor's own message may not have arrived."""

_REFRESH = 1.0  # of what is in use [s]
_HISTORY = ('version', 'date', 'operator', 'note', 'reference', 'adc', 'delay')


class CalibrationView:
    """One browser's view; a station's card is built again when what it shows has changed."""

    def __init__(self, viewer: Viewer) -> None:
        """Add the view."""
        self._viewer = viewer
        self._shown: dict[str, Any] = {}
        self._ages: dict[str, ui.element] = {}  # a text of its own: a card that is built again loses the focus
        say, stations = viewer.say, sorted(viewer.host.store.stations)
        if not viewer.may_change:
            text('p', say('login.needed'), 'note')
        if not stations:
            text('p', say('stations.none'), 'empty')
            return
        self._comparison = ui.element('div')
        with ui.element('div').classes('stack'):
            self._cards = {name: ui.element('div') for name in stations}
        if viewer.may_change:
            with section(say('cal.enter')):
                text('p', say('cal.enter.how'), 'quiet')
                self._text = ui.textarea(say('cal.document')).props(f'outlined maxlength={_LARGEST} rows=10')
                self._text.classes('document')
                with ui.element('div').classes('line'):
                    with ui.element('label'):
                        text('span', f'{say("cal.file")} ')
                        chosen = ui.element('input').classes('file').props('type=file accept=.yaml,.yml,.json')
                        chosen.on('change', self._enter, js_handler=_READ_FILE)
                    ui.button(say('cal.compare')).props('no-caps').on('click', self._enter, js_handler=_READ_EDITOR)
        self._refresh()
        ui.timer(_REFRESH, self._refresh)

    # --- what is in use, and what was ---

    def _used(self, name: str) -> Calibration | None:
        with self._viewer.host.store.lock:
            return self._viewer.host.store.stations[name].calibration

    def _refresh(self) -> None:
        for name, card in self._cards.items():
            used = self._used(name)
            history = self._viewer.host.calibrations.of(name)
            known = self._viewer.host.calibrations.known(used) if used is not None else None
            age = _age(known, self._viewer.language)
            shown = (used and key_of(used), [key_of(d.calibration()) for d in history])
            if name in self._ages:
                set_text(self._ages[name], age)
            if self._shown.get(name) == shown:
                continue
            self._shown[name] = shown
            card.clear()
            self._ages.pop(name, None)
            with card, section(name) as element:
                element.props['data-station'] = name
                if used is None or known is None:
                    text('p', self._viewer.say('cal.none'), 'empty')
                else:
                    self._in_use(known, used, age)
                    self._history(history, used)

    def _in_use(self, document: Document, used: Calibration, age: str) -> None:
        viewer, language = self._viewer, self._viewer.language
        delay = f'{number(used.delay, 3, language, 1e9)} {plus_minus(used.delay_std, 1e9, language)} ns'
        peer = f' ({viewer.say("cal.with", peer=used.delay_peer)})' if used.delay_peer else ''
        warm = used.temperature_high > used.temperature_low
        values = {
            'version': str(used.version) if used.version else viewer.say('cal.unstored'),
            'age': age,
            'operator': document.operator or NONE,
            'instrument': document.instrument or NONE,
            'reference': clock(used.alpha, used.alpha_std, language),
            'adc': clock(used.sample_clock_alpha, used.sample_clock_alpha_std, language),
            'delay': delay + peer,
            'range': f'{_bound(used.temperature_low, language)} … {_bound(used.temperature_high, language)} °C'
            if warm
            else f'{_bound(used.temperature, language)} °C',
        }
        with ui.element('dl').classes('values small'):
            for key, value in values.items():
                shown = _pair(viewer.say(f'cal.{key}'), value, key)
                if key == 'age':
                    self._ages[used.station] = shown
            for effect in effects(viewer.host.store, used, used):
                title = viewer.say(
                    'cal.uncertain',
                    pair=effect.pair.replace('/', ' → '),
                    distance=general(effect.distance, 6, language),
                )
                _pair(title, deviation(effect.std_after, language), 'uncertain')
        if document.note:
            text('p', document.note, 'quiet')
        if viewer.may_change:
            ui.button(viewer.say('cal.edit'), on_click=lambda: self._edit(document)).props('no-caps outline dense')

    def _history(self, history: list[Document], used: Calibration) -> None:
        say, language = self._viewer.say, self._viewer.language
        text('h3', say('cal.history'))
        with ui.element('div').classes('scroll'), ui.element('table').classes('history'):
            with ui.element('thead'), ui.element('tr'):
                for heading in _HISTORY:
                    text('th', say(f'cal.{heading}'))
                text('th', '')
            with ui.element('tbody'):
                for document in history:
                    c = document.calibration()
                    with ui.element('tr') as row:
                        row.props['data-version'] = str(document.version)
                        text('td', str(document.version) if document.version else say('cal.unstored'))
                        text('td', document.date[:19].replace('T', ' ') or NONE)
                        text('td', document.operator or NONE)
                        text('td', document.note or NONE)
                        text('td', clock(c.alpha, c.alpha_std, language))
                        text('td', clock(c.sample_clock_alpha, c.sample_clock_alpha_std, language))
                        text('td', f'{number(c.delay, 3, language, 1e9)} ns')
                        with ui.element('td'):
                            if key_of(c) == key_of(used):
                                text('span', say('cal.in-use'), 'badge')
                            else:
                                self._offer(document)

    def _offer(self, document: Document) -> None:
        again = f'version {document.version} again' + (f': {document.note}' if document.note else '')
        button = ui.button(
            self._viewer.say('cal.compare'), on_click=lambda: self.compare(dataclasses.replace(document, note=again))
        )
        button.props('no-caps dense flat')

    # --- what another one changes ---

    def _edit(self, document: Document) -> None:
        content = yaml.safe_load(document.text())
        for key in ('checksum', 'version', 'date', 'operator'):
            content.pop(key, None)
        self._text.value = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=110)
        ui.run_javascript(f'getHtmlElement({self._text.id}).scrollIntoView({{block: "center"}})')

    def _enter(self, event: events.GenericEventArguments) -> None:
        content = event.args
        if not isinstance(content, str) or len(content) > _LARGEST:
            self._refused(self._viewer.say('cal.file.large'))
        elif _NO_TEXT in content:
            self._refused(self._viewer.say('cal.file.text'))
        else:
            self._text.value = content
            try:
                document = typed_document(content, self._viewer.say('cal.document'))
            except ConfigurationError as error:
                self._refused(str(error))
            else:
                self.compare(document)

    def _refused(self, reason: str) -> None:
        message = self._viewer.say('cal.refused', reason=reason)
        ui.notify(message, type='negative', timeout=15_000, close_button=True)

    def compare(self, document: Document) -> None:
        """Show what a document would change; nothing is stored yet."""
        viewer, say = self._viewer, self._viewer.say
        used = self._used(document.station) if document.station in self._cards else None
        self._comparison.clear()
        if used is None:
            self._refused(say('cal.unknown', station=document.station[:100]))
            return
        with self._comparison, section(say('cal.changes', station=document.station)) as element:
            element.props['data-comparison'] = document.station
            self._values(viewer.host.calibrations.known(used), document)
            self._effects(effects(viewer.host.store, used, document.calibration()))
            with ui.element('div').classes('line'):
                if viewer.may_change:
                    label = say('cal.store', station=document.station)
                    ui.button(label, on_click=self._storing(document, used)).props('no-caps')
                ui.button(say('rec.cancel'), on_click=self._comparison.clear).props('no-caps outline')
        ui.run_javascript(f'getHtmlElement({self._comparison.id}).scrollIntoView({{block: "center"}})')

    def _values(self, before: Document, after: Document) -> None:
        say, language = self._viewer.say, self._viewer.language
        with ui.element('div').classes('scroll'), ui.element('table').classes('comparison'):
            with ui.element('thead'), ui.element('tr'):
                for heading in ('value', 'unit', 'before', 'after', 'difference'):
                    text('th', say(f'cal.{heading}'))
            with ui.element('tbody'):
                for value in side_by_side(before, after):
                    part = f'{say(f"cal.section.{value.section}")}: ' if value.section else ''
                    with ui.element('tr') as row:
                        row.props['data-value'] = f'{value.section}.{value.key}'.lstrip('.')
                        text('td', f'{part}{say(f"cal.key.{value.key}")}')
                        text('td', value.unit)
                        text('td', _text(value.before, language))
                        changed = text('td', _text(value.after, language))
                        difference = text('td', _difference(value.before, value.after, language))
                        if value.changed:
                            changed.props['data-state'] = difference.props['data-state'] = 'doubtful'

    def _effects(self, found: list[Effect]) -> None:
        say, language = self._viewer.say, self._viewer.language
        text('h3', say('cal.effect'))
        if not found:
            text('p', say('cal.no-effect'), 'empty')
            return
        with ui.element('div').classes('scroll'), ui.element('table').classes('effects'):
            with ui.element('thead'), ui.element('tr'):
                for heading in ('pair', 'distance', 'shift', 'std-before', 'std-after'):
                    text('th', say(f'cal.{heading}'))
            with ui.element('tbody'):
                for effect in found:
                    with ui.element('tr') as row:
                        row.props['data-effect'] = f'{effect.pair} {effect.distance:g}'
                        text('td', effect.pair.replace('/', ' → '))
                        text('td', f'{general(effect.distance, 6, language)} m')
                        text('td', f'{number(effect.shift, 2, language, 1e3, sign=True)} mm')
                        text('td', deviation(effect.std_before, language))
                        text('td', deviation(effect.std_after, language))
        text('p', say('cal.effect.how'), 'quiet')

    # --- storing it ---

    def _storing(self, document: Document, compared: Calibration) -> Callable[[], Any]:
        async def store() -> None:
            viewer, station = self._viewer, document.station
            if not viewer.allowed(f'{_CALIBRATION} {station}'):
                return
            used = self._used(station)
            if used is None or key_of(used) != key_of(compared):  # somebody else was faster
                ui.notify(viewer.say('cal.overtaken', station=station), type='warning')
                self.compare(document)
                return
            await self._store(document, used.version)

        return store

    async def _store(self, document: Document, replaced: int) -> None:
        viewer, station = self._viewer, document.station
        user = viewer.session.user if viewer.session else ''
        accepted, reason, version = False, '', 0
        try:
            answer = await viewer.host.stations.store(document, user)
            accepted, reason, version = answer.accepted, answer.reason, answer.version
        except Unreachable:
            reason = viewer.say('cal.unreachable', station=station)
        details = {'station': station, 'from': replaced, 'to': version, 'note': document.note}
        viewer.record(_CALIBRATION, **details, taken=accepted, reason=reason)
        if not accepted:
            self._refused(reason)
            return
        stored = dataclasses.replace(document, version=version, date=now(), operator=user)
        try:
            viewer.host.calibrations.keep(stored)
        except ConfigurationError as error:
            ui.notify(str(error), type='warning')
        ui.notify(viewer.say('cal.stored', station=station, version=version), type='positive')
        self._comparison.clear()


def _pair(title: str, value: str, key: str) -> ui.element:
    """Add a title and its value; return the element of the value."""
    with ui.element('div'):
        text('dt', title)
        shown = text('dd', value)
    shown.props['data-key'] = key
    return shown


def _bound(value: float, language: str) -> str:
    return general(value, 4, language)


def _age(document: Document | None, language: str) -> str:
    """Return the time since a document was stored, '–' where its date is not known."""
    try:
        stored = datetime.datetime.fromisoformat(document.date).timestamp() if document else math.nan
    except ValueError:
        stored = math.nan
    return span(max(0.0, time.time() - stored), language) if math.isfinite(stored) else NONE


def _text(value: Shown, language: str) -> str:
    if value is None:
        return NONE
    if isinstance(value, tuple):
        return '; '.join(general(v, 4, language) for v in value)
    return value if isinstance(value, str) else general(value, 9, language)


def _difference(before: Shown, after: Shown, language: str) -> str:
    if before == after:
        return ''
    if isinstance(before, float) and isinstance(after, float):
        return general(after - before, 4, language, sign=True)
    return NONE


def build(viewer: Viewer) -> None:
    """Add the view."""
    CalibrationView(viewer)
