"""Worker processes: the same results as here, a death and an error reported, and nothing left behind."""

import copyreg
import functools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pieces_of_work import Untransferable, count_up, fail, note_each, power_of_two, process_and_niceness, sleep_long

from drfmcw_ros.work.processes import Background, Worker, Workers, WorkFailed, unordered

LIMIT = 60.0  # for anything to happen [s]
STARTS = ('fork', 'forkserver', 'spawn')


def wait_for(condition):
    """Return the first true value of the condition."""
    end = time.monotonic() + LIMIT
    while not (value := condition()):
        assert time.monotonic() < end
        time.sleep(0.01)
    return value


def alive(process):
    """Return whether a process runs; one that has ended and is waited for does not."""
    try:
        return Path(f'/proc/{process}/stat').read_text().rsplit(')', 1)[1].split()[0] != 'Z'
    except OSError:
        return False


# --- a list of items ---


@pytest.mark.parametrize('count', [1, 2, 7])
def test_map_gives_what_one_process_gives(count):
    items = list(range(5))
    # a closure cannot be pickled: it and the items stay in memory
    assert Workers(count).map(lambda i: items[i] ** 2, items) == [i**2 for i in items]
    with pytest.raises(IndexError, match='out of range'):
        Workers(count).map(lambda i: items[i], range(6))


def test_map_works_in_other_processes_and_never_in_theirs():
    def processes(_):
        return os.getpid(), set(Workers(2).map(lambda _: os.getpid(), range(4)))

    found = Workers(2).map(processes, range(4))
    assert os.getpid() not in {own for own, _ in found}
    assert all(inner == {own} for own, inner in found)


def test_map_reports_the_death_of_a_process():
    with pytest.raises(WorkFailed, match='killed by SIGKILL'):
        Workers(2).map(lambda i: os.kill(os.getpid(), signal.SIGKILL) if i == 1 else i, range(3))


@pytest.mark.parametrize('start', STARTS)
@pytest.mark.parametrize('waiting', [0, 1])
def test_unordered_gives_every_result_once(start, waiting):
    found = list(unordered(power_of_two, range(12), 2, waiting=waiting, start=start, preload=['pieces_of_work']))
    assert sorted(found) == [(i, 2**i) for i in range(12)]


@pytest.mark.parametrize('waiting', [0, 1])
def test_unordered_stops_with_the_reason(waiting):
    for number, error, reason in ((13, ValueError, 'not 13'), (14, WorkFailed, 'killed by SIGKILL')):
        with pytest.raises(error, match=reason):
            list(unordered(power_of_two, [1, number, *range(10)], 2, waiting=waiting, start='fork'))


def test_nothing_to_do_starts_nothing():
    assert list(unordered(power_of_two, [], 2)) == []


# --- a stream of results ---


@pytest.mark.parametrize('start', STARTS)
def test_worker_works_on_one_argument_after_another(start):
    with Worker(count_up, start=start) as worker:
        worker.give(3)
        worker.give(0)
        assert list(worker.results()) == [0, 1, 2]
        assert list(worker.results()) == []
        worker.give(2)
        assert list(worker.results(LIMIT)) == [0, 1]


@pytest.mark.parametrize('ahead', [0, 2])
@pytest.mark.parametrize(
    ('reason', 'error', 'said'),
    [
        ('exit', WorkFailed, 'exit status 3'),
        ('sys.exit', WorkFailed, 'exit status 4'),
        ('kill', WorkFailed, 'killed by SIGKILL'),
        ('odd', ValueError, 'odd'),
        ('untransferable', WorkFailed, 'Untransferable: two parts'),
    ],
)
def test_worker_reports_how_it_failed(reason, error, said, ahead, monkeypatch):
    # a library that a test before this one imported (tblib, by Dask) may have taught pickle all errors known then
    monkeypatch.delitem(copyreg.dispatch_table, Untransferable, raising=False)
    with Worker(fail, start='fork', ahead=ahead) as worker:
        worker.give(reason)
        with pytest.raises(error, match=said):
            list(worker.results())


def test_error_shows_where_in_the_worker_it_was_raised():
    with Worker(fail, start='fork') as worker:
        worker.give('odd')
        with pytest.raises(ValueError) as raised:
            list(worker.results())
        assert 'pieces_of_work.py' in raised.value.__notes__[0]
        worker.give('odd')  # the process itself is well
        assert next(worker.results()) == 'begun'


def test_worker_that_takes_too_long_is_ended():
    with Worker(sleep_long, start='fork') as worker:
        worker.give(None)
        assert next(worker.results(LIMIT)) == 'begun'
        with pytest.raises(WorkFailed, match=r'nothing came for 0\.2 s'):
            next(worker.results(0.2))


@pytest.mark.parametrize('ahead', [0, 3])
def test_worker_stays_a_bounded_way_ahead(tmp_path, ahead):
    """The pipe holds some thousand small results; so they are large here."""
    with Worker(large, start='fork', ahead=ahead) as worker:
        worker.give(str(tmp_path))
        results = worker.results()
        for _ in range(3):
            next(results)
        # three taken, one under way in the pipe, `ahead` waiting, and one that is ready to wait
        most = 3 + 1 + ahead + (1 if ahead else 0)
        wait_for(lambda: len(list(tmp_path.iterdir())) == most)
        time.sleep(0.2)
        assert len(list(tmp_path.iterdir())) == most


def large(folder):
    """Give a megabyte each."""
    for _ in note_each(folder):
        yield bytes(2**20)


def test_niceness_is_that_asked_for():
    with Worker(process_and_niceness, start='fork', niceness=2) as worker:
        worker.give(None)
        process, niceness = worker.results()
    assert process != os.getpid()
    assert niceness == min(os.nice(0) + 2, 19)


@pytest.mark.parametrize('start', STARTS)
def test_ctrl_c_leaves_workers_alone(start):
    with Worker(process_and_niceness, start=start) as worker:
        worker.give(None)
        process, _ = worker.results()
        os.kill(process, signal.SIGINT)
        worker.give(None)
        assert next(worker.results()) == process


ORPHANS = """
import time
from pieces_of_work import process_and_niceness, sleep_long
from drfmcw_ros.work.processes import Worker
if __name__ == '__main__':
    workers = [Worker(process_and_niceness, start=start) for start in ('forkserver', 'spawn', 'fork', 'fork')]
    for worker in workers:
        worker.give(None)
    print(*(next(worker.results()) for worker in workers), flush=True)
    time.sleep(1000.0)
"""


def test_workers_end_with_the_process_that_started_them(tmp_path):
    """However it ends; one that is idle does not even send anything."""
    (tmp_path / 'orphans.py').write_text(ORPHANS)
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get('PYTHONPATH', '')])
    parent = subprocess.Popen(
        [sys.executable, str(tmp_path / 'orphans.py')],
        env=os.environ | {'PYTHONPATH': path},
        stdout=subprocess.PIPE,
        text=True,
    )
    workers = [int(word) for word in parent.stdout.readline().split()]
    assert len(workers) == 4 and all(map(alive, workers))
    parent.kill()
    parent.communicate(timeout=LIMIT)
    wait_for(lambda: not any(map(alive, workers)))


# --- work that nobody waits for ---


def gathered(background, count=None):
    """Return results until the work has ended, or so many."""
    found, end = [], time.monotonic() + LIMIT
    while background.busy and time.monotonic() < end and (count is None or len(found) < count):
        found += background.results()
        time.sleep(0.01)
    return found


def test_background_gives_all_results_one_work_after_another():
    background = Background(count_up)
    for limit in (3, 0):
        background.start(limit)
        with pytest.raises(RuntimeError, match='one piece of work'):
            background.start(limit)
        assert gathered(background) == list(range(limit))
    background.close()


def test_background_works_on_the_argument_as_it_was():
    argument = [1, 2]
    background = Background(functools.partial(map, str))
    background.start(argument)
    argument.append(3)
    assert gathered(background) == ['1', '2']


@pytest.mark.parametrize(('reason', 'said'), [('exit', 'exit status 3'), ('odd', 'ValueError: odd')])
def test_background_says_how_work_failed(reason, said):
    background = Background(fail)
    background.start(reason)
    with pytest.raises(WorkFailed, match=said):
        gathered(background)
    assert not background.busy
    background.close()


def test_background_gives_up_on_work_that_takes_too_long():
    background = Background(sleep_long, patience=3.0)
    background.start(None)
    with pytest.raises(WorkFailed, match='nothing came for 3 s'):
        gathered(background)


def test_background_ends_at_once():
    background = Background(sleep_long)
    background.start(None)
    assert gathered(background, 1) == ['begun']
    background.close()
    assert not background.busy
