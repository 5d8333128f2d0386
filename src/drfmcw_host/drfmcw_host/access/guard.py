"""What every request passes first: a limit, known Host, own Origin, security headers. ASGI, HTTP and WebSocket."""

import ipaddress
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from typing import Any
from urllib.parse import urlsplit

from .requests import Requests, cost

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

POLICY = '; '.join(
    (
        "default-src 'none'",
        "script-src 'self' 'unsafe-inline' 'unsafe-eval'",  # NiceGUI's page and Vue's run-time templates need both
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data:",
        "font-src 'self' data:",
        "connect-src 'self'",
        "frame-src 'self'",
        "frame-ancestors 'none'",
        "base-uri 'none'",
        "form-action 'self'",
        "object-src 'none'",
    )
)
"""Content security policy of the pages: nothing from elsewhere, in no foreign frame."""

REPORT_POLICY = "sandbox; default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'self'"
"""Of a report shown in a frame: no script, no request, no form."""

_HEADERS = {
    'x-content-type-options': 'nosniff',
    'referrer-policy': 'same-origin',
    'cross-origin-opener-policy': 'same-origin',
    'cross-origin-resource-policy': 'same-origin',
    'permissions-policy': 'camera=(), microphone=(), geolocation=()',
}
_READING = ('GET', 'HEAD', 'OPTIONS')
_LARGEST_BODY = 1_000_000  # of a request [bytes]


class Guard:
    """Refuses too many requests, those for another host's name, changing ones of another origin; adds the headers."""

    def __init__(
        self, application: Application, names: Iterable[str], secure: bool = False, requests: Requests | None = None
    ) -> None:
        """Wrap an application.

        Args:
            application: what is guarded.
            names: host names that this server answers to, in addition to localhost and addresses of numbers.
            secure: served by TLS.
            requests: limits them by address.
        """
        self._requests = requests or Requests()
        self._application = application
        self._names = {'localhost', *(name.lower() for name in names)}
        self._secure = secure

    def _knows(self, host: str) -> bool:
        """Return whether a Host header names this server: a page of another name cannot rebind its DNS to it."""
        name = urlsplit(f'//{host}').hostname or ''
        if name in self._names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    def _refusal(self, scope: Scope) -> str:
        """Return why a request is refused, '' where it is not."""
        headers = {key.decode('latin-1').lower(): value.decode('latin-1') for key, value in scope['headers']}
        host = headers.get('host', '')
        try:
            known = self._knows(host)
        except ValueError:
            known = False
        if not known:
            return 'unknown host name; start the host with --name NAME to allow one'
        scheme = 'https' if self._secure else 'http'
        origin = headers.get('origin')
        changing = scope['type'] == 'websocket' or scope['method'] not in _READING
        if (origin is None and changing) or (origin is not None and origin.lower() != f'{scheme}://{host}'.lower()):
            return 'the request comes from another page'
        length = headers.get('content-length', '0')
        if not length.isdecimal() or int(length) > _LARGEST_BODY:
            return 'the request is too large'
        return ''

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope['type'] not in ('http', 'websocket'):
            await self._application(scope, receive, send)
            return
        address = (scope.get('client') or ('',))[0]
        seconds = self._requests.wait(address, cost(scope['path']))
        reason = f'too many requests, come again in {seconds} s' if seconds else self._refusal(scope)
        if reason and scope['type'] == 'websocket':
            await send({'type': 'websocket.close', 'code': 1008, 'reason': reason})
            return

        async def guarded(message: Message) -> None:
            if message['type'] == 'http.response.start':
                message['headers'] = [*message.get('headers', []), *self._headers(message)]
            await send(message)

        if reason:
            plain = [(b'content-type', b'text/plain; charset=utf-8')]
            plain += [(b'retry-after', str(seconds).encode())] if seconds else []
            await guarded({'type': 'http.response.start', 'status': 429 if seconds else 403, 'headers': plain})
            await guarded({'type': 'http.response.body', 'body': f'refused: {reason}\n'.encode()})
            return
        await self._application(scope, receive, guarded)

    def _headers(self, message: Message) -> list[tuple[bytes, bytes]]:
        """Return the headers that an answer lacks."""
        present = {key.lower() for key, _ in message.get('headers', [])}
        headers = dict(_HEADERS)
        if b'content-security-policy' not in present:
            headers |= {'content-security-policy': POLICY, 'x-frame-options': 'DENY'}
        if self._secure:
            headers['strict-transport-security'] = 'max-age=31536000'
        return [(k.encode(), v.encode()) for k, v in headers.items() if k.encode() not in present]
