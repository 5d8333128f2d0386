"""View "Recordings": start, stop, list, download, recompute, diagnose, delete; disk space."""

import datetime
import time
from collections.abc import Callable
from typing import Any

from nicegui import ui

from drfmcw_physics.settings import ConfigurationError

from ...files.recordings import Recording
from ...files.work import PLOT, REPORT, Job
from ...state.store import Store
from ...words.numbers import size, span
from ..frame import Viewer, section, set_text, text
from .diagnosis import show_in_place

_REFRESH = 1.0  # of the list [s]


class RecordingsView:
    """One browser's view; it is built again when what it shows has changed."""

    def __init__(self, viewer: Viewer) -> None:
        """Add the view."""
        self._viewer = viewer
        self._shown: list[Recording] | None = None
        self._shown_jobs: list[tuple[Job, bool]] | None = None
        self._said: list[tuple[Job, ui.element]] = []  # texts that say how far each job is
        say = viewer.say
        if not viewer.may_change:
            text('p', say('login.needed'), 'note')
        with ui.element('section').classes('card'):
            with ui.element('div').classes('line'):
                self._status = text('strong', '', 'recorder')
                if viewer.may_change:
                    proposed = time.strftime('%Y%m%dT%H%M%S')
                    self._name = ui.input(say('rec.name'), value=proposed).props('dense outlined')
                    ui.button(say('rec.start'), on_click=self._start).props('no-caps')
                    ui.button(say('rec.stop'), on_click=self._stop).props('no-caps outline')
            self._disk = text('p', '', 'quiet')
            text('p', f'{say("rec.directory")}: {viewer.host.recordings.directory}', 'quiet')
        with section(say('view.recordings')):
            self._list = ui.element('div')
        with section(say('rec.jobs')):
            self._jobs = ui.element('div')
        self._refresh()
        ui.timer(_REFRESH, self._refresh)

    def _refresh(self) -> None:
        host, say, language = self._viewer.host, self._viewer.say, self._viewer.language
        running = host.work.recording
        status = say('rec.idle')
        if running is not None:
            status = say('rec.running', name=running.name, size=size(host.recordings.size(running.name), language))
        set_text(self._status, status)
        free, total = host.recordings.disk()
        set_text(self._disk, say('rec.disk', free=size(free, language), total=size(total, language)))
        recordings = [r for r in host.recordings.list() if running is None or r.name != running.name]
        if recordings != self._shown:  # else what is open in the list stays open
            self._shown = recordings
            self._show_list(recordings)
        jobs = [(job, job.running) for job in reversed(host.work.jobs)]
        if jobs != self._shown_jobs:
            self._shown_jobs = jobs
            self._show_jobs([job for job, _ in jobs])
        for job, element in self._said:
            set_text(element, self._progress(job))

    def _show_list(self, recordings: list[Recording]) -> None:
        say = self._viewer.say
        self._list.clear()
        with self._list:
            if not recordings:
                text('p', say('rec.none'), 'empty')
            for recording in recordings:
                self._recording(recording)

    def _recording(self, recording: Recording) -> None:
        say, work = self._viewer.say, self._viewer.host.work
        with ui.element('article').classes('recording') as entry:
            entry.props['data-recording'] = recording.name
            with ui.element('div').classes('line'):
                text('strong', recording.name)
                when = datetime.datetime.fromtimestamp(recording.begun).isoformat(' ', 'seconds')
                text('span', f'{when} · {size(recording.size, self._viewer.language)}', 'quiet')
                if self._viewer.may_change:
                    download = ui.element('a').classes('button')
                    download.props['href'] = f'/recordings/{recording.name}.tar'
                    download.props['textContent'] = say('rec.download')
                    self._button('rec.replay', recording.name, work.replay)
                    self._button('rec.diagnose', recording.name, work.diagnose)
                    ui.button(say('rec.delete'), on_click=self._asking(recording.name)).props(
                        'no-caps dense outline color=negative'
                    )
            if PLOT in recording.results:
                show_in_place(self._viewer, f'{say("rec.result")}: {say("rec.replay")}', _result(recording, PLOT))
            if REPORT in recording.results:
                show_in_place(self._viewer, f'{say("rec.result")}: {say("rec.diagnose")}', _result(recording, REPORT))

    def _button(self, key: str, name: str, work: Callable[[str], None]) -> None:
        def start() -> None:
            self._do(key.removeprefix('rec.'), name, lambda: work(name))

        ui.button(self._viewer.say(key), on_click=start).props('no-caps dense outline')

    def _do(self, action: str, name: str, work: Callable[[], object]) -> None:
        """Do something with a recording if the viewer may; say why where it fails."""
        viewer = self._viewer
        if not viewer.allowed(f'{action} {name[:100]}'):
            return
        try:
            work()
        except ConfigurationError as error:
            viewer.record(action, recording=name, refused=str(error))
            ui.notify(str(error), type='negative')
            return
        viewer.record(action, recording=name)
        self._refresh()

    def _start(self) -> None:
        name = str(self._name.value)
        self._do('record', name, lambda: self._viewer.host.work.record(name))

    def _stop(self) -> None:
        running = self._viewer.host.work.recording
        if running is not None:
            self._do('stop recording', running.name, self._viewer.host.work.stop_recording)
            self._name.value = time.strftime('%Y%m%dT%H%M%S')

    def _asking(self, name: str) -> Callable[[], None]:
        def ask() -> None:
            with ui.dialog(value=True) as dialog, ui.card():
                text('p', self._viewer.say('rec.sure', name=name))
                with ui.element('div').classes('line'):
                    ui.button(self._viewer.say('rec.cancel'), on_click=dialog.close).props('no-caps autofocus')
                    ui.button(self._viewer.say('rec.delete'), on_click=lambda: delete(dialog)).props(
                        'no-caps outline color=negative'
                    )

        def delete(dialog: ui.dialog) -> None:
            dialog.close()
            self._do('delete', name, lambda: self._delete(name))

        return ask

    def _delete(self, name: str) -> None:
        self._viewer.host.work.check_idle(name)
        self._viewer.host.recordings.delete(name)

    def _show_jobs(self, jobs: list[Job]) -> None:
        say = self._viewer.say
        self._jobs.clear()
        self._said.clear()
        with self._jobs:
            if not jobs:
                text('p', say('rec.no-jobs'), 'empty')
            for job in jobs:
                with ui.element('div').classes('line'):
                    self._said.append((job, text('span', self._progress(job))))
                    if job.running and self._viewer.may_change:
                        ui.button(say('rec.cancelled'), on_click=self._cancelling(job)).props('no-caps dense flat')

    def _cancelling(self, job: Job) -> Callable[[], None]:
        return lambda: self._do('cancel', job.name, lambda: self._viewer.host.work.cancel(job))

    def _progress(self, job: Job) -> str:
        """Return what a job does, and for how long it has run or how it ended."""
        say = self._viewer.say
        if job.running:
            state = say('rec.job.running', age=span(time.time() - job.begun, self._viewer.language))
        elif job.reason:
            state = say('rec.job.failed', reason=job.reason)
        else:
            state = say('rec.job.done')
        return f'{say(f"rec.job.{job.kind}", name=job.name)}: {state}'


def _result(recording: Recording, file: str) -> str:
    return f'/results/{recording.name}/{file}'


def build(viewer: Viewer) -> None:
    """Add the view."""
    RecordingsView(viewer)


def update(store: Store, options: Any, whole: bool) -> dict[str, Any]:
    """Return nothing: this view is built again by itself when its directory changes."""
    return {}
