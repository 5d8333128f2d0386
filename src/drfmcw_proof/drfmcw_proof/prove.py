"""`drfmcw prove`: conceals effects in recordings, lets the diagnosis find them, opens the seals and reports."""

import argparse
import collections
import concurrent.futures
import contextlib
import dataclasses
import fcntl
import json
import os
import shlex
import shutil
import sys
import threading
import time
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from drfmcw_diagnosis.diagnose import main as diagnose
from drfmcw_physics.settings import ConfigurationError, nearest
from drfmcw_ros.commands.cli import Parser, guarded, write_atomically
from drfmcw_ros.commands.versions import versions
from drfmcw_ros.work.processes import Worker, WorkFailed
from drfmcw_ros.work.progress import Progress

from .cases.plan import FULL, GROUPS, Plan, conceal_case, plans
from .generator.recordings import Seal, open_seal
from .judging import judge
from .real.page import page
from .real.running import recordings, run
from .report import Run, write_report
from .second_opinion import apart, separated

_PROG = 'drfmcw prove'
_PACKAGES = tuple(f'drfmcw_{name}' for name in ('physics', 'ros', 'sim', 'node', 'fusion', 'diagnosis', 'proof'))
_CHECKOUT = Path(__file__).resolve().parents[3]  # where this file lies in a source checkout
_JUDGES = ('prove.py', 'judging.py', 'figures.py', 'plots.py', 'report.py')  # change no finding
_MANIFEST, _LOCK = 'proof.json', '.lock'
_PATIENCE = 1800.0  # for one diagnosis [s]

QUICK_SHARE = 0.55
"""Share of the cases of --quick that must be right: 8 of 12 were when it was set; other libraries may miss one."""


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    result = Parser(
        prog=_PROG,
        description='Conceal effects in recordings by an independent generator, let the diagnosis find them from the '
        'recordings alone, and report what it got right. The same command resumes an interrupted run.',
    )
    result.add_argument('--quick', action='store_true', help='a dozen small recordings instead of some hundreds')
    result.add_argument('--out', metavar='DIR', help='directory of results and report (build/prove/ of a checkout)')
    result.add_argument('--cases', type=int, metavar='N', help='the first N only, a fair sample of all kinds')
    result.add_argument(
        '--times', type=int, metavar='N', help='a list with N times as many of each kind; each N takes some hours'
    )
    result.add_argument('--groups', metavar='LIST', help=f'only these: {",".join(GROUPS)}')
    result.add_argument('--jobs', type=int, default=os.cpu_count(), metavar='N', help='processes (default: all cores)')
    result.add_argument('--seed', type=int, default=1, metavar='S', help='of all random numbers (1)')
    result.add_argument('--force', action='store_true', help='discard results of other settings or another version')
    result.add_argument('--keep', action='store_true', help='keep the recordings after their judgement')
    result.add_argument(
        '--real', nargs='+', metavar='DIR', help='instead, recordings of real radars below these directories: '
        'real_recordings.md says what is found in them and in what is added to them',
    )  # fmt: skip
    result.add_argument('--document', action='store_true', help='write the report into docs/ of the checkout as well')
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status."""
    arguments = parser().parse_args(argv)
    words = ['./drfmcw', 'prove', *(sys.argv[1:] if argv is None else argv)]
    return guarded(_PROG, lambda: _run(arguments, shlex.join(words)))


def chosen(listed: Sequence[Plan], groups: Sequence[str], count: int | None, seed: int) -> tuple[Plan, ...]:
    """Return cases of some groups in the order in which they are run, the first `count` of them.

    Groups take turns in proportion to their shares, and so do the kinds within each group, at random. However many
    cases are run, they are a fair sample of the list, and a longer run contains a shorter one. The measurement that
    decides an ambiguous case follows it.
    """
    random = np.random.default_rng([seed, len(listed)])
    following = {plan.follows.name: plan for plan in listed if plan.follows is not None}
    ranked: list[tuple[float, int, Plan]] = []
    for number, (group, share) in enumerate(GROUPS.items()):
        own = [plan for plan in listed if plan.group == group and plan.follows is None]
        shuffled = [own[i] for i in random.permutation(len(own))]
        met: collections.Counter[str] = collections.Counter()
        turns = []
        for plan in shuffled:
            turns.append(met[plan.kind])
            met[plan.kind] += 1
        for rank, i in enumerate(np.argsort(turns, kind='stable')):
            ranked.append((rank / share, number, shuffled[i]))
    taken: list[Plan] = []
    for _, _, plan in sorted(ranked, key=lambda one: one[:2]):
        taken += [p for p in (plan, following.get(plan.name)) if p is not None and p.group in groups]
    return tuple(taken[:count])


class Results:
    """Directory of one run; a context that holds its lock."""

    def __init__(self, path: Path, settings: dict[str, Any], force: bool = False) -> None:
        """Name the directory; it is made or checked on entering."""
        self.path, self._settings, self._force = path, settings, force
        self._lock = contextlib.ExitStack()

    def __enter__(self) -> 'Results':
        """Make the directory, or check that it holds this run.

        Raises:
            ConfigurationError: it holds another run, is in use, or cannot be written.
        """
        with contextlib.ExitStack() as stack:
            try:
                self.path.mkdir(parents=True, exist_ok=True)
                if not self._manifest.exists() and any(p.name != _LOCK for p in self.path.iterdir()):
                    raise ConfigurationError(f'{self.path}: is not empty and holds no proof; choose another')
                fcntl.flock(stack.enter_context(open(self.path / _LOCK, 'a')), fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ConfigurationError(f'{self.path}: another run is working there') from None
            except OSError as error:
                raise ConfigurationError(f'{self.path}: {error.strerror}') from None
            self._check()
            (self.path / 'cases').mkdir(exist_ok=True)
            self._remove_interrupted()
            self._lock = stack.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        """Let others in."""
        self._lock.close()

    @property
    def _manifest(self) -> Path:
        return self.path / _MANIFEST

    def _check(self) -> None:
        if self._manifest.exists() and not self._force:
            try:
                there = json.loads(self._manifest.read_text(encoding='utf-8'))
            except (OSError, ValueError) as error:
                raise ConfigurationError(f'{self._manifest}: cannot be read: {error}') from None
            for key, value in self._settings.items():
                if there.get(key) != value:
                    what = (
                        f'{key} {there.get(key)}, not {value}' if key != 'versions' else 'another version of the code'
                    )
                    raise ConfigurationError(f'{self.path}: holds a proof with {what}; --force begins anew')
        elif self._manifest.exists():
            shutil.rmtree(self.path / 'cases', ignore_errors=True)
        write_atomically(self._manifest, json.dumps(self._settings, indent=1) + '\n')

    def _remove_interrupted(self) -> None:
        judged = {path.stem for path in (self.path / 'cases').iterdir()}
        for path in (p for name in ('recordings', 'truths') for p in (self.path / name).glob('*')):
            if path.stem in judged:
                continue
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()

    def record(self, name: str) -> dict[str, Any] | None:
        """Return what is stored of a case."""
        path = self.path / 'cases' / f'{name}.json'
        return json.loads(path.read_text(encoding='utf-8')) if path.exists() else None

    def store(self, record: dict[str, Any]) -> None:
        """Store a judged case."""
        write_atomically(self.path / 'cases' / f'{record["name"]}.json', json.dumps(record, indent=1) + '\n')


class _Interrupted(Exception):
    """The run ends before this case does."""


def _alone(order: tuple[Sequence[str], Path]) -> Iterator[int]:
    """Run `drfmcw diagnose` in this process, which is for nothing else; yield its exit status.

    Args:
        order: the words of its command line, and the file that gets its error messages.
    """
    words, said = order
    with open(os.devnull, 'w') as nowhere, open(said, 'w') as file:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(file.fileno(), 2)
    status = diagnose(words)
    sys.stderr.flush()
    yield status


_Diagnosing: TypeAlias = Worker[tuple[Sequence[str], Path], int]


class _Tries:
    """Tries cases in threads; each diagnosis runs in a process of its own that knows the recording's path alone."""

    def __init__(self, results: Results, console: Console, keep: bool) -> None:
        self._results, self._console, self._keep = results, console, keep
        self._stop = threading.Event()
        self._running: set[_Diagnosing] = set()
        # a server that knows no case, but has all imported, starts the processes of the diagnoses
        self._preload = [name for name in sys.modules if name.startswith('drfmcw_')]
        self._making = threading.Lock()

    def stop(self) -> None:
        """End the processes at work; cases that are not finished are not stored."""
        self._stop.set()
        for worker in list(self._running):
            worker.kill()

    def one(self, plan: Plan) -> dict[str, Any]:
        """Conceal, announce, find, open the seal, judge, store.

        Raises:
            _Interrupted: `stop` was called.
        """
        folder = self._results.path
        with self._making:  # bound to this process's one interpreter anyway
            if self._stop.is_set():
                raise _Interrupted
            recording, sealed = conceal_case(plan, folder / 'recordings', folder / 'truths', self._announce)
        begin = time.monotonic()
        finding, error = self._diagnose(recording, folder / f'recordings/{plan.name}.json', plan.without)
        seconds = time.monotonic() - begin
        truth = open_seal(sealed)
        if finding is None:
            judgement: dict[str, Any] = {'outcome': 'failed', 'reason': error, 'named': [], 'pulls': []}
        else:
            judgement = judge(truth, finding, apart(plan.condition, truth['effects'], finding)).as_object()
        record = {
            'name': plan.name,
            'group': plan.group,
            'kind': plan.kind,
            'sha256': sealed.sha256,
            'truth': {k: v for k, v in truth.items() if k != 'condition'},
            'finding': finding,
            'judgement': judgement,
            'separated': finding and separated(plan.condition, truth['effects'], finding),
            'seconds': seconds,
        }
        self._results.store(record)
        if not self._keep:
            shutil.rmtree(recording)
        return record

    def _announce(self, plan: Plan, sealed: Seal) -> None:
        self._console.print(f'{plan.name} sealed {sealed.sha256}', highlight=False, soft_wrap=True)

    def _diagnose(self, recording: Path, out: Path, without: Sequence[str]) -> tuple[dict[str, Any] | None, str]:
        """Return (finding, '') or (None, what went wrong)."""
        words = [str(recording), '--json', str(out), '--jobs', '1']
        if without:
            words += ['--without', ','.join(without)]
        said = out.with_suffix('.txt')
        said.touch()
        with Worker(_alone, start='forkserver', preload=self._preload) as worker:
            self._running.add(worker)
            failure = '' if self._stop.is_set() else _failure(worker, words, said)
            self._running.discard(worker)
        if self._stop.is_set():
            raise _Interrupted
        said.unlink()
        return (None, failure) if failure else (json.loads(out.read_text(encoding='utf-8')), '')


def _failure(worker: _Diagnosing, words: Sequence[str], said: Path) -> str:
    """Run a diagnosis; return why it failed, '' where it did not."""
    try:
        worker.give((words, said))
        [status] = worker.results(_PATIENCE)
    except WorkFailed as error:
        return str(error)
    except Exception as error:  # whatever the diagnosis raises is an outcome of the case
        return f'{type(error).__name__}: {error}'
    lines = said.read_text(encoding='utf-8').strip().splitlines() or [f'exit status {status}']
    return lines[-1] if status else ''


def _judged(record: dict[str, Any]) -> dict[str, Any]:
    """Return a stored case, judged by the rules as they are now."""
    if record['finding'] is None:
        return record
    judgement = judge(record['truth'], record['finding'], record['judgement']['apart'])
    return {**record, 'judgement': judgement.as_object()}


def _try_all(tries: _Tries, missing: Sequence[Plan], jobs: int) -> Generator[dict[str, Any], None, None]:
    """Yield records as they come; ends what runs when it is closed or interrupted."""
    pool = concurrent.futures.ThreadPoolExecutor(jobs)
    try:
        for future in concurrent.futures.as_completed([pool.submit(tries.one, plan) for plan in missing]):
            yield future.result()
    except BaseException:
        tries.stop()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _settings(arguments: argparse.Namespace) -> tuple[dict[str, Any], list[str]]:
    """Check the command line; return what a resumed run must share, and the groups.

    Raises:
        ConfigurationError: a number out of bounds or an unknown group.
    """
    for name, low in (('cases', 1), ('times', 1), ('jobs', 1), ('seed', 0)):
        value = getattr(arguments, name)
        if value is not None and value < low:
            raise ConfigurationError(f'--{name} = {value} must be at least {low}')
    groups = list(GROUPS) if arguments.groups is None else [g.strip() for g in arguments.groups.split(',')]
    for group in groups:
        if group not in GROUPS:
            raise ConfigurationError(f"--groups: unknown group '{group}'{nearest(group, list(GROUPS))}")
    if arguments.quick and arguments.times is not None:
        raise ConfigurationError('--times: --quick has one list of its own')
    return {
        'extent': 'quick' if arguments.quick else 'full',
        'times': arguments.times or 1,
        'seed': arguments.seed,
        'versions': versions(_PACKAGES, _JUDGES),
    }, groups


def _folders(arguments: argparse.Namespace) -> tuple[Path, Path | None]:
    """Return the directory of the results, and that of the document if it is wanted.

    Raises:
        ConfigurationError: neither is known.
    """
    is_checkout = (_CHECKOUT / 'drfmcw').is_file() and (_CHECKOUT / 'docs').is_dir()
    if not is_checkout and (arguments.out is None or arguments.document):
        raise ConfigurationError('not run in a source checkout: --out DIR, without --document, says where to write')
    out = (
        _CHECKOUT / 'build/prove' / ('quick' if arguments.quick else 'full') if arguments.out is None else arguments.out
    )
    return Path(out), _CHECKOUT / 'docs' if arguments.document else None


def _real(arguments: argparse.Namespace, command: str) -> int:
    """Try recordings of real radars, and write the page."""
    out, documents = _folders(arguments)
    console = Console(stderr=True)
    paths = recordings([Path(path) for path in arguments.real])
    text = page(command, run(paths, arguments.seed, lambda name: console.print(name, highlight=False)))
    for folder in filter(None, (out, documents)):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / 'real_recordings.md', text)
    console.print(f'{(documents or out) / "real_recordings.md"}', highlight=False, soft_wrap=True)
    return 0


def _run(arguments: argparse.Namespace, command: str) -> int:
    if arguments.real:
        return _real(arguments, command)
    settings, groups = _settings(arguments)
    out, documents = _folders(arguments)
    console = Console(stderr=True)
    listed = plans(settings['extent'], arguments.seed, dataclasses.replace(FULL, times=settings['times']))
    selected = chosen(listed, groups, arguments.cases, arguments.seed)
    if not selected:
        raise ConfigurationError(f'--groups: no case of {", ".join(groups)} in the {settings["extent"]} list')
    with Results(out, settings, arguments.force) as results:
        missing = [plan for plan in selected if results.record(plan.name) is None]
        columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=console) as bar:
            task = bar.add_task('recordings', total=len(selected), completed=len(selected) - len(missing))
            tries = _Tries(results, bar.console, arguments.keep)
            try:
                with contextlib.closing(_try_all(tries, missing, arguments.jobs)) as work:
                    for _ in work:
                        bar.advance(task)
            except KeyboardInterrupt:
                bar.stop()
                done = sum(results.record(plan.name) is not None for plan in selected)
                console.print(
                    f'{_PROG}: interrupted; {done} of {len(selected)} cases are in {out}, '
                    'the same command does the rest',
                    highlight=False, soft_wrap=True,
                )  # fmt: skip
                raise
        in_order = sorted(selected, key=lambda plan: plan.name)
        records = [_judged(record) for plan in in_order if (record := results.record(plan.name)) is not None]
    changed = versions(_PACKAGES, _JUDGES) != settings['versions']
    run = Run(
        command, settings['extent'], arguments.seed, len(listed), settings['versions'], QUICK_SHARE, changed,
        settings['times'],
    )  # fmt: skip
    for folder in filter(None, (out, documents)):
        write_report(folder, run, records)
    right = sum(record['judgement']['outcome'] == 'right' for record in records)
    report = (documents or out) / 'proof.md'
    console.print(f'{report}: {right} of {len(records)} right', highlight=False, soft_wrap=True)
    return int(arguments.quick and right < QUICK_SHARE * len(records))


if __name__ == '__main__':
    sys.exit(main())
