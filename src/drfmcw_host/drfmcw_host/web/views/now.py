"""View "Now": the distance, readable from two metres away, whether it may be used, and where the crane stands."""

import math
import time
from typing import Any

import numpy as np
from nicegui import ui

from drfmcw_fusion.settings import FusionSettings

from ...state.store import Pair, Store
from ...words import flags
from ...words.numbers import NONE, distance, general, number, span
from ...words.phrases import phrase
from ..frame import Viewer, field, link, text
from . import crane

_VALUES = ('std', 'velocity', 'protection', 'mode', 'rate', 'error')
_WEATHER = (
    ('/site/temperature', 1.0, 1, '°C'),
    ('/site/pressure', 0.01, 1, 'hPa'),
    ('/site/humidity', 100.0, 0, '%'),
)
"""Topic, factor, decimals and unit of what is shown."""

_HERO = ('hero', 'hero.fresh', 'hero.quality', 'rail')  # elements that have the state of the pair that is shown large
_RAIL_TIME = 600  # of ranges that the rail has to show [s]


def build(viewer: Viewer) -> None:
    """Add the view."""
    say, store = viewer.say, viewer.host.store
    names = sorted(store.pairs)
    if not names:
        text('p', say('now.none'), 'empty')
        return
    name = viewer.pair
    with ui.element('section').classes('card hero') as hero:
        hero.props['data-field'] = 'hero'
        with ui.element('div').classes('line'):
            text('h2', name.replace('/', ' → '))
            field('span', 'hero.fresh', 'chip')
        with ui.element('div').classes('distance').props('aria-live=off'):
            field('span', 'hero.range', 'big', NONE)
            text('span', 'm', 'unit')
        with ui.element('div').classes('verdict').props('role=status'):
            field('strong', 'hero.quality', 'quality')
            field('span', 'hero.words', 'words')
        with ui.element('dl').classes('values'):
            for value in _VALUES:
                with ui.element('div'):
                    text('dt', say(f'now.{value}'))
                    field('dd', f'hero.{value}', '', NONE)
    with ui.element('section').classes('card') as rail:
        rail.props['data-field'] = 'rail'
        field('h2', 'rail.title')
        ui.html(crane.picture(), sanitize=False)  # no text from outside in it
        field('p', 'weather', 'weather')
    text('h2', say('now.pairs'), 'cards-title')
    with ui.element('div').classes('cards'):
        for other in names:
            _card(viewer, other)


def _card(viewer: Viewer, name: str) -> None:
    with ui.element('article').classes('card pair') as card:
        card.props['data-field'] = f'{name}.card'
        with ui.element('div').classes('line'):
            link(name.replace('/', ' → '), f'/?pair={name}', 'name')
            field('span', f'{name}.fresh', 'chip')
        with ui.element('div').classes('distance'):
            field('span', f'{name}.range', 'middle', NONE)
            text('span', 'm', 'unit')
        field('p', f'{name}.line')
        field('p', f'{name}.words', 'words')


def update(store: Store, options: Any, whole: bool) -> dict[str, Any]:
    """Return the texts and states of this view."""
    names = sorted(store.pairs)
    texts: dict[str, str] = {}
    states: dict[str, str] = {}
    for name in names:
        values = described(store, store.pairs[name], options.language)
        texts |= {f'{name}.{key}': values[key] for key in ('range', 'fresh')}
        texts[f'{name}.line'] = f'± {values["std"]} · {values["velocity"]} · {values["rate"]}'
        texts[f'{name}.words'] = f'{values["quality"]}: {values["words"]}'
        states |= dict.fromkeys(_grey(name), values['state'])
    if not names:
        return {}
    chosen = store.chosen(options.pair)
    pair = store.pairs[chosen]
    values = described(store, pair, options.language)
    state = values.pop('state')
    texts |= {f'hero.{key}': content for key, content in values.items()}
    texts['weather'], states['weather'] = weather(store, options.language)
    states |= dict.fromkeys(_HERO, state)
    attributes, marks = _rail(pair, options.language)
    number_of_sweep = str(pair.newest.sweep_id) if pair.newest else ''
    attributes['hero.range'] = {'data-sweep': number_of_sweep}
    expiring = [_expiry(store, name, name == chosen, options.language) for name in names]
    return {
        'text': texts | marks,
        'state': states,
        'attributes': attributes,
        'expire': [expiry for expiry in expiring if expiry is not None],
    }


def _grey(name: str) -> tuple[str, ...]:
    """Return the elements of a pair's card that have its state."""
    return f'{name}.card', f'{name}.fresh'


def _expiry(store: Store, name: str, chosen: bool, language: str) -> dict[str, Any] | None:
    """Return when a pair's range becomes stale [s], and what a browser then shows that has heard nothing since."""
    pair = store.pairs[name]
    if pair.newest is None or store.is_stale(pair):
        return None
    says = phrase('now.stale', language).format(age=span(pair.seen.limit, language))
    texts, states = {f'{name}.fresh': says}, dict.fromkeys(_grey(name), 'stale')
    if chosen:
        texts['hero.fresh'] = says
        states |= dict.fromkeys(_HERO, 'stale')
    return {'after': pair.seen.limit - store.age(pair), 'text': texts, 'state': states}


def described(store: Store, pair: Pair, language: str) -> dict[str, str]:
    """Return a pair's texts by name, and 'state': good, doubtful, unusable or stale."""
    newest, age = pair.newest, store.age(pair)
    if newest is None:
        none = dict.fromkeys((*_VALUES, 'range', 'quality', 'words'), NONE)
        return none | {'fresh': phrase('now.waiting', language), 'state': 'stale'}
    stale = store.is_stale(pair)
    words = '; '.join(flags.range_flags(newest.flags, language)) or phrase('now.no-doubt', language)
    if newest.failed_tests:
        tests = ', '.join(flags.failed_tests(newest.failed_tests, language))
        words += '. ' + phrase('now.failed', language).format(tests=tests)
    quality = flags.quality(newest.flags)
    key = 'now.stale' if stale else 'now.fresh'
    fresh = phrase(key, language).format(age=span(age, language))
    return {
        'range': distance(newest.range, language),
        'std': f'{number(newest.range_std, 2, language, 1e3)} mm',
        'velocity': _finite(newest.velocity, 3, 'm/s', language),
        'protection': _protection(newest.protection_level, language),
        'mode': flags.mode(newest.mode, language),
        'rate': f'{number(pair.rate(store.clock()), 0, language)} {phrase("unit.per-second", language)}',
        'error': _finite(pair.error, 2, 'mm', language, 1e3),
        'quality': phrase(f'now.quality.{quality}', language),
        'words': words,
        'fresh': fresh,
        'state': 'stale' if stale else quality,
    }


def _finite(value: float, digits: int, unit: str, language: str, scale: float = 1.0) -> str:
    """Return a signed value with its unit, '–' where it is not known."""
    return f'{number(value, digits, language, scale, sign=True)} {unit}' if math.isfinite(value) else NONE


def _protection(level: float, language: str) -> str:
    if math.isinf(level):
        return phrase('now.refused', language)
    return f'{number(level, 1, language, 1e3)} mm' if math.isfinite(level) else NONE


def _rail(pair: Pair, language: str) -> tuple[dict[str, dict[str, str]], dict[str, str]]:
    """Return (attributes of the crane's parts, texts of the scale)."""
    newest = pair.newest.range if pair.newest else math.nan
    seen = pair.histories['range'].curve(_RAIL_TIME, time.time_ns()).high
    length = crane.rail_length(float(np.max(seen)) if len(seen) else newest)
    x = crane.position(newest, length)
    texts = {f'tick.{i}': f'{general(length * i / crane.TICKS, 6, language)} m' for i in range(crane.TICKS + 1)}
    texts['rail.title'] = phrase('now.rail', language).format(length=general(length, 6, language))
    moved = {
        'crane': {'transform': f'translate({x:.1f} 0)'},
        'beam': {'d': f'M{crane.LEFT} 64H{max(x - 8, crane.LEFT):.1f}'},
    }
    return moved, texts


def weather(store: Store, language: str) -> tuple[str, str]:
    """Return temperature, pressure and humidity with their ages in one line, and 'stale' or 'good'."""
    values, ages = [], []
    for topic, scale, digits, unit in _WEATHER:
        reading = store.site.get(topic)
        if reading is None:
            values.append(NONE)
            continue
        ages.append(store.weather_age(topic))
        value = f'{number(reading.value, digits, language, scale)} {unit}'
        age = span(ages[-1], language) if ages[-1] >= 10.0 else f'{max(ages[-1], 0.0):.0f} s'
        values.append(phrase('now.ago', language).format(value=value, age=age))
    stale = max(ages, default=0.0) > FusionSettings().environment_time_limit
    title = phrase('now.weather.stale' if stale else 'now.weather', language)
    return f'{title}: {" · ".join(values)}', 'stale' if stale else 'good'
