"""Part of the view "Stations": what the nodes log, from a level on."""

import datetime
from typing import Any

from nicegui import ui

from ...state.readings import LOG_LEVELS
from ...state.store import Store
from ...words.phrases import phrase
from ..frame import Viewer, choice, field, section, table

_LEVELS = {10: ('debug', 'stale'), 20: ('info', 'good'), 30: ('warning', 'doubtful'), 40: ('error', 'unusable')}
"""From a level on: (name, state)."""


def build(viewer: Viewer) -> None:
    """Add the table and the choice of its level."""
    say = viewer.say
    with section(say('logs.title')):
        with ui.element('div').classes('choices').props('role=group') as levels:
            levels.props['aria-label'] = say('logs.from')
            for level in LOG_LEVELS:
                choice('level', level, say(f'logs.from.{level}'), level == LOG_LEVELS[0])
        headings = [say(f'logs.{name}') for name in ('time', 'level', 'name', 'message')]
        field('p', 'logs.none', 'empty')
        table('logs', headings, 'logs', limited=True, english=(3,))


def update(store: Store, options: Any) -> dict[str, Any]:
    """Return the rows of the table, the newest first."""
    found: list[list[Any]] = []
    for line in store.newest_logs(options.level):
        name, state = _LEVELS[max((low for low in _LEVELS if low <= line.level), default=10)]
        shown = {'text': phrase(f'logs.{name}', options.language), 'state': state}
        when = datetime.datetime.fromtimestamp(line.stamp).isoformat(' ', 'seconds')
        found.append([when, shown, line.name, line.message])
    none = '' if found else phrase('logs.none', options.language)
    return {'rows': {'logs': found}, 'text': {'logs.none': none}}
