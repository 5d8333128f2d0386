"""Recordings rendered by several processes: the same bytes, and a clean end whatever happens to a process."""

import contextlib
import filecmp
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from checkout import CONFIG

pytest.importorskip('drfmcw_ros.bag.files')
from drfmcw_sim import simulate  # noqa: E402
from drfmcw_sim.recording import write_recording  # noqa: E402
from drfmcw_sim.scenario import read_scenario  # noqa: E402

GANTRY = str(CONFIG / 'gantry.yaml')
ENDLESS = '--set', 'pairs.0.standing.sweeps=1000000'
LIMIT = 60.0  # for anything to happen [s]


def descendants(process):
    """Return the process numbers of children, and of their children."""
    parents = {}
    for status in Path('/proc').glob('[0-9]*/stat'):
        try:
            fields = status.read_text().rsplit(')', 1)[1].split()
        except OSError:  # it has ended meanwhile
            continue
        parents.setdefault(int(fields[1]), []).append(int(status.parent.name))
    children = parents.get(process, [])
    return children, [grandchild for child in children for grandchild in parents.get(child, [])]


def wait_for(condition):
    """Return the first true value of the condition."""
    end = time.monotonic() + LIMIT
    while not (value := condition()):
        assert time.monotonic() < end
        time.sleep(0.02)
    return value


@pytest.fixture
def started(tmp_path):
    """A simulation by two processes that does not end by itself, after it has written 2 MB; and its processes."""
    process = subprocess.Popen(
        [sys.executable, '-m', 'drfmcw_sim.simulate', GANTRY, '--out', str(tmp_path / 'run'), *ENDLESS, '--jobs', '2'],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        wait_for(lambda: process.poll() or any(f.stat().st_size > 2e6 for f in tmp_path.glob('.run*/run_0.*')))
        assert process.poll() is None
        yield process, *descendants(process.pid)
    finally:  # whatever failed: it would write until the disk is full
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_recording_does_not_depend_on_the_number_of_processes(tmp_path, storage):
    """Two processes write the bytes that one writes; with a change of mode, effects and a last block of odd size."""
    overrides = (
        'pairs.0.standing.sweeps=101',
        'pairs.0.standing.distances=[100, 700]',
        'effects=[{effect: spur, station: master, frequency: 2e5, level: -60}, {effect: echo, excess_range: 3,'
        ' relative_power: -20}]',
    )
    scenario, seen = read_scenario(GANTRY, overrides), []
    for jobs in (1, 2):
        (tmp_path / str(jobs)).mkdir()
        assert write_recording(scenario, tmp_path / str(jobs) / 'run', storage, seen.append, jobs=jobs) == 202
    assert seen[: len(seen) // 2] == seen[len(seen) // 2 :]
    names = sorted(p.name for p in (tmp_path / '1' / 'run').iterdir())
    match, different, failed = filecmp.cmpfiles(tmp_path / '1' / 'run', tmp_path / '2' / 'run', names, shallow=False)
    assert (match, different, failed) == (names, [], [])


def test_interrupted_rendering_leaves_nothing(tmp_path, started):
    """Ctrl-C, which reaches every process: silent, status 130, nothing half-written, no process left."""
    process, children, workers = started
    assert len(workers) == 2
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=LIMIT)
    assert process.returncode == 130
    assert not said.strip()
    assert not list(tmp_path.iterdir())
    wait_for(lambda: not any(Path(f'/proc/{p}').exists() for p in (*children, *workers)))


def test_killed_rendering_process_is_reported_in_one_line(tmp_path, started):
    """As the kernel does when memory runs out: one line, status 2, nothing half-written."""
    process, _, workers = started
    os.kill(workers[0], signal.SIGKILL)
    _, said = process.communicate(timeout=LIMIT)
    assert process.returncode == 2
    assert len(said.strip().splitlines()) == 1
    assert 'killed by SIGKILL' in said
    assert not list(tmp_path.iterdir())


def test_rendering_processes_end_with_the_one_that_started_them(started):
    """Also when that one is killed."""
    process, children, workers = started
    process.kill()
    process.communicate(timeout=LIMIT)
    wait_for(lambda: not any(Path(f'/proc/{p}').exists() for p in (*children, *workers)))


def test_memory_does_not_grow_with_the_scenario(tmp_path, started):
    """Of a scenario far larger than memory, what waits to be written is bounded: 50 MB more recorded, none held."""
    process, _, workers = started

    def resident(pid):
        return int(Path(f'/proc/{pid}/statm').read_text().split()[1]) * os.sysconf('SC_PAGE_SIZE')

    def written(size):
        return any(f.stat().st_size > size for f in tmp_path.glob('.run*/run_0.*'))

    wait_for(lambda: written(20e6))
    before = resident(process.pid)
    os.kill(workers[0], signal.SIGSTOP)  # one that stalls must not let the other render without end
    time.sleep(1.0)
    os.kill(workers[0], signal.SIGCONT)
    wait_for(lambda: written(70e6))
    growth = resident(process.pid) - before
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=LIMIT)
    assert growth < 30e6


def test_number_of_processes_must_be_one_at_least(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        simulate.main([GANTRY, '--out', str(tmp_path / 'x'), '--jobs', '0'])
    assert ended.value.code == 2
    assert '--jobs' in capsys.readouterr().err
