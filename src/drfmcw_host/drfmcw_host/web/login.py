"""Log in and out, and preferences: plain HTTP, no script needed."""

import asyncio
import html
from urllib.parse import parse_qs, urlencode

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response

from ..access.sessions import LIFETIME
from ..words.phrases import LANGUAGES, phrase
from .frame import COOKIE, LANGUAGE, THEME, VIEWS, Host, path_of, viewer_of

_YEAR = 365 * 86_400
_LONGEST = 10_000  # of the form [bytes]


def routes(host: Host) -> APIRouter:
    """Return the routes /login, /logout and /preference."""
    router = APIRouter()
    one_at_a_time = asyncio.Lock()  # so that attempts in parallel do not outrun the count of failures

    @router.get('/login')
    def form(request: Request) -> Response:
        return _form(host, request, '')

    @router.post('/login')
    async def login(request: Request) -> Response:
        async with one_at_a_time:
            return await _login(host, request)

    @router.post('/logout')
    def logout(request: Request) -> Response:
        session = host.sessions.of(request.cookies.get(COOKIE))
        if session is not None:
            host.sessions.end(session)
            host.audit.write(session.user, _address(request), 'logout')
        answer = RedirectResponse('/', 303)
        answer.delete_cookie(COOKIE, httponly=True, samesite='strict', secure=host.secure)
        return answer

    @router.get('/preference')
    def preference(request: Request) -> Response:
        query = request.query_params
        answer = RedirectResponse(_back(query.get('back', '')), 303)
        if query.get('language') in LANGUAGES:
            answer.set_cookie(LANGUAGE, query['language'], _YEAR, samesite='strict', secure=host.secure)
        if query.get('theme') in ('light', 'dark'):
            answer.set_cookie(THEME, query['theme'], _YEAR, samesite='strict', secure=host.secure)
        return answer

    return router


async def _login(host: Host, request: Request) -> Response:
    """Check user and password; slow down who guesses."""
    if host.read_only:
        return _form(host, request, '')
    fields = parse_qs((await request.body())[:_LONGEST].decode('utf-8', 'replace'))
    user, password = fields.get('user', [''])[0], fields.get('password', [''])[0]
    address = _address(request)
    keys = (f'address {address}', f'user {user[:40]}')
    wait = host.attempts.wait(*keys)
    if wait:
        host.audit.write(user[:40], address, 'login delayed', seconds=wait)
        return _form(host, request, 'login.wait', 429, seconds=wait)
    if not await asyncio.to_thread(host.passwords.verify, user, password):
        host.attempts.failed(*keys)
        host.audit.write(user[:40], address, 'login failed')
        return _form(host, request, 'login.wrong', 401)
    host.attempts.succeeded(*keys)
    host.audit.write(user, address, 'login')
    answer = RedirectResponse(_back(fields.get('back', [''])[0]), 303)
    cookie = host.sessions.begin(user)
    answer.set_cookie(COOKIE, cookie, LIFETIME, httponly=True, samesite='strict', secure=host.secure)
    return answer


def _address(request: Request) -> str:
    return request.client.host if request.client else ''


def _back(path: str) -> str:
    """Return a path of this host to go back to; what is none leads to the first view."""
    return path if path in {path_of(view) for view in VIEWS} else '/'


def _form(host: Host, request: Request, problem: str, status: int = 200, **values: object) -> Response:
    viewer = viewer_of(host, request, VIEWS[0])
    back = _back(request.query_params.get('back', ''))

    def say(key: str) -> str:
        return html.escape(phrase(key, viewer.language))

    message = html.escape(phrase(problem, viewer.language).format(**values)) if problem else ''
    if host.read_only:
        content = f'<p>{say("login.forced")}</p>'
    elif not host.passwords.users():
        content = f'<p>{say("login.off")}</p>'
    else:
        content = (
            f'<form method="post" action="/login?{html.escape(urlencode({"back": back}))}">'
            f'<input type="hidden" name="back" value="{html.escape(back)}">'
            f'<label>{say("login.user")}<input name="user" autocomplete="username" required autofocus></label>'
            f'<label>{say("login.password")}'
            '<input name="password" type="password" autocomplete="current-password" required></label>'
            f'<p role="alert" class="problem">{message}</p>'
            f'<button type="submit">{say("frame.login")}</button></form>'
        )
    page = (
        f'<!doctype html><html lang="{viewer.language}"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{say("frame.login")}</title><link rel="stylesheet" href="/static/host.css?{host.asset}"></head>'
        f'<body><div class="page login {viewer.theme}"><main class="content card">'
        f'<h1>{say("frame.login")}</h1>{content}'
        f'<p><a href="{html.escape(back)}">{say("login.back")}</a></p></main></div></body></html>'
    )
    return HTMLResponse(page, status)
