"""View "Over time": range, error, standard deviation and rate, from 10 s to 24 h, decimated here."""

import time
from typing import Any
from urllib.parse import urlencode

import numpy as np
from nicegui import ui

from ...state.history import WINDOWS, Curve
from ...state.store import SERIES, Store
from ...words.phrases import phrase
from ..charts import axis_chart, colours
from ..frame import Viewer, chart, link, section

_UNITS = {'range': ('m', 1.0), 'error': ('mm', 1e3), 'std': ('mm', 1e3), 'rate': ('1/s', 1.0)}
_GAP = 3.5  # intervals without a value, beyond which the curve is interrupted


def build(viewer: Viewer) -> None:
    """Add the view."""
    say, store = viewer.say, viewer.host.store
    names = sorted(store.pairs)
    chosen = viewer.pair
    with ui.element('div').classes('line choices'):
        with ui.element('nav') as spans:
            spans.props['aria-label'] = say('time.span')
            for window in WINDOWS:
                query = urlencode({'span': window, 'pair': chosen})
                link(say(f'span.{window}'), f'/over-time?{query}', 'choice', window == viewer.span)
        with ui.element('nav') as pairs:
            pairs.props['aria-label'] = say('time.pair')
            for name in names:
                query = urlencode({'span': viewer.span, 'pair': name})
                link(name.replace('/', ' → '), f'/over-time?{query}', 'choice', name == chosen)
    with ui.element('div').classes('grid'):
        for index, series in enumerate(SERIES):
            unit, _ = _UNITS[series]
            with section(f'{say(f"time.{series}")} [{unit}]'):
                chart(series, _options(viewer, index), say(f'time.{series}'))


def _options(viewer: Viewer, index: int) -> dict[str, Any]:
    palette = colours(viewer.theme)
    colour = palette.lines[index]
    plain = {'type': 'line', 'showSymbol': False, 'data': [], 'silent': True, 'animation': False}
    options = axis_chart(palette, viewer.language, time_axis=True)
    options['series'] = [
        plain | {'name': 'low', 'stack': 'band', 'lineStyle': {'opacity': 0}, 'stackStrategy': 'all'},
        plain
        | {
            'name': viewer.say('time.extremes'),
            'stack': 'band',
            'stackStrategy': 'all',
            'lineStyle': {'opacity': 0},
            'areaStyle': {'color': colour, 'opacity': 0.3},
        },
        plain | {'name': viewer.say('time.mean'), 'lineStyle': {'color': colour, 'width': 2}},
    ]
    return options


def update(store: Store, options: Any, whole: bool) -> dict[str, Any]:
    """Return the four charts."""
    if not store.pairs or not whole:
        return {}
    pair = store.pairs[store.chosen(options.pair)]
    now = time.time_ns()
    return {
        'chart': {
            series: _curves(pair.histories[series].curve(options.span, now), series, options, now) for series in SERIES
        }
    }


def _curves(curve: Curve, series: str, options: Any, now: int) -> dict[str, Any]:
    """Return the chart's series and axis; nothing stands where nothing was measured."""
    scale = _UNITS[series][1]
    times = np.round(curve.times * 1e3)
    low, mean, high = (np.round(values * scale, 4) for values in (curve.low, curve.mean, curve.high))
    columns = np.column_stack([times, low, high - low, mean])
    if len(times) > 2:
        steps = np.diff(times)
        gaps = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
        empty = np.full((len(gaps), 4), np.nan)
        empty[:, 0] = times[gaps] - 1
        columns = np.insert(columns, gaps, empty, axis=0)
    end = now // 1_000_000
    band = [columns[:, [0, i]] for i in (1, 2, 3)]
    missing = series == 'error' and not len(times)
    title = {'show': missing, 'text': phrase('time.no-reference', options.language) if missing else ''}
    return {
        'title': title,
        'xAxis': {'min': end - options.span * 1000, 'max': end},
        'series': [{'data': np.ascontiguousarray(data)} for data in band],
    }
