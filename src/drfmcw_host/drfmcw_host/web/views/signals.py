"""View "Signals": what both stations receive, on one axis, and how strong it should be."""

import math
from typing import Any

import numpy as np
from nicegui import ui

from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.link_budget import received_power
from drfmcw_physics.sweep import SweepSettings

from ...state.freshness import Arrivals
from ...state.readings import decimated
from ...state.store import Store
from ...words import flags
from ...words.numbers import NONE, number, span
from ...words.phrases import phrase
from ..charts import Colours, axis_chart, colours
from ..frame import Viewer, chart, field, section, table, text

_FLOOR, _TOP = -110.0, 0.0  # of the spectra [dBFS]
_DARK, _BRIGHT = -100.0, -40.0  # of the waterfalls [dBFS]
_WATERFALL = 256  # frequencies
_ROWS = 120
_FADED = 0.3  # opacity of what is stale


def build(viewer: Viewer) -> None:
    """Add the view."""
    say = viewer.say
    pair = viewer.pair
    stations = pair.split('/') if pair else []
    palette = colours(viewer.theme)
    with section(f'{say("signals.spectra")} [dBFS]') as spectra:
        spectra.props['data-field'] = 'spectra'
        with ui.element('p').classes('legend'):
            for index, station in enumerate(dict.fromkeys(stations)):
                with ui.element('span'):
                    text('span', station, f'key key-{index}')
                    field('span', f'{station}.spectrum', 'chip')
            text('span', say('signals.line'), 'key key-line')
            text('span', say('signals.guard'), 'key key-guard')
        field('p', 'spectra.none', 'empty')
        chart('spectra', _options(viewer, palette), say('signals.spectra'))
    with ui.element('div').classes('grid'):
        for station in dict.fromkeys(stations):
            with section(say('signals.waterfall', station=station)):
                canvas = ui.element('canvas').classes('waterfall')
                canvas.props['data-field'] = f'{station}.waterfall'
                canvas.props['width'], canvas.props['height'] = _WATERFALL, _ROWS
                with ui.element('div').classes('line scale'):
                    text('span', '0')
                    field('span', f'{station}.waterfall.end')
    with section(say('signals.budget')):
        names = ('station', 'power', 'expected', 'difference', 'snr', 'beat', 'flags', 'age')
        table('budget', [say(f'signals.{name}') for name in names])


def _options(viewer: Viewer, palette: Colours) -> dict[str, Any]:
    options = axis_chart(palette, viewer.language)
    options['yAxis'] |= {'min': _FLOOR, 'max': _TOP}
    options['xAxis'] |= {
        'name': f'{viewer.say("signals.frequency")} [kHz]',
        'nameLocation': 'middle',
        'nameGap': 30,
        'nameTextStyle': {'color': palette.text, 'fontSize': 13},
        'min': 0,
    }
    options['grid']['bottom'] = 34
    options['series'] = [
        {
            'type': 'line',
            'showSymbol': False,
            'silent': True,
            'data': [],
            'animation': False,
            'lineStyle': {'color': palette.lines[index], 'width': 1.5, 'type': ('solid', 'solid')[index]},
            'markLine': {
                'symbol': 'none',
                'animation': False,
                'label': {'show': False},
                'lineStyle': {'color': palette.lines[index], 'type': 'dashed', 'width': 2},
                'data': [],
            },
            'markArea': {'silent': True, 'itemStyle': {'color': palette.guard}, 'data': []},
        }
        for index in range(2)
    ]
    return options


def guard_bands(settings: SweepSettings) -> list[tuple[float, float]]:
    """Return the bands [Hz] near 0 and Nyquist in which a line is flagged: docs/sensors_and_flags.md."""
    width = (EstimatorSettings().guard_bins + 2) / settings.ramp_duration
    half = settings.sample_rate / 2.0
    return [(0.0, width), (half - width, half)]


def expected_power(own: SweepSettings, peer: SweepSettings, distance: float) -> float:
    """Return the power of the peer's chirp at the receive antenna port in free space [dBm]."""
    if not distance > 0.0:
        return math.nan
    return float(received_power(peer.tx_eirp, own.rx_antenna_gain, distance, own.center_frequency))


def update(store: Store, options: Any, whole: bool) -> dict[str, Any]:
    """Return spectra, rows of the waterfalls and the table of powers; asks for spectra while somebody looks.

    What is stale is said in every message; curves come with whole ones.
    """
    store.want_signals()
    pair = store.chosen(options.pair)
    if not pair:
        return {}
    first, second = pair.split('/')
    ways = {first: second, second: first}
    texts: dict[str, str] = {}
    states: dict[str, str] = {}
    budget = []
    now = store.clock()
    for station, peer in ways.items():
        known = store.stations[station]
        seen = known.spectra_seen.get(peer, Arrivals())
        state = 'stale' if seen.is_stale(now) else 'good'
        texts[f'{station}.spectrum'] = _fresh(seen, now, options.language) if peer in known.spectra else ''
        states |= {f'{station}.spectrum': state, f'{station}.waterfall': state}
        budget.append(_powers(store, pair, station, peer, options.language))
    states['spectra'] = 'stale' if all(states[f'{name}.spectrum'] == 'stale' for name in ways) else 'good'
    shown = any(peer in store.stations[station].spectra for station, peer in ways.items())
    texts['spectra.none'] = '' if shown else phrase('signals.none', options.language)
    curves = _curves(store, ways, options.language) if whole else {}
    return {'text': texts | curves.pop('text', {}), 'state': states, 'rows': {'budget': budget}} | curves


def _curves(store: Store, ways: dict[str, str], language: str) -> dict[str, Any]:
    """Return spectra, lines, guard bands and the newest rows of the waterfalls."""
    series: list[dict[str, Any]] = []
    rows, texts = {}, {}
    now = store.clock()
    for station, peer in ways.items():
        known = store.stations[station]
        spectrum, line, settings = known.spectra.get(peer), known.lines.get(peer), known.settings.get(peer)
        data, lines, areas = np.empty((0, 2)), [], []
        if spectrum is not None:
            frequencies = spectrum.start_frequency + spectrum.frequency_step * np.arange(len(spectrum.magnitude))
            magnitude = np.maximum(spectrum.magnitude, _FLOOR)
            data = np.column_stack([np.round(frequencies * 1e-3, 2), np.round(magnitude, 1)])
            texts[f'{station}.waterfall.end'] = f'{number(frequencies[-1], 0, language, 1e-3)} kHz'
            if not known.spectra_seen[peer].is_stale(now):
                levels = (decimated(magnitude, _WATERFALL)[0] - _DARK) / (_BRIGHT - _DARK)
                rows[f'{station}.waterfall'] = np.clip(levels * 255.0, 0, 255).astype(np.uint8)
        if line is not None and math.isfinite(line.frequency):
            lines = [{'xAxis': round(line.frequency * 1e-3, 3)}]
        if settings is not None and not series:
            bands = guard_bands(settings)
            areas = [[{'xAxis': low * 1e-3}, {'xAxis': high * 1e-3}] for low, high in bands]
        curve, mark = (
            {'opacity': _FADED if seen.get(peer, Arrivals()).is_stale(now) else 1.0}
            for seen in (known.spectra_seen, known.lines_seen)
        )
        marked = {'data': lines, 'lineStyle': mark}
        series.append({'data': data, 'lineStyle': curve, 'markLine': marked, 'markArea': {'data': areas}})
    half = [k.sample_rate / 2e3 for name, p in ways.items() if (k := store.stations[name].settings.get(p))]
    axis = {'max': max(half)} if half else {}
    return {'chart': {'spectra': {'series': series, 'xAxis': axis}}, 'waterfall': rows, 'text': texts}


def _fresh(seen: Arrivals, now: float, language: str) -> str:
    """Return whether what arrived last is current, in words."""
    key = 'signals.stale' if seen.is_stale(now) else 'now.fresh'
    return phrase(key, language).format(age=span(seen.age(now), language))


def _powers(store: Store, pair: str, station: str, peer: str, language: str) -> list[Any]:
    """Return one row of the table: what a station receives and what free space lets it receive."""
    line = store.stations[station].lines.get(peer)
    own, other = store.stations[station].settings.get(peer), store.stations[peer].settings.get(station)
    newest = store.pairs[pair].newest
    if line is None:
        return [station, *[NONE] * 7]
    expected = expected_power(own, other, newest.range) if own and other and newest else math.nan
    doubts = ', '.join(flags.line_flags(line.flags, language))
    seen, now = store.stations[station].lines_seen[peer], store.clock()
    stale = seen.is_stale(now)
    values = [
        f'{number(line.power, 1, language)} dBm',
        f'{number(expected, 1, language)} dBm',
        f'{number(line.power - expected, 1, language, sign=True)} dB',
        f'{number(line.snr, 1, language)} dB',
        f'{number(line.frequency, 3, language, 1e-3)} kHz',
    ]
    state = 'stale' if stale else 'doubtful' if doubts else 'good'
    return [
        station,
        *({'text': value, 'state': 'stale'} if stale else value for value in values),
        {'text': doubts or NONE, 'state': state},
        {'text': _fresh(seen, now, language), 'state': 'stale' if stale else 'good'},
    ]
