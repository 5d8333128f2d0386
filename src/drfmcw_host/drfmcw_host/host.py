"""`host`: serve a web page that shows the running graph, configures its nodes and handles recordings."""

import dataclasses
import getpass
import ipaddress
import os
import socket
import ssl
import sys
import threading
import time
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.calibration.store import CalibrationStore, state_directory
from drfmcw_ros.commands.cli import Parser, guarded, split_ros_arguments
from drfmcw_ros.commands.versions import release, running
from drfmcw_ros.nodes.runner import run

from .access.attempts import Attempts
from .access.audit import Audit
from .access.passwords import Passwords
from .access.sessions import Sessions
from .configure.calibration import RemoteCalibrations
from .configure.remote import RemoteParameters
from .files.calibrations import Calibrations
from .files.findings import Findings
from .files.recordings import Recordings
from .files.work import Work
from .node import HostNode
from .state.store import Store

PORT = 8400
_NICENESS = 5  # over that of the graph: a page waits for a range, not a range for a page
_START_LIMIT = 20.0  # of the server [s]
_STOP_LIMIT = 5.0  # [s]


@dataclasses.dataclass(frozen=True)
class Settings:
    """How the pages are served."""

    bind: str
    port: int
    names: tuple[str, ...]
    state: Path
    recordings: Path
    findings: Path
    read_only: bool
    certificate: Path | None
    key: Path | None

    @property
    def secure(self) -> bool:
        """Whether TLS is used."""
        return self.certificate is not None

    @property
    def url(self) -> str:
        """The address to open in a browser."""
        name = f'[{self.bind}]' if ':' in self.bind else self.bind
        return f'{"https" if self.secure else "http"}://{name}:{self.port}/'


def default_state() -> Path:
    """Return where the host keeps its state by default: a folder of systemd's state directory, else the user's."""
    directory = state_directory(os.environ)
    return directory / 'host' if os.environ.get('STATE_DIRECTORY') else directory


def is_loopback(address: str) -> bool:
    """Return whether an address can be reached from this machine only."""
    if address == 'localhost':
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def check(settings: Settings, passwords: Passwords) -> None:
    """Refuse settings that would let others in unasked, or cannot be served.

    Raises:
        ConfigurationError: with the reason.
    """
    known = bool(passwords.users())
    if not is_loopback(settings.bind) and not known and not settings.read_only:
        raise ConfigurationError(
            f'--bind {settings.bind} lets other computers in, but no user has a password: '
            'run ./drfmcw host --set-password USER, or give --read-only'
        )
    if not 0 <= settings.port <= 65_535:
        raise ConfigurationError(f'--port {settings.port}: is no port')
    if (settings.certificate is None) != (settings.key is None):
        raise ConfigurationError('--tls-cert and --tls-key belong together')
    if settings.certificate is not None:
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(settings.certificate, settings.key)
        except OSError as error:
            reason = error.strerror or error.args[-1]
            raise ConfigurationError(f'{settings.certificate}, {settings.key}: {reason}') from None


def set_password(passwords: Passwords, user: str) -> None:
    """Ask for a user's new password, twice, or read it from a pipe.

    Raises:
        ConfigurationError: they differ, or name or password are not acceptable.
    """
    if sys.stdin.isatty():
        password = getpass.getpass(f'password of {user}: ')
        if getpass.getpass('again: ') != password:
            raise ConfigurationError('the passwords differ')
    else:
        password = sys.stdin.readline().rstrip('\n')
    passwords.set(user, password)
    print(f'{passwords.path}: password of {user} set')


def version() -> str:
    """Return what runs here, for the page."""
    found = {'drfmcw': release()} | running() | {'nicegui': metadata.version('nicegui')}
    return ' · '.join(f'{name} {value}' for name, value in found.items())


def listening(bind: str, port: int) -> socket.socket:
    """Return a socket that listens.

    Raises:
        ConfigurationError: the address is not of this machine, or taken.
    """
    try:
        family = socket.getaddrinfo(bind, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((bind, port), family=family, backlog=128)
    except (OSError, OverflowError) as error:
        raise ConfigurationError(f'--bind {bind} --port {port}: {getattr(error, "strerror", None) or error}') from None


def serving(
    settings: Settings, passwords: Passwords, store: Store, calibrations: Calibrations
) -> Callable[[HostNode], Callable[[], None]]:
    """Return the function that starts the pages beside a node, and returns what ends them."""
    os.environ['NICEGUI_STORAGE_PATH'] = str(settings.state / 'nicegui')  # nothing is written there, or elsewhere
    import uvicorn  # here, so that --help and --set-password do not wait for them

    from .web.app import application, fingerprint
    from .web.frame import STATIC, Host

    sessions = Sessions(settings.state, passwords)
    audit = Audit(settings.state / 'audit.jsonl')
    recordings = Recordings(settings.recordings)
    work = Work(recordings)
    heard = listening(settings.bind, settings.port)

    def start(node: HostNode) -> Callable[[], None]:
        host = Host(
            store,
            passwords,
            sessions,
            Attempts(),
            audit,
            recordings,
            work,
            RemoteParameters(node),
            calibrations,
            RemoteCalibrations(node),
            Findings(settings.findings),
            settings.state,
            settings.read_only,
            settings.secure,
            version(),
            fingerprint(STATIC),
        )
        names = (*settings.names, settings.bind)
        config = uvicorn.Config(
            application(host, names),
            log_level='warning',
            access_log=False,
            server_header=False,
            proxy_headers=False,
            ws_max_size=1_000_000,
            timeout_graceful_shutdown=1,
            ssl_certfile=settings.certificate,
            ssl_keyfile=settings.key,
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={'sockets': [heard]}, daemon=True)
        thread.start()
        _wait_for(server, thread)
        audit.write('', '', 'start', url=settings.url, read_only=settings.read_only)
        print(f'host: {settings.url}', flush=True)

        def end() -> None:
            server.should_exit = True
            thread.join(_STOP_LIMIT)
            work.close()
            audit.write('', '', 'end')

        return end

    return start


def _wait_for(server: Any, thread: threading.Thread) -> None:
    """Wait until the server answers.

    Raises:
        ConfigurationError: it does not.
    """
    end = time.monotonic() + _START_LIMIT
    while not server.started:
        if not thread.is_alive() or time.monotonic() > end:
            raise ConfigurationError('the page cannot be served; see above')
        time.sleep(0.01)


def parser() -> Parser:
    """Return the command line."""
    options = Parser(prog='drfmcw host', description=__doc__)
    options.add_argument('--bind', default='127.0.0.1', metavar='ADDRESS', help='address to serve (127.0.0.1)')
    options.add_argument('--port', type=int, default=PORT, metavar='N', help=f'port to serve ({PORT}); 0: a free one')
    options.add_argument('--name', action='append', default=[], help='further host name to answer to (repeatable)')
    options.add_argument('--state', type=Path, metavar='DIR', help='passwords, secret, audit log, parameter files')
    options.add_argument('--recordings', type=Path, metavar='DIR', help='recordings (STATE/recordings)')
    options.add_argument('--findings', type=Path, metavar='DIR', help='of `watch --findings` (STATE/findings)')
    options.add_argument('--read-only', action='store_true', help='nobody can log in or change anything')
    options.add_argument('--tls-cert', type=Path, metavar='FILE', help='serve by TLS with this certificate (PEM)')
    options.add_argument('--tls-key', type=Path, metavar='FILE', help='and this key (PEM)')
    options.add_argument('--set-password', metavar='USER', help='ask for the password of a user, store its hash, end')
    options.epilog = 'Without --set-password nobody can log in: the page only shows. docs/host.md'
    return options


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    own, ros = split_ros_arguments(argv)
    arguments = parser().parse_args(own)

    def work() -> int:
        state = (arguments.state or default_state()).resolve()
        passwords = Passwords(state / 'passwords.json')
        if arguments.set_password is not None:
            set_password(passwords, arguments.set_password)
            return 0
        port = arguments.port
        if port == 0:
            with listening(arguments.bind, 0) as probe:
                port = probe.getsockname()[1]
        settings = Settings(
            arguments.bind,
            port,
            tuple(arguments.name),
            state,
            (arguments.recordings or state / 'recordings').resolve(),
            (arguments.findings or state / 'findings').resolve(),
            arguments.read_only,
            arguments.tls_cert,
            arguments.tls_key,
        )
        check(settings, passwords)
        store = Store(software=running())
        calibrations = Calibrations(state / 'calibrations', CalibrationStore(state_directory(os.environ)))
        start = serving(settings, passwords, store, calibrations)
        os.nice(_NICENESS)  # before threads start, which inherit it
        return run(HostNode, ros, store=store, calibrations=calibrations, on_ready=start)

    return guarded('drfmcw host', work)


if __name__ == '__main__':
    sys.exit(main())
