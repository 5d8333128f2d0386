"""The stream of changed values: encoded once per view and its options, sent to every browser that shows it."""

import asyncio
import collections
import dataclasses
import math
from collections.abc import Callable
from typing import Any

import orjson
from starlette.websockets import WebSocket, WebSocketDisconnect

from ..state.history import WINDOWS
from ..state.readings import LOG_LEVELS
from ..state.store import Store
from ..words.phrases import LANGUAGES
from .frame import span_in
from .views import diagnosis, now, over_time, recordings, signals, stations

INTERVAL = 1.0 / 30.0
"""Between two messages to a browser that shows "Now" [s]."""

_QUIET = 0.1  # the same of the other views, whose charts and tables change less often [s]

_LIMIT, _OF_ONE = 100, 50  # browsers at a time: all together, and of one address
_SEND_LIMIT = 10.0  # after which a browser that takes nothing is given up [s]
_NOTHING: Callable[[Store, 'Options', bool], dict[str, Any]] = lambda store, options, charts: {}  # noqa: E731


@dataclasses.dataclass(frozen=True)
class Options:
    """What a browser shows."""

    view: str
    language: str = 'en'
    pair: str = ''  # empty: the first one
    span: int = WINDOWS[1]  # [s]
    level: int = LOG_LEVELS[0]  # of log lines, from which on they are shown

    @classmethod
    def of(cls, query: Any) -> 'Options':
        """Return the options in a query; what is not known gets its default."""
        language = query.get('language', '')
        level = next((level for level in LOG_LEVELS if str(level) == query.get('level')), LOG_LEVELS[0])
        pair = query.get('pair', '')[:200]
        language = language if language in LANGUAGES else 'en'
        return cls(query.get('view', ''), language, pair, span_in(query), level)


UPDATES: dict[str, tuple[Callable[[Store, Any, bool], dict[str, Any]], Callable[[Options], float]]] = {
    'now': (now.update, lambda _: INTERVAL),
    'over-time': (over_time.update, lambda options: min(max(options.span / 100, 0.2), 5.0)),
    'signals': (signals.update, lambda _: 0.2),
    'stations': (stations.update, lambda _: 0.5),
    'diagnosis': (diagnosis.update, lambda _: 0.5),
    'recordings': (recordings.update, lambda _: 0.5),
}
"""View: (function that returns what changed, interval of its charts and tables [s])."""


def pace_of(options: Options) -> float:
    """Return the time between two messages to a browser that shows a view [s]."""
    return INTERVAL if options.view == 'now' else _QUIET


class Live:
    """Encodes messages, each once per tick, and sends them."""

    def __init__(self, store: Store) -> None:
        """Show what is in the store."""
        self._store = store
        self._messages: dict[tuple[Options, bool], tuple[int, bytes, float]] = {}
        self._browsers = collections.Counter[str]()  # by address

    def message(self, options: Options, whole: bool) -> bytes:
        """Return the message of this tick; `whole` one holds charts and tables whatever their interval."""
        now, pace = self._store.clock(), pace_of(options)
        tick = math.floor(now / pace)
        key = (options, whole)
        known = self._messages.get(key)
        if known is not None and known[0] == tick:
            return known[1]
        update, interval = UPDATES.get(options.view, (_NOTHING, lambda _: 1.0))
        every = max(1, round(interval(options) / pace))
        with self._store.lock:
            content = update(self._store, options, whole or tick % every == 0)
            content['layout'] = layout(self._store)
        encoded = orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY)
        current = {k: m for k, m in self._messages.items() if now - m[2] < _QUIET}
        self._messages = current | {key: (tick, encoded, now)}
        return encoded

    async def serve(self, socket: WebSocket) -> None:
        """Send messages to one browser until it leaves; one that is slow gets the newest, not all."""
        address = socket.client.host if socket.client else ''
        if self._browsers.total() >= _LIMIT or self._browsers[address] >= _OF_ONE:
            await socket.close(1013)
            return
        await socket.accept()
        self._browsers[address] += 1
        options, whole = Options.of(socket.query_params), True
        pace = pace_of(options)
        listening = asyncio.ensure_future(socket.receive())
        try:
            while not listening.done():
                text = self.message(options, whole).decode()
                await asyncio.wait_for(socket.send_text(text), _SEND_LIMIT)
                whole = False
                await asyncio.wait({listening}, timeout=pace - self._store.clock() % pace + 0.001)
        except (WebSocketDisconnect, TimeoutError, RuntimeError):
            pass
        finally:
            self._browsers -= collections.Counter({address: 1})  # without those that have none left
            listening.cancel()


def layout(store: Store) -> str:
    """Return what decides which elements a page has: the names of pairs and stations."""
    return ' '.join([*sorted(store.pairs), '|', *sorted(store.stations)])
