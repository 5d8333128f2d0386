"""The project's own commands as processes: recording, recomputing and diagnosing."""

import dataclasses
import os
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.work import children

from .recordings import Recordings, checked_name

RECORD, REPLAY, DIAGNOSE = 'drfmcw_ros.bag.record', 'drfmcw_fusion.replay', 'drfmcw_diagnosis.diagnose'
"""Modules that run as processes."""

PLOT, REPORT = 'ranges.png', 'report.html'
"""Results of recomputing and of diagnosing that the page shows."""

_AT_ONCE = 2  # jobs beside the recorder
_KEPT = 10  # jobs that have ended
_STOP_LIMIT = 20.0  # [s]


@dataclasses.dataclass
class Job:
    """One process that works on one recording."""

    kind: str  # 'record', 'replay' or 'diagnose'
    name: str  # of the recording
    process: subprocess.Popen[bytes]
    log: Path
    begun: float  # wall clock [s]
    asked_to_end: float | None = None  # monotonic [s]

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self.process.poll() is None

    @property
    def reason(self) -> str:
        """Why it failed, in its own words; '' where it runs or has done its work."""
        if self.running or self.process.returncode == 0:
            return ''
        lines = self.log.read_text(encoding='utf-8', errors='replace').strip().splitlines() if self.log.exists() else []
        return lines[-1][:300] if lines else f'status {self.process.returncode}'


class Work:
    """Starts and stops the jobs of one directory of recordings."""

    def __init__(self, recordings: Recordings) -> None:
        """Start with nothing running."""
        self._recordings = recordings
        self.recorder: Job | None = None
        self.jobs: list[Job] = []

    @property
    def recording(self) -> Job | None:
        """The recorder while it runs."""
        return self.recorder if self.recorder is not None and self.recorder.running else None

    def record(self, name: str) -> None:
        """Start recording.

        Raises:
            ConfigurationError: a recording is running, or the name is not acceptable.
        """
        if self.recording is not None:
            raise ConfigurationError(f"'{self.recording.name}' is being recorded")
        path = self._recordings.new_path(name)
        self.recorder = self._start('record', name, [RECORD, str(path)], 0)

    def stop_recording(self) -> str:
        """Ask the recorder to end in order; return the recording's name, '' where none was running."""
        job = self.recording
        if job is None:
            return ''
        self.cancel(job)
        return job.name

    def replay(self, name: str) -> None:
        """Recompute a recording's ranges.

        Raises:
            ConfigurationError: there is none of that name, it is busy, or too much runs already.
        """
        path, results = self._prepare(name)
        self.jobs.append(self._start('replay', name, [REPLAY, str(path), '--plot', str(results / PLOT)]))

    def diagnose(self, name: str) -> None:
        """Search for what the model of a recording lacks; raises as `replay`."""
        path, results = self._prepare(name)
        self.jobs.append(self._start('diagnose', name, [DIAGNOSE, str(path), '--out', str(results), '--jobs', '1']))

    def _prepare(self, name: str) -> tuple[Path, Path]:
        path = self._recordings.path(name)
        self.check_idle(name)
        if sum(job.running for job in self.jobs) >= _AT_ONCE:
            raise ConfigurationError(f'{_AT_ONCE} jobs are running; wait for one to end')
        results = self._recordings.results(name)
        results.mkdir(parents=True, exist_ok=True)
        ended = [job for job in self.jobs if not job.running]
        self.jobs = [job for job in self.jobs if job.running or job in ended[-_KEPT:]]
        return path, results

    def check_idle(self, name: str) -> None:
        """Refuse a recording that something works on.

        Raises:
            ConfigurationError: something does.
        """
        busy = [job for job in (self.recording, *self.jobs) if job is not None and job.running and job.name == name]
        if busy:
            raise ConfigurationError(f"'{name}' is in use")

    def cancel(self, job: Job) -> None:
        """Ask a job to end; one that has been asked for 20 s is killed."""
        now = time.monotonic()
        if job.asked_to_end is not None and now - job.asked_to_end > _STOP_LIMIT:
            job.process.kill()
        elif job.running:
            job.asked_to_end = job.asked_to_end or now
            job.process.send_signal(signal.SIGINT)

    def _start(self, kind: str, name: str, command: Sequence[str], niceness: int = 5) -> Job:
        results = self._recordings.results(checked_name(name))
        results.mkdir(parents=True, exist_ok=True)
        log = results / f'{kind}.log'
        with log.open('wb') as output:
            process = subprocess.Popen(
                children.command(*command),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=lambda: _prepare(niceness),
            )
        return Job(kind, name, process, log, time.time())

    def close(self) -> None:
        """Stop everything; what does not end within 20 s is killed."""
        running = [job for job in (self.recording, *self.jobs) if job is not None and job.running]
        for job in running:
            job.process.send_signal(signal.SIGINT)
        end = time.monotonic() + _STOP_LIMIT
        for job in running:
            try:
                job.process.wait(max(0.1, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                job.process.kill()
                job.process.wait()


def _prepare(niceness: int) -> None:
    """In the new process: give way to the graph, and end with the host."""
    os.nice(niceness)
    children.prepare()
