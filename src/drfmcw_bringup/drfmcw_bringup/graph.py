"""The processes of a graph: started by name, watched, restarted where they die, stopped cleanly."""

import collections
import dataclasses
import fcntl
import os
import random
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.operation.security import uses_fast_dds
from drfmcw_ros.work import children

SIMULATOR, STATION, FUSION = 'drfmcw_sim.simulator', 'drfmcw_node.station', 'drfmcw_fusion.fusion'
PAIR_STATION, RECORDER, REPLAY = 'drfmcw_node.pair_station', 'drfmcw_ros.bag.record', 'drfmcw_fusion.replay'
GATEWAY, FOLLOWER = 'drfmcw_gateway.gateway', 'drfmcw_gateway.follow_range'
FRAMES = 'drfmcw_fusion.crane.frames'
HOST, WATCH = 'drfmcw_host.host', 'drfmcw_diagnosis.live.node'
"""Modules that run as processes."""

_STOP_LIMIT = 20.0  # for a clean end after SIGINT; a recorder may have much to write [s]
_REPEAT = 3.0  # of SIGINT, to who has not ended [s]
_FIRST_DELAY, _LONGEST_DELAY = 0.5, 30.0  # before a restart [s]
_STABLE = 60.0  # after which a process that dies is restarted as if for the first time [s]
WRONG_CONFIGURATION = 2
"""Exit status of a process that need not be started again."""
ON_THIS_MACHINE = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
"""Variables with which any node finds those on this machine, and no others."""
PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
"""Variable that names a profile of Fast DDS."""
BY_PROFILE = {
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SYSTEM_DEFAULT',
    PROFILES: str(Path(__file__).with_name('one_machine.xml')),
}
"""The same, without shared memory: through it, a process that was killed and started again may hear nothing."""
OVER_UDP = {'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}
"""Variables that keep Fast DDS from shared memory where nodes find others on several machines."""
_LARGEST_DOMAIN = 101  # that stays clear of the ephemeral ports on Linux
_DISCOVERY_PORT, _DOMAIN_GAIN = 7400, 250  # of DDS (RTPS 2.2, 9.6.1.1)
_PARTICIPANTS = 32  # of a domain that are looked for: as many as discovery on localhost asks for
_RESERVED = 8  # domains of this process at a time: each is one only while its participants start
_reserved: collections.deque[int] = collections.deque()  # file descriptors of their locks


def free_domain_id() -> int:
    """Return a ROS domain in which nobody on this machine discovers, and reserve it while its participants start.

    That of the environment is left to those who start there later.

    Raises:
        ConfigurationError: all are taken.
    """
    for domain in random.sample(range(1, _LARGEST_DOMAIN + 1), _LARGEST_DOMAIN):
        lock = None if str(domain) == os.environ.get('ROS_DOMAIN_ID') else _lock(domain)
        if lock is None:
            continue
        if _is_quiet(domain):
            if len(_reserved) == _RESERVED:
                os.close(_reserved.popleft())
            _reserved.append(lock)
            return domain
        os.close(lock)
    raise ConfigurationError('no ROS domain is free on this machine')


def _is_quiet(domain: int) -> bool:
    """Return whether no participant of a domain runs here: each has a unicast port, the lowest that was free then.

    The first one may have ended while others go on, so that its port alone does not say.
    """
    first = _DISCOVERY_PORT + _DOMAIN_GAIN * domain + 10
    try:
        for participant in range(_PARTICIPANTS):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind(('', first + 2 * participant))
    except OSError:
        return False
    return True


def _lock(domain: int) -> int | None:
    """Return the descriptor of a locked file that stands for a domain, None where another process has locked it."""
    path = Path(tempfile.gettempdir()) / f'drfmcw-{os.getuid()}-domain-{domain}'
    file = os.open(path, os.O_WRONLY | os.O_CREAT, 0o600)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        return None
    return file


def private_environment() -> dict[str, str]:
    """Return this process's environment with a ROS domain of its own, discovered on this machine only.

    By our profile of Fast DDS, unless the environment names another one.
    """
    environment = os.environ | {'ROS_DOMAIN_ID': str(free_domain_id())}
    by_ours = uses_fast_dds(environment) and environment.get(PROFILES) in (None, BY_PROFILE[PROFILES])
    return environment | (BY_PROFILE if by_ours else ON_THIS_MACHINE)


def parameters(values: Mapping[str, object], file: Path | None = None) -> list[str]:
    """Return the ROS arguments that set parameters to those of a file, and to `values` (strings, numbers, booleans)."""
    arguments = ['--ros-args', *(('--params-file', str(file)) if file is not None else ())]
    for name, value in values.items():
        text = (
            str(value).lower() if isinstance(value, bool) else repr(value) if isinstance(value, float) else str(value)
        )
        arguments += ['-p', f'{name}:={text}']
    return arguments


def _ends(process: subprocess.Popen[bytes], seconds: float) -> bool:
    """Return whether a process ends within so many seconds."""
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        return False
    return True


def _interrupt(signum: int, frame: object) -> None:
    raise KeyboardInterrupt


@dataclasses.dataclass
class Member:
    """One process of a graph."""

    name: str
    command: list[str]
    process: subprocess.Popen[bytes]
    log: IO[str] | None
    keep_alive: bool
    optional: bool = False  # the graph goes on without it
    restarts: int = 0
    started: float = dataclasses.field(default_factory=time.monotonic)  # [s]
    delay: float = 0.0  # before the next restart, while it dies again and again [s]
    due: float | None = None  # when it is started again, None while it runs [s]

    @property
    def final(self) -> bool:
        """Return whether the process, which has ended, stays so: status 2 says that its configuration is wrong."""
        if not self.keep_alive:
            return True
        return self.process.returncode == WRONG_CONFIGURATION and not (self.optional and self.restarts)


class Graph:
    """Starts processes and sees them through to a clean end; a context manager that stops all it started."""

    def __init__(self, environment: Mapping[str, str] | None = None, log_directory: Path | None = None) -> None:
        """Start with no process.

        Args:
            environment: of the processes; None takes this process's own.
            log_directory: where each process's output goes, one file a process; None shows it.
        """
        self.environment = dict(os.environ if environment is None else environment)
        self._log_directory = log_directory
        self.members: dict[str, Member] = {}

    def start(
        self, name: str, module: str, *arguments: str, keep_alive: bool = False, optional: bool = False
    ) -> Member:
        """Start `python -m module arguments` under a name.

        With `keep_alive` it is restarted when it dies, after a delay that doubles from 0.5 s to 30 s while it dies
        again at once. It ends for good with status 2, a wrong configuration. `optional`: that matters at its first
        start only; what fails later (a recorder's disk is gone) is tried again.
        """
        log = None
        if self._log_directory is not None:
            self._log_directory.mkdir(parents=True, exist_ok=True)
            log = open(self._log_directory / f'{name}.log', 'w', encoding='utf-8')  # noqa: SIM115 closed in stop()
        command = children.command(module, *arguments)
        member = Member(name, command, self._spawn(command, log), log, keep_alive, optional)
        self.members[name] = member
        return member

    def _spawn(self, command: Sequence[str], log: IO[str] | None) -> subprocess.Popen[bytes]:
        # a group of its own: Ctrl-C reaches this process alone, which then stops the others in order
        return subprocess.Popen(
            command,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT if log else None,
            start_new_session=True,
            preexec_fn=children.prepare,
        )

    def tend(self) -> list[Member]:
        """Restart what died and shall live, when it is due; return the members that have ended for good."""
        now, ended = time.monotonic(), []
        for member in self.members.values():
            if member.process.poll() is None:
                continue
            if member.final:
                ended.append(member)
            elif member.due is None:
                stable = now - member.started > _STABLE
                member.delay = _FIRST_DELAY if stable or not member.delay else min(2.0 * member.delay, _LONGEST_DELAY)
                member.due = now + member.delay
            elif now >= member.due:
                member.process = self._spawn(member.command, member.log)
                member.restarts += 1
                member.started, member.due = now, None
        return ended

    def stop(self, *names: str) -> None:
        """Stop the named members (all without names): SIGINT in order of start, again after a while, then force."""
        chosen = [self.members.pop(n) for n in names or list(self.members) if n in self.members]
        for member in chosen:
            if member.process.poll() is None:
                member.process.send_signal(signal.SIGINT)
        end = time.monotonic() + _STOP_LIMIT
        for member in chosen:
            while not _ends(member.process, _REPEAT) and time.monotonic() < end:
                member.process.send_signal(signal.SIGINT)  # whoever heard the first one ignores it
            if not _ends(member.process, 0.1):
                member.process.kill()
                member.process.wait()
            if member.log is not None:
                member.log.close()

    def last_words(self, member: Member) -> str:
        """Return the last line that a member wrote to its log, '' where it shows its output."""
        if member.log is None:
            return ''
        lines = Path(member.log.name).read_text(encoding='utf-8', errors='replace').strip().splitlines()
        return lines[-1] if lines else ''

    def __enter__(self) -> 'Graph':
        """Return itself; from here on SIGTERM ends this process in order, like Ctrl-C."""
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, _interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        """Stop everything."""
        self.stop()
