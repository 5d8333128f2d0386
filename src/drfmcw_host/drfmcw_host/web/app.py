"""The web application: pages, stream, downloads and the guard around them."""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import fastapi
from fastapi import FastAPI, Request, WebSocket
from fastapi.responses import FileResponse, PlainTextResponse, Response, StreamingResponse
from nicegui import core, ui
from starlette.staticfiles import StaticFiles

from drfmcw_physics.settings import ConfigurationError

from ..access.guard import REPORT_POLICY, Application, Guard
from ..files.work import PLOT, REPORT
from ..state.store import Store
from .frame import STATIC, VIEWS, Host, frame, path_of, viewer_of
from .live import Live, layout
from .login import routes
from .views import calibration, configuration, diagnosis, now, over_time, recordings, signals, stations

_BUILDERS = {
    'now': now.build,
    'over-time': over_time.build,
    'signals': signals.build,
    'stations': stations.build,
    'diagnosis': diagnosis.build,
    'configuration': configuration.build,
    'calibration': calibration.build,
    'recordings': recordings.build,
}
_FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="6" fill="#0067a5"/>'
    '<path d="M5 25L16 8l11 17" fill="none" stroke="#fff" stroke-width="4"/></svg>'
)


def fingerprint(folder: Path) -> str:
    """Return a short digest of the files in a folder."""
    digest = hashlib.sha256(b''.join(path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()))
    return digest.hexdigest()[:12]


def application(host: Host, names: Iterable[str]) -> Application:
    """Return the whole application, guarded.

    Args:
        host: what the pages work with.
        names: further host names that the server answers to.
    """
    served = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    served.include_router(routes(host))
    served.include_router(_files(host))
    served.mount('/static', StaticFiles(directory=STATIC))
    live = Live(host.store)

    @served.websocket('/live')
    async def stream(socket: WebSocket) -> None:
        await live.serve(socket)

    for view in VIEWS:
        _add_page(host, view, host.store)
    ui.run_with(
        served,
        title='drfmcw',
        favicon=_FAVICON,
        dark=None,
        tailwind=False,
        binding_refresh_interval=None,
        message_history_length=0,
        reconnect_timeout=5.0,
        show_welcome_message=False,
    )
    core.sio.eio.cors_allowed_origins = []  # no check: the guard makes it, and Engine.IO takes TLS for another origin
    return Guard(served, names, host.secure)


def _add_page(host: Host, view: str, store: Store) -> None:
    @ui.page(path_of(view))
    def page(request: Request) -> None:
        viewer = viewer_of(host, request, view)
        ui.dark_mode(viewer.theme == 'dark')
        with store.lock:
            shown = layout(store)
            with frame(viewer, shown):
                _BUILDERS[view](viewer)


def _refused(error: ConfigurationError) -> Response:
    return PlainTextResponse(f'{error}\n', 404)


def _files(host: Host) -> fastapi.APIRouter:
    """Return the routes of downloads, reports and results."""
    router = fastapi.APIRouter()
    framed = {'content-security-policy': REPORT_POLICY}

    @router.get('/recordings/{name}.tar')
    def download(name: str, request: Request) -> Response:
        viewer = viewer_of(host, request, 'recordings')
        if not viewer.may_change:
            viewer.record('refused', what=f'download {name[:100]}')
            return PlainTextResponse(f'{viewer.say("login.needed")}\n', 403)
        try:
            archive = host.recordings.archive(name)
        except ConfigurationError as error:
            return _refused(error)
        viewer.record('download', recording=name)
        disposition: dict[str, Any] = {'content-disposition': f'attachment; filename="{name}.tar"'}
        return StreamingResponse(archive, media_type='application/x-tar', headers=disposition)

    @router.get('/findings/{name}/report.html')
    def finding(name: str) -> Response:
        try:
            return FileResponse(host.findings.report(name), media_type='text/html', headers=framed)
        except ConfigurationError as error:
            return _refused(error)

    @router.get('/results/{name}/{file}')
    def result(name: str, file: str) -> Response:
        kinds = {PLOT: 'image/png', REPORT: 'text/html'}
        try:
            path = host.recordings.results(name) / file
        except ConfigurationError as error:
            return _refused(error)
        if file not in kinds or not path.is_file() or path.is_symlink():
            return PlainTextResponse('no such result\n', 404)
        return FileResponse(path, media_type=kinds[file], headers=framed)

    return router
