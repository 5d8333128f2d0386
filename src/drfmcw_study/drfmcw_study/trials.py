"""Monte Carlo engine: trials at many points, over processes or a Dask cluster, resumable, equal to the last bit.

Free of ROS, and of what is tried: a task is a callable (point, sweep numbers) -> arrays. Each batch of trials is one
file, written whole or not at all. What is stored depends on the study only; statistics are merged in the order of the
batches. So neither the number of workers nor their order nor an interruption changes a bit.
"""

import contextlib
import dataclasses
import fcntl
import functools
import hashlib
import importlib.util
import io
import json
import logging
import math
import multiprocessing
import platform
import queue
import signal
import time
import traceback
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.cli import write_atomically

Task = Callable[[Mapping[str, Any], range], Mapping[str, np.ndarray]]
"""Makes the trials with given sweep numbers at a point: arrays with one row per trial. Is pickled by its name."""

_MANIFEST = 'manifest.json'
_LOCK = '.lock'
_CONNECT_LIMIT = 15.0  # how long a Dask scheduler may take to answer [s]
_WORKER_LIMIT = 30.0  # how long a Dask cluster may be without any worker [s]
_LOOK_INTERVAL = 1.0  # between two looks at a Dask cluster [s]


class StudyStopped(Exception):
    """The study ended before it was finished; the message is one line that says why. Batches done are kept."""


@dataclasses.dataclass(frozen=True)
class Study:
    """What is to be tried. Everything here, and nothing else, decides the results."""

    points: tuple[Mapping[str, Any], ...]  # JSON-ready, handed to the task
    trials: int  # at each point
    batch: int  # trials stored, merged and sent to a worker together
    packages: tuple[str, ...] = ()  # whose code makes the results: a result of other code is not mixed with this one's

    def __post_init__(self) -> None:
        """Refuse an empty study."""
        for name in ('trials', 'batch'):
            if getattr(self, name) < 1:
                raise ConfigurationError(f'{name} = {getattr(self, name)} must be at least 1')
        if not self.points:
            raise ConfigurationError('no points to try')

    @property
    def total(self) -> int:
        """Trials at all points together."""
        return self.trials * len(self.points)

    def jobs(self, point: int) -> list['Job']:
        """Return the batches of a point, in the order in which they are merged."""
        starts = range(0, self.trials, self.batch)
        return [Job(point, i, range(start, min(start + self.batch, self.trials))) for i, start in enumerate(starts)]


@dataclasses.dataclass(frozen=True)
class Job:
    """One batch."""

    point: int  # index into the study's points
    number: int  # of the batch at its point
    sweeps: range

    def file(self, directory: Path) -> Path:
        """Return where its results are."""
        return directory / f'point_{self.point:05d}' / f'batch_{self.number:07d}.npz'


@dataclasses.dataclass(frozen=True)
class Moments:
    """Number, mean and sum of squared deviations from it, of any number of values; merged without loss of precision.

    T. F. Chan, G. H. Golub, R. J. LeVeque, "Updating formulae and a pairwise algorithm for computing sample
    variances", 1979. Merging rounds, so merged results are equal to the bit only in the same order.
    """

    n: int = 0
    mean: float = 0.0
    squares: float = 0.0

    @classmethod
    def of(cls, values: np.ndarray) -> 'Moments':
        """Return those of an array."""
        if len(values) == 0:
            return cls()
        mean = float(np.mean(values))
        return cls(len(values), mean, float(np.sum((values - mean) ** 2)))

    def merge(self, other: 'Moments') -> 'Moments':
        """Return those of both sets of values together."""
        n = self.n + other.n
        if n == 0:
            return self
        step = other.mean - self.mean
        return Moments(
            n, self.mean + step * other.n / n, self.squares + other.squares + step * step * self.n * other.n / n
        )

    @property
    def std(self) -> float:
        """Sample standard deviation; NaN of fewer than two values."""
        return math.sqrt(self.squares / (self.n - 1)) if self.n > 1 else math.nan

    @property
    def standard_error(self) -> float:
        """Standard deviation of the mean; NaN of fewer than two values."""
        return self.std / math.sqrt(self.n) if self.n else math.nan


def point_seed(seed: int, conditions: Any) -> int:
    """Return the seed of a point's random numbers: the same for the same conditions, independent for others.

    Args:
        seed: of the study.
        conditions: JSON-ready; what the trials are made of.
    """
    digest = hashlib.sha256(json.dumps(conditions, sort_keys=True, default=str).encode()).digest()
    words = np.frombuffer(digest, '<u4').tolist()
    return int(np.random.SeedSequence([seed, *words]).generate_state(1, np.uint64)[0] >> np.uint64(1))


@functools.cache
def versions(packages: tuple[str, ...], without: tuple[str, ...] = ()) -> dict[str, str]:
    """Return what besides the study decides the bits of a result: versions, and a digest of the packages' code.

    Args:
        packages: names.
        without: files of them, such as 'report.py', that decide nothing.
    """
    import scipy

    found = {'python': platform.python_version(), 'numpy': np.__version__, 'scipy': scipy.__version__}
    for package in packages:
        spec = importlib.util.find_spec(package)
        if spec is None or spec.origin is None:
            raise ConfigurationError(f"package '{package}' is not installed")
        folder = Path(spec.origin).parent
        digest = hashlib.sha256()
        for path in sorted(folder.rglob('*.py')):
            if path.name not in without:
                digest.update(f'{path.relative_to(folder)}\n'.encode() + path.read_bytes())
        found[package] = digest.hexdigest()[:16]
    return found


class ResultDirectory:
    """The files of one study; a context that holds the directory's lock."""

    def __init__(self, path: Path | str, study: Study) -> None:
        """Name the directory; it is made or checked on entering.

        Args:
            path: of the directory.
            study: whose results it holds.
        """
        self.path, self.study = Path(path), study
        self._lock = contextlib.ExitStack()

    def __enter__(self) -> 'ResultDirectory':
        """Make the directory, or check that it holds this study.

        Raises:
            ConfigurationError: it holds something else, is in use, or cannot be written.
        """
        with contextlib.ExitStack() as stack:
            self._take(stack)
            self._lock = stack.pop_all()
        return self

    def _take(self, stack: contextlib.ExitStack) -> None:
        """Lock the directory, and make or check what it holds."""
        manifest = self.path / _MANIFEST
        wanted = self._content()
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if not manifest.exists() and any(p.name != _LOCK for p in self.path.iterdir()):
                raise ConfigurationError(f'{self.path}: is not empty and holds no Monte Carlo study; choose another')
            lock = stack.enter_context(open(self.path / _LOCK, 'a'))
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigurationError(f'{self.path}: another run is working on this study') from None
        except OSError as error:
            raise ConfigurationError(f'{self.path}: {error.strerror}') from None
        if manifest.exists():
            try:
                there = json.loads(manifest.read_text(encoding='utf-8'))
            except (OSError, ValueError) as error:
                raise ConfigurationError(f'{manifest}: cannot be read: {error}') from None
            change = _difference(there, wanted)
            if change:
                raise ConfigurationError(f'{self.path}: holds another study: {change}; choose another directory')
        else:
            write_atomically(manifest, json.dumps(wanted, indent=1) + '\n')

    def __exit__(self, *exception: object) -> None:
        """Let others in."""
        self._lock.close()

    def _content(self) -> dict[str, Any]:
        study = self.study
        content = {
            'trials': study.trials,
            'batch': study.batch,
            'points': list(study.points),
            'versions': versions(study.packages),
        }
        return json.loads(json.dumps(content, default=str))

    def missing(self) -> list[Job]:
        """Return the batches that are not there yet, or cannot be read."""
        points = range(len(self.study.points))
        return [job for point in points for job in self.study.jobs(point) if self._read(job) is None]

    def store(self, job: Job, arrays: Mapping[str, np.ndarray]) -> None:
        """Write one batch, whole or not at all.

        Raises:
            StudyStopped: it cannot be written.
        """
        content = io.BytesIO()
        np.savez(content, **arrays)
        path = job.file(self.path)
        try:
            path.parent.mkdir(exist_ok=True)
            write_atomically(path, content.getvalue())
        except (OSError, ConfigurationError) as error:
            raise StudyStopped(f'cannot write results: {error}') from None

    def batches(self, point: int) -> Iterator[dict[str, np.ndarray]]:
        """Yield a point's stored batches one by one, in order.

        Raises:
            StudyStopped: one is not there.
        """
        for job in self.study.jobs(point):
            arrays = self._read(job)
            if arrays is None:
                raise StudyStopped(f'{job.file(self.path)}: is missing')
            yield arrays

    def _read(self, job: Job) -> dict[str, np.ndarray] | None:
        """Return a batch, None where it is missing or damaged (the archive's checksums tell)."""
        try:
            with open(job.file(self.path), 'rb') as file, np.load(file) as archive:
                arrays = {name: archive[name] for name in archive.files}
        except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
            return None
        return arrays if arrays and all(len(a) == len(job.sweeps) for a in arrays.values()) else None


def _difference(there: Any, here: Any, name: str = '') -> str:
    """Return the first difference between two JSON values in words, '' where there is none."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted({*there, *here}):
            change = _difference(there.get(key), here.get(key), f'{name}.{key}' if name else key)
            if change:
                return change
        return ''
    if isinstance(there, list) and isinstance(here, list):
        if len(there) != len(here):
            return f'{len(there)} {name} there, {len(here)} here'
        changes = (_difference(a, b, f'{name}.{i}') for i, (a, b) in enumerate(zip(there, here, strict=True)))
        return next((change for change in changes if change), '')
    same = there == here or (there != there and here != here)  # NaN stands for itself
    return '' if same else f'{name} is {there} there, {here} here'


def run(
    results: ResultDirectory,
    task: Task,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
    note: Callable[[str], None] = lambda text: None,
) -> None:
    """Do what is missing of a study.

    Args:
        results: of the study, entered.
        task: makes the trials; a function of an importable module.
        jobs: processes on this machine; 1 works in this one.
        scheduler: address of a Dask scheduler, whose workers then do the work.
        progress: called with the number of trials done.
        note: called with a line that the user should see.

    Raises:
        ConfigurationError: the task refuses a point, or the scheduler does not answer.
        StudyStopped: a worker died, or the task failed.
        KeyboardInterrupt: on Ctrl-C, workers ended.
    """
    missing = results.missing()
    done = results.study.total - sum(len(job.sweeps) for job in missing)
    progress(done)
    if not missing:
        return
    if scheduler is not None:
        work = _on_cluster(results.study, task, missing, scheduler, note)
    elif jobs > 1:
        work = _in_processes(results.study, task, missing, min(jobs, len(missing)))
    else:
        work = _here(results.study, task, missing)
    with contextlib.closing(work):  # ends the workers, whatever happens
        for job, arrays in work:
            results.store(job, arrays)
            done += len(job.sweeps)
            progress(done)


_Finished = Iterator[tuple[Job, Mapping[str, np.ndarray]]]


def _here(study: Study, task: Task, jobs: Sequence[Job]) -> _Finished:
    for job in jobs:
        yield job, _result(_attempt(task, *_order(study, job)))


def _order(study: Study, job: Job) -> tuple[Mapping[str, Any], range, tuple[str, ...], Mapping[str, str]]:
    """Return what a worker has to know of a batch."""
    return study.points[job.point], job.sweeps, study.packages, versions(study.packages)


def _attempt(
    task: Task, point: Mapping[str, Any], sweeps: range, packages: tuple[str, ...], expected: Mapping[str, str]
) -> tuple[str, Any]:
    """Return ('done', arrays), ('refused', why) or ('failed', why); runs in the worker."""
    try:
        change = _difference(dict(expected), versions(packages))
        if change:
            return 'failed', f'other versions on {platform.node()} (here): {change}'
        return 'done', task(point, sweeps)
    except ConfigurationError as error:
        return 'refused', str(error)
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return 'failed', f'{type(error).__name__}: {error} ({last.filename}:{last.lineno})'


def _result(outcome: tuple[str, Any]) -> Mapping[str, np.ndarray]:
    verdict, content = outcome
    if verdict == 'refused':
        raise ConfigurationError(content)
    if verdict == 'failed':
        raise StudyStopped(f'a batch failed: {content}')
    return content


def _serve(connection: Connection, task: Task) -> None:
    """Work until the other end is closed, or gone; a worker process."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            connection.send(_attempt(task, *connection.recv()))


def _in_processes(study: Study, task: Task, jobs: Sequence[Job], count: int) -> _Finished:
    """Yield what `count` processes finish, as it comes; each has one batch to do and one waiting."""
    context = multiprocessing.get_context('spawn')
    left = list(reversed(jobs))
    workers: dict[Connection, tuple[Any, list[Job]]] = {}
    resource_tracker.ensure_running()  # its start would undo the mask below
    try:
        for _ in range(count):
            own, other = context.Pipe()
            process = context.Process(target=_serve, args=(other, task), daemon=True)
            # Ctrl-C reaches every process of the terminal; only this one is to answer it
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                process.start()
                workers[own] = (process, [])
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
            other.close()
        for _ in range(2):
            for connection, (process, doing) in workers.items():
                _hand_out(study, left, connection, process, doing)
        while any(doing for _, doing in workers.values()):
            for connection in wait([c for c, (_, doing) in workers.items() if doing]):
                process, doing = workers[connection]
                try:
                    outcome = connection.recv()
                except (EOFError, OSError):
                    raise _died(process) from None
                job = doing.pop(0)
                _hand_out(study, left, connection, process, doing)
                yield job, _result(outcome)
    finally:
        for connection, (process, _) in workers.items():
            connection.close()
            process.terminate()
        for process, _ in workers.values():
            process.join()


def _hand_out(study: Study, left: list[Job], connection: Connection, process: Any, doing: list[Job]) -> None:
    if left:
        try:
            connection.send(_order(study, left[-1]))
        except OSError:
            raise _died(process) from None
        doing.append(left.pop())


def _died(process: Any) -> StudyStopped:
    process.join()
    code = process.exitcode
    how = f'killed by {signal.Signals(-code).name}' if code and code < 0 else f'exit status {code}'
    return StudyStopped(f'a worker process died ({how})')


def _on_cluster(study: Study, task: Task, jobs: Sequence[Job], address: str, note: Callable[[str], None]) -> _Finished:
    """Yield what the workers of a Dask cluster finish, as it comes.

    Dask gives the batches of a worker that dies to others, up to its limit for batches that kill their workers.
    """
    if not address.rpartition(':')[2].isdigit():
        raise ConfigurationError(f'--scheduler {address}: expected an address like tcp://host:8786')
    import distributed  # the only place that needs it; it takes half a second

    for name in list(logging.root.manager.loggerDict):
        if name.partition('.')[0] == 'distributed':  # what matters of what they say is said here, in one line
            logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        distributed.comm.resolve_address(address)  # a client made for a wrong one does not end quietly
        client = distributed.Client(address, timeout=_CONNECT_LIMIT, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigurationError(f'--scheduler {address}: no Dask scheduler answers: {error}') from None
    finished: queue.SimpleQueue = queue.SimpleQueue()
    left, doing = list(reversed(jobs)), {}
    try:
        cluster = _Cluster(client, address, note)
        while left or doing:
            while left and len(doing) < 2 * cluster.threads + 2:
                job = left.pop()
                future = client.submit(_attempt, task, *_order(study, job), pure=False)
                doing[future.key] = (job, future)
                future.add_done_callback(finished.put)
            with contextlib.suppress(queue.Empty):
                future = finished.get(timeout=_LOOK_INTERVAL)
                job, _ = doing.pop(future.key)
                if future.status != 'finished':
                    raise cluster.failure(future)
                yield job, _result(future.result())
            cluster.look()
    except (OSError, TimeoutError):  # of the connection
        raise StudyStopped(f'the Dask scheduler at {address} is gone') from None
    finally:
        with contextlib.suppress(Exception):  # a scheduler that is gone has nothing left to cancel
            client.cancel([future for _, future in doing.values()])
        client.close(timeout=2)


class _Cluster:
    """Watches a Dask cluster, so that nobody waits for workers that are gone."""

    def __init__(self, client: Any, address: str, note: Callable[[str], None]) -> None:
        self.threads = 0  # of all workers
        self._client, self._address, self._note = client, address, note
        self._workers: set[str] = set()
        self._looked = self._worked = time.monotonic()
        self._look()

    def look(self) -> None:
        """Notice what has changed, at most once a second.

        Raises:
            StudyStopped: the scheduler is gone, or there has been no worker for long.
        """
        if time.monotonic() - self._looked > _LOOK_INTERVAL:
            self._look()

    def _look(self) -> None:
        try:
            threads = self._client.nthreads()
        except Exception:  # whatever it is that Dask raises: the scheduler does not answer
            raise StudyStopped(f'the Dask scheduler at {self._address} is gone') from None
        self._looked = time.monotonic()
        for worker in sorted(self._workers - set(threads)):
            self._note(f'worker {worker} is gone; others do its batches')
        if not threads and (self._workers or not self.threads):
            self._note(f'{self._address} has no workers; waiting {_WORKER_LIMIT:g} s for one')
        self._workers, self.threads = set(threads), sum(threads.values()) or 1
        if threads:
            self._worked = self._looked
        elif self._looked - self._worked > _WORKER_LIMIT:
            raise StudyStopped(f'the Dask scheduler at {self._address} has no workers')

    def failure(self, future: Any) -> StudyStopped:
        """Return why a batch did not come back."""
        if future.status == 'error':
            error = future.exception()
            return StudyStopped(f'a batch failed: {type(error).__name__}: {error}')
        return StudyStopped(f'the Dask scheduler at {self._address} is gone')
