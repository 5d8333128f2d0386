"""Commands that the documents print in fenced blocks, and how a test executes them as printed."""

import ast
import contextlib
import dataclasses
import fcntl
import itertools
import os
import re
import runpy
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import launch_stub
from checkout import ROOT

EXTENDING = ROOT / 'docs' / 'extending.md'
DOCUMENTS = sorted({ROOT / 'README.md', *ROOT.glob('docs/*.md'), *ROOT.glob('src/*/README.md')} - {EXTENDING})
SUBCOMMANDS = {name: target for name, (target, _) in runpy.run_path(str(ROOT / 'drfmcw'))['SUBCOMMANDS'].items()}
LIMIT = 120.0  # for a command to end, or to be ready, on a busy machine [s]
STOP_LIMIT = 25.0  # for all processes of a command to end after SIGINT [s]
_PROGRAMS = 'colcon|cp|export|git|mkdir|python3(\\.\\d+)?|ros2|rosdep|systemctl|umask|useradd'
_COMMAND = re.compile(rf'(\./drfmcw|\.venv/bin/python|({_PROGRAMS})\b)')
_BLOCK = re.compile(r'^```(?P<language>\w*)\n(?P<text>.*?)^```$', re.DOTALL | re.MULTILINE)
_LOCK = Path(tempfile.gettempdir()) / f'drfmcw-{os.getuid()}-ports'  # documented commands listen at fixed ports


@dataclasses.dataclass(frozen=True)
class Command:
    """One command of a document."""

    place: str  # document:line
    text: str  # as printed, without comment; what may be left out is

    @property
    def written(self) -> set[str]:
        """Names of what it writes, which must not be there before."""
        words = shlex.split(self.text)
        options = (b for a, b in itertools.pairwise(words) if a in ('--out', '--keep', '--json', '--plot'))
        recorded = re.findall(r'\./drfmcw record (\S+)|survey (\S+) --live|--record (\S+)', self.text)
        return {name for names in recorded for name in names if name} | set(options)


def commands() -> Iterator[Command]:
    """Yield every command in a fenced block, each once; docs/extending.md has a test of its own.

    Raises:
        ValueError: a block holds commands and other lines.
    """
    known: set[str] = set()
    for document in DOCUMENTS:
        content = document.read_text(encoding='utf-8')
        for block in _BLOCK.finditer(content):
            text = block['text'].replace('\\\n', ' ' * 2)
            lines = [line for line in text.splitlines() if line.strip()]
            if block['language'] not in ('', 'sh') or not any(map(_COMMAND.match, lines)):
                continue
            for line in lines:
                place = f'{document.relative_to(ROOT)}:{content[: block.start()].count(chr(10)) + 2}'
                if not _COMMAND.match(line):
                    raise ValueError(f"{place}: '{line}' is no command that tests know")
                bare = re.sub(r'\s\[.*?\](?=\s|$)', '', re.sub(r'\s#.*', '', line))
                text = ' '.join(bare.split())
                if text not in known:
                    known.add(text)
                    yield Command(place, text)


def module_of(package: str, executable: str) -> str:
    """Return the module that `ros2 run` starts, by the package's setup.py."""
    tree = ast.parse((ROOT / 'src' / package / 'setup.py').read_text(encoding='utf-8'))
    texts = (n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str))
    found = dict(match.groups() for text in texts if (match := re.fullmatch(r'(\w+) = ([\w.]+):main', text)))
    return found[executable]


def processes(text: str, directory: Path) -> list[list[str]]:
    """Return the processes of a command: several of `ros2 launch` where there is no ros2; files go to `directory`."""
    words = shlex.split(text)
    if words[0] == './drfmcw':
        return [[sys.executable, '-m', SUBCOMMANDS[words[1]], *words[2:]]]
    if words[:2] == ['ros2', 'run'] and not shutil.which('ros2'):
        return [[sys.executable, '-m', module_of(*words[2:4]), *words[4:]]]
    if words[:2] == ['ros2', 'launch'] and not shutil.which('ros2'):
        nodes = launch_stub.nodes(ROOT / 'src' / words[2] / 'launch' / words[3], *words[4:])
        called = ((module_of(node.package, node.executable), node) for node in nodes)
        return [[sys.executable, '-m', module, *node.command_line(directory)] for module, node in called]
    if words[0] == 'ros2':
        return [words]
    return [['sh', '-c', text.replace('.venv/bin/python', sys.executable)]]


@dataclasses.dataclass
class Running:
    """The processes of a command, and what they print."""

    command: str
    processes: list[subprocess.Popen[bytes]]
    output: Path
    ready: socket.socket

    def said(self) -> str:
        return f'{self.command}\n{self.output.read_text(encoding="utf-8", errors="replace")}'

    def wait_until_ready(self) -> None:
        """Wait until as many processes as were started say READY=1, as to systemd, and one second longer."""
        end, count = time.monotonic() + LIMIT, 0
        self.ready.settimeout(0.1)
        while count < len(self.processes):
            with contextlib.suppress(TimeoutError):
                count += b'READY=1' in self.ready.recv(4096)
            assert all(p.poll() is None for p in self.processes), f'ended before it was ready: {self.said()}'
            assert time.monotonic() < end, f'is not ready: {self.said()}'
        time.sleep(1.0)
        assert all(p.poll() is None for p in self.processes), f'ended without being asked to: {self.said()}'

    def wait(self, limit: float) -> list[int]:
        """Wait for the end; return the statuses."""
        end = time.monotonic() + limit
        try:
            return [process.wait(max(0.1, end - time.monotonic())) for process in self.processes]
        except subprocess.TimeoutExpired:
            self._say_where()
            raise AssertionError(f'still runs after {limit:g} s: {self.said()}') from None

    def _say_where(self) -> None:
        """Let every process that still runs, and its children before it, print where its threads are, and end."""
        for process in self.processes:
            if process.poll() is None:
                children = Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text(encoding='ascii').split()
                for pid in (*map(int, children), process.pid):
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGABRT)
                process.wait()

    def interrupt(self) -> list[int]:
        """Press Ctrl-C; return the statuses."""
        for process in self.processes:
            process.send_signal(signal.SIGINT)
        return self.wait(STOP_LIMIT)


@contextlib.contextmanager
def started(text: str, directory: Path, environment: Mapping[str, str]) -> Iterator[Running]:
    """Start a command in a directory; what still runs afterwards is killed."""
    with (
        tempfile.TemporaryDirectory(prefix='drfmcw-') as short,  # names of sockets are short
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ready,
        open(directory / '.output', 'wb') as output,
    ):
        ready.bind(f'{short}/ready')
        given = {**environment, 'NOTIFY_SOCKET': f'{short}/ready', 'PYTHONFAULTHANDLER': '1'}
        opened = [
            subprocess.Popen(call, cwd=directory, env=given, stdin=subprocess.DEVNULL, stdout=output, stderr=output)
            for call in processes(text, Path(short))
        ]
        try:
            yield Running(text, opened, directory / '.output', ready)
        finally:
            for process in opened:
                if process.poll() is None:
                    process.kill()
                process.wait()


@contextlib.contextmanager
def fixed_ports() -> Iterator[None]:
    """Let no other test run on this machine execute a command that listens at a documented port."""
    with open(_LOCK, 'w') as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def matching(text: str, patterns: Mapping[str, object] | Sequence[str]) -> str | None:
    """Return the first of some patterns that is found in a command."""
    return next((pattern for pattern in patterns if re.search(pattern, text)), None)
