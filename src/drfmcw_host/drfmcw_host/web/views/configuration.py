"""View "Configuration": every parameter of the running nodes, changed through their own parameter services."""

import asyncio
from collections.abc import Callable
from typing import Any

from nicegui import ui

from drfmcw_physics.settings import ConfigurationError

from ...configure.calls import Unreachable
from ...configure.parameter_file import save
from ...configure.values import Described, as_number, shown, typed
from ..frame import Viewer, section, text

_PARAMETER = 'parameter'
"""Action in the audit log."""


class ConfigurationView:
    """One browser's view: the chosen node, its parameters, what was changed."""

    def __init__(self, viewer: Viewer) -> None:
        """Add the view; the parameters come when the node has answered."""
        self._viewer = viewer
        self._filter = ''
        self._parameters: list[Described] = []
        nodes = viewer.host.remote.nodes()
        if not viewer.may_change:
            text('p', viewer.say('login.needed'), 'note')
        if not nodes:
            text('p', viewer.say('config.none'), 'empty')
            return
        self._node = nodes[0]
        with ui.element('section').classes('card'):
            with ui.element('div').classes('line choices'):
                ui.toggle(nodes, value=self._node, on_change=self._choose).props('no-caps unelevated')
                ui.input(viewer.say('config.filter'), on_change=self._search).props('dense clearable outlined')
                ui.button(viewer.say('config.reload'), on_click=self.load).props('outline no-caps')
            self._table = ui.element('div').classes('scroll')
        with section(viewer.say('config.changes')):
            self._log = ui.element('div').classes('scroll')
        if viewer.may_change:
            with section(viewer.say('config.save')), ui.element('div').classes('line'):
                name = ui.input(viewer.say('config.file'), value='site').props('dense outlined')
                ui.button(viewer.say('config.save'), on_click=lambda: self._save(nodes, name.value)).props('no-caps')
        self._show_log()
        ui.timer(0.05, self.load, once=True)

    async def _choose(self, event: Any) -> None:
        self._node = event.value
        await self.load()

    def _search(self, event: Any) -> None:
        self._filter = (event.value or '').lower()
        self._show()

    async def load(self) -> None:
        """Ask the node for its parameters and show them."""
        try:
            self._parameters = await self._viewer.host.remote.describe(self._node)
        except Unreachable:
            self._parameters = []
            ui.notify(self._viewer.say('config.unreachable', node=self._node), type='warning')
        self._show()

    def _show(self) -> None:
        say = self._viewer.say
        self._table.clear()
        with self._table, ui.element('table').classes('parameters'):
            with ui.element('thead'), ui.element('tr'):
                for heading in ('parameter', 'value', 'unit', 'range', 'meaning'):
                    text('th', say(f'config.{heading}'))
            with ui.element('tbody'):
                for parameter in self._parameters:
                    if self._filter in f'{parameter.name} {parameter.description}'.lower():
                        self._row(parameter)

    def _row(self, parameter: Described) -> None:
        with ui.element('tr') as row:
            row.props['data-parameter'] = parameter.name
            text('th', parameter.name)
            with ui.element('td').classes('value'):
                self._editor(parameter)
            text('td', parameter.unit)
            text('td', parameter.bounds(self._viewer.language))
            text('td', parameter.description, english=True)

    def _editor(self, parameter: Described) -> None:
        say, current = self._viewer.say, shown(parameter.value, self._viewer.language)
        if parameter.read_only:
            text('span', current)
            text('span', say('config.fixed'), 'quiet')
            return
        if not self._viewer.may_change:
            text('span', current)
            return
        field: Any
        options = ['true', 'false'] if parameter.kind is bool else parameter.choices
        if options:
            field = ui.select(options if current in options else [current, *options], value=current)
        else:
            field = ui.input(value=current)
        field.props('dense outlined')
        field.props['aria-label'] = parameter.name
        apply = self._apply(parameter, field)
        field.on('keydown.enter', apply)
        button = ui.button(say('config.apply'), on_click=apply).props('no-caps dense flat')
        button.props['aria-label'] = f'{say("config.apply")}: {parameter.name}'

    def _apply(self, parameter: Described, field: Any) -> Callable[[], Any]:
        async def apply() -> None:
            await self.change(parameter, str(field.value), self._viewer.language)

        return apply

    async def change(self, parameter: Described, content: str, language: str) -> None:
        """Set a parameter to what was typed in a language; say and log what became of it, the values as ROS writes."""
        viewer, meant = self._viewer, content
        if not viewer.allowed(f'{_PARAMETER} {parameter.node} {parameter.name}'):
            return
        try:
            value = typed(content, parameter.kind, language)
            meant = shown(value)
            taken, reason = await viewer.host.remote.set(parameter, value)
        except ConfigurationError as error:
            taken, reason = False, str(error)
        except Unreachable:
            taken, reason = False, viewer.say('config.unreachable', node=parameter.node)
        details = {'node': parameter.node, 'name': parameter.name, 'from': shown(parameter.value), 'to': meant}
        viewer.record(_PARAMETER, **details, taken=taken, reason=reason)
        values = {'node': parameter.node, 'name': parameter.name, 'value': as_number(meant, viewer.language)}
        with self._table:  # the row that asked is built anew, before it is said: what is typed then is not lost
            self._show_log()
            await self.load()
            if taken:
                ui.notify(viewer.say('config.taken', **values), type='positive')
            else:
                message = viewer.say('config.refused', **values, reason=reason)
                ui.notify(message, type='negative', timeout=10_000, close_button=True)

    def _show_log(self) -> None:
        say = self._viewer.say
        entries = [e for e in reversed(self._viewer.host.audit.entries) if e.get('action') == _PARAMETER][:20]
        self._log.clear()
        with self._log:
            if not entries:
                text('p', say('config.no-changes'), 'empty')
                return
            with ui.element('table').classes('changes'):
                with ui.element('thead'), ui.element('tr'):
                    for heading in ('time', 'who', 'what', 'result'):
                        text('th', say(f'config.{heading}'))
                    text('th', '')
                with ui.element('tbody'):
                    for entry in entries:
                        self._entry(entry)

    def _entry(self, entry: dict[str, Any]) -> None:
        say = self._viewer.say
        with ui.element('tr'):
            text('td', str(entry.get('time', ''))[:19].replace('T', ' '))
            text('td', str(entry.get('user', '')))
            values = [as_number(str(entry.get(key)), self._viewer.language) for key in ('from', 'to')]
            text('td', f'{entry.get("node")} {entry.get("name")}: {" → ".join(values)}')
            if entry.get('taken'):
                text('td', say('config.accepted'))
            else:
                text('td', str(entry.get('reason', '')), english=True)
            with ui.element('td'):
                if entry.get('taken') and self._viewer.may_change:
                    ui.button(say('config.undo'), on_click=self._undo(entry)).props('no-caps dense flat')

    def _undo(self, entry: dict[str, Any]) -> Callable[[], Any]:
        async def undo() -> None:
            try:
                parameters = await self._viewer.host.remote.describe(str(entry['node']))
            except Unreachable:
                ui.notify(self._viewer.say('config.unreachable', node=entry['node']), type='warning')
                return
            for parameter in parameters:
                if parameter.name == entry['name']:
                    await self.change(parameter, str(entry['from']), 'en')

        return undo

    async def _save(self, nodes: list[str], name: str) -> None:
        viewer = self._viewer
        if not viewer.allowed('save parameters'):
            return
        try:
            found = await asyncio.gather(*(viewer.host.remote.describe(node) for node in nodes))
            parameters = [parameter for described in found for parameter in described]
            path = save(viewer.host.state / 'parameters', name, parameters)
        except (ConfigurationError, Unreachable) as error:
            ui.notify(str(error), type='negative')
            return
        viewer.record('save parameters', path=str(path))
        ui.notify(viewer.say('config.saved', path=path), type='positive', timeout=20_000, close_button=True)


def build(viewer: Viewer) -> None:
    """Add the view."""
    ConfigurationView(viewer)
