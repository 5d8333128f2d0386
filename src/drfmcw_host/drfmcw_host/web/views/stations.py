"""View "Stations": health, clocks, calibration and settings of each station, diagnostics of all nodes, version."""

import math
import time
from typing import Any

from nicegui import ui

from drfmcw_physics.oscillators import Calibration

from ...configure.comparison import effects
from ...state.store import Station, Store
from ...words import flags
from ...words.numbers import NONE, clock, deviation, general, number, plus_minus, span
from ...words.phrases import phrase
from ..frame import Viewer, field, section, table, text
from . import logs

_HEALTH = ('seen', 'temperature', 'pll', 'loss', 'link', 'clock', 'software')
_CALIBRATION = ('calibrated', 'alpha', 'adc', 'delay', 'at', 'floor', 'phase', 'uncertainty')
_LONG = ('software', 'uncertainty')  # texts rather than numbers
_STALE = 3.0  # of a status, which comes about once a second [s]


def build(viewer: Viewer) -> None:
    """Add the view."""
    say, store = viewer.say, viewer.host.store
    if not store.stations:
        text('p', say('stations.none'), 'empty')
    with ui.element('div').classes('grid'):
        for name in sorted(store.stations):
            with section(name) as card:
                card.props['data-field'] = f'{name}.card'
                _values(viewer, name, say('stations.health'), _HEALTH)
                _values(viewer, name, say('stations.calibration'), _CALIBRATION)
                text('h3', say('stations.settings'))
                field('p', f'{name}.settings', '', NONE)
    with section(say('stations.diagnostics')):
        names = ('level', 'name', 'message', 'hardware')
        headings = [say(f'stations.{name}') for name in names]
        table('diagnostics', headings, 'diagnostics', english=(1, 2))
    logs.build(viewer)
    with section(say('stations.version')):
        text('p', viewer.host.version)
        field('p', 'latency')


def _values(viewer: Viewer, name: str, title: str, keys: tuple[str, ...]) -> None:
    text('h3', title)
    with ui.element('dl').classes('values small'):
        for key in keys:
            with ui.element('div').classes('wide' if key in _LONG else ''):
                text('dt', viewer.say(f'stations.{key}'))
                field('dd', f'{name}.{key}', '', NONE)


def update(store: Store, options: Any, whole: bool) -> dict[str, Any]:
    """Return the texts and the table of diagnostics."""
    if not whole:
        return {}
    language = options.language
    texts: dict[str, str] = {}
    states: dict[str, str] = {}
    for name, station in store.stations.items():
        found, state = _health(store, station, language)
        found |= _calibration(store, station, language) | {'settings': _settings(station, language)}
        texts |= {f'{name}.{key}': value for key, value in found.items()}
        states[f'{name}.card'] = state
        texts[f'{name}.software'], states[f'{name}.software'] = _software(store, name, language)
        states[f'{name}.pll'] = 'unusable' if station.health and not station.health.pll_locked else 'good'
    texts['latency'] = f'{phrase("stations.latency", language)}: {_clocks(store.latency, language)}'
    level = {0: 'good', 1: 'doubtful', 2: 'unusable', 3: 'stale'}
    rows = [
        [
            {'text': phrase(f'level.{min(d.level, 3)}', language), 'state': level[min(d.level, 3)]},
            d.name,
            '; '.join([d.message, *(f'{key}: {value}' for key, value in d.values[:8] if d.level)]),
            d.hardware,
        ]
        for d in store.current_diagnostics()
    ]
    logged = logs.update(store, options)
    return {'text': texts | logged['text'], 'state': states, 'rows': {'diagnostics': rows} | logged['rows']}


def _clocks(value: float, language: str) -> str:
    """Return a clock difference; a simulated site counts its own time, which may be far off."""
    if abs(value) < 10.0:
        return f'{number(value, 1, language, 1e3, sign=True)} ms'
    return ('+' if value > 0 else '−') + span(abs(value), language)


def _health(store: Store, station: Station, language: str) -> tuple[dict[str, str], str]:
    health, age = station.health, store.clock() - station.health_received
    if health is None:
        return {}, 'stale'
    found = {
        'seen': span(age, language),
        'temperature': f'{number(health.temperature, 1, language)} °C',
        'pll': phrase('stations.locked' if health.pll_locked else 'stations.unlocked', language),
        'loss': f'{number(health.loss, 2, language, 100.0)} % ({health.dropped} / {health.sweeps})',
        'link': f'{number(health.link_quality, 0, language, 100.0)} %',
        'clock': _clocks(station.clock_difference, language),
    }
    return found, 'stale' if age > _STALE else 'good' if health.pll_locked else 'unusable'


def _software(store: Store, name: str, language: str) -> tuple[str, str]:
    """Return what a station's node runs, and whether it is what the host runs as far as both have the same packages."""
    release, differing = store.software(name)
    if not release:
        return NONE, 'good'
    if not differing:
        return f'{release}, {phrase("stations.software.same", language)}', 'good'
    differs = phrase('stations.software.differs', language).format(names=', '.join(differing))
    return f'{release}, {differs}', 'doubtful'


def _calibration(store: Store, station: Station, language: str) -> dict[str, str]:
    used = station.calibration
    if used is None:
        return {'calibrated': phrase('stations.uncalibrated', language)}
    age = time.time() - station.calibration_stamp * 1e-9 if station.calibration_stamp else math.nan
    return {
        'calibrated': span(age, language),
        'alpha': clock(used.alpha, used.alpha_std, language),
        'adc': clock(used.sample_clock_alpha, used.sample_clock_alpha_std, language),
        'delay': f'{number(used.delay, 3, language, 1e9)} {plus_minus(used.delay_std, 1e9, language)} ns',
        'at': f'{number(used.temperature, 1, language)} °C',
        'uncertainty': _uncertainty(store, used, language),
        'floor': f'{number(used.noise_floor, 1, language)} dBm/Hz',
        'phase': f'{number(used.phase_noise_level, 1, language)} dBc/Hz',
    }


def _uncertainty(store: Store, used: Calibration, language: str) -> str:
    """Return what the calibrations of each pair leave uncertain in its ranges."""
    found: dict[str, list[str]] = {}
    for effect in effects(store, used, used):
        at = f'{deviation(effect.std_after, language)} ({general(effect.distance, 6, language)} m)'
        found.setdefault(effect.pair.replace('/', ' → '), []).append(at)
    return '; '.join(f'{pair}: {", ".join(values)}' for pair, values in found.items()) or NONE


def _settings(station: Station, language: str) -> str:
    """Return one sentence per peer."""

    def value(content: float, scale: float) -> str:
        return general(content, 6, language, scale)

    return '; '.join(
        f'→ {peer}: {flags.mode(s.mode, language)}, '
        f'{value(s.start_frequency, 1e-6)} MHz + {value(s.bandwidth, 1e-6)} MHz '
        f'/ {value(s.ramp_duration, 1e3)} ms, T_off {value(s.start_delay, 1e6)} µs, '
        f'{s.sample_count} / {value(s.sample_rate, 1e-6)} MHz'
        for peer, s in sorted(station.settings.items())
    )
