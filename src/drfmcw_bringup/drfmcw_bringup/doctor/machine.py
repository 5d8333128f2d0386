"""This machine: versions, network, clock, disk, permissions."""

import ctypes
import importlib.metadata
import os
import shlex
import shutil
import socket
import struct
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.operation.security import refuse_pretence, uses_fast_dds

from ..graph import BY_PROFILE, OVER_UDP, PROFILES
from .finding import ERROR, OK, WARN, Finding

_LARGEST_SAFE_DOMAIN, _LARGEST_DOMAIN = 101, 232  # of DDS's ports: clear of Linux's ephemeral ones, and at all
_RANGES = {
    'SUBNET': 'the local network',
    'LOCALHOST': 'this machine only',
    'OFF': 'nobody',
    'SYSTEM_DEFAULT': "the middleware's default",
}
_GROUP = '239.255.0.1'  # of RTPS discovery (RTPS 2.2, 9.6.1.4.1)
_UP, _LOOPBACK, _MULTICAST = 0x1, 0x8, 0x1000  # of /sys/class/net/*/flags
_UNSYNCHRONISED = 0x40  # STA_UNSYNC of adjtimex(2)
_BUILT = 1_700_000_000  # a system clock before 2023-11-14 is wrong [s]
_LITTLE, _LEAST = 10e9, 1e9  # free space for recordings [bytes]
_SHARED = 64e6  # free space for the middleware's shared memory [bytes]


def versions(environ: Mapping[str, str]) -> Iterator[Finding]:
    """Yield what is installed, and whether it is Jazzy."""
    distribution = environ.get('ROS_DISTRO', '')
    if distribution not in ('', 'jazzy'):
        yield Finding(ERROR, 'versions', f'ROS_DISTRO is {distribution}', 'source /opt/ros/jazzy/setup.bash instead')
    names = ('ros-rclpy', 'ros-rmw-fastrtps-cpp', 'numpy', 'scipy', 'rosbags')
    found = []
    for name in names:
        try:
            found.append(f'{name} {importlib.metadata.version(name)}')
        except importlib.metadata.PackageNotFoundError:
            continue  # a system installation has no metadata of ROS's packages
    source = 'an installed Jazzy' if distribution else 'the wheels'
    yield Finding(OK, 'versions', f'Python {sys.version.split()[0]}, ROS from {source}; {", ".join(found)}')


def environment(environ: Mapping[str, str]) -> Iterator[Finding]:
    """Yield what the variables of ROS say about who finds whom."""
    yield _domain(environ.get('ROS_DOMAIN_ID', ''))
    wanted = environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', '') or 'SUBNET'
    if wanted not in _RANGES:
        valid = ', '.join(_RANGES)
        yield Finding(
            ERROR, 'range', f'ROS_AUTOMATIC_DISCOVERY_RANGE is {wanted}', f'set one of {valid}; nodes take SUBNET now'
        )
    elif wanted == 'OFF' and not environ.get('ROS_STATIC_PEERS'):
        yield Finding(WARN, 'range', 'discovery is off', 'set ROS_STATIC_PEERS, or unset ROS_AUTOMATIC_DISCOVERY_RANGE')
    else:
        yield Finding(OK, 'range', f'nodes find {_RANGES[wanted]} ({wanted})')
    if environ.get('ROS_LOCALHOST_ONLY', '') == '1':
        yield Finding(
            WARN,
            'range',
            'ROS_LOCALHOST_ONLY=1 overrides ROS_AUTOMATIC_DISCOVERY_RANGE and is deprecated',
            'unset it, and set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST',
        )
    if uses_fast_dds(environ):
        yield _transport(environ, wanted == 'LOCALHOST')
    try:
        refuse_pretence(environ)
    except ConfigurationError as error:
        yield Finding(ERROR, 'security', str(error), 'see docs/security.md')


def _transport(environ: Mapping[str, str], on_this_machine: bool) -> Finding:
    if PROFILES in environ:
        return Finding(OK, 'transport', f'as {environ[PROFILES]} has it')
    if environ.get('FASTDDS_BUILTIN_TRANSPORTS', '').startswith('UDP') and not on_this_machine:
        return Finding(OK, 'transport', 'UDP')
    needed = BY_PROFILE if on_this_machine else OVER_UDP
    return Finding(
        WARN,
        'transport',
        'shared memory: a node that is killed and started again may hear nothing',
        'export ' + ' '.join(f'{name}={shlex.quote(value)}' for name, value in needed.items()),
    )


def _domain(text: str) -> Finding:
    if not text:
        return Finding(OK, 'domain', '0, the default (ROS_DOMAIN_ID)')
    if not text.isdecimal() or int(text) > _LARGEST_DOMAIN:
        return Finding(ERROR, 'domain', f'ROS_DOMAIN_ID is {text!r}', f'set a number from 0 to {_LARGEST_SAFE_DOMAIN}')
    if int(text) > _LARGEST_SAFE_DOMAIN:
        said = f'{text}: its ports are those that Linux gives to other programs'
        return Finding(WARN, 'domain', said, f'set ROS_DOMAIN_ID to a number from 0 to {_LARGEST_SAFE_DOMAIN}')
    return Finding(OK, 'domain', f'{text} (ROS_DOMAIN_ID)')


def network(environ: Mapping[str, str]) -> Iterator[Finding]:
    """Yield which interfaces discovery can use, and whether multicast comes back on this machine."""
    usable = []
    for _, name in socket.if_nameindex():
        try:
            flags = int(Path('/sys/class/net', name, 'flags').read_text(encoding='ascii'), 16)
        except (OSError, ValueError):
            continue
        if flags & _UP and flags & _MULTICAST and not flags & _LOOPBACK:
            usable.append(name)
    local = environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', '') in ('LOCALHOST', 'OFF')
    if usable or local:
        yield Finding(OK, 'interfaces', f'up, with multicast: {", ".join(usable) or "none, and none is needed"}')
    else:
        said = 'no network interface is up and has multicast: nodes find this machine only'
        yield Finding(WARN, 'interfaces', said, 'connect the network, or ip link set dev NAME multicast on')
    reason = multicast_trouble('127.0.0.1')
    if reason:
        advice = 'ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo; or allow it in the firewall'
        yield Finding(WARN, 'multicast', f'none on the loopback interface ({reason})', advice)
    else:
        yield Finding(OK, 'multicast', 'comes back on the loopback interface')


def multicast_trouble(address: str, limit: float = 2.0) -> str:
    """Return why a datagram to the group of DDS discovery does not come back on an interface, '' where it does."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        try:
            receiver.bind(('', 0))
            membership = struct.pack('4s4s', socket.inet_aton(_GROUP), socket.inet_aton(address))
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
            receiver.settimeout(limit)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address))
            sender.sendto(b'drfmcw doctor', (_GROUP, receiver.getsockname()[1]))
            receiver.recv(64)
        except TimeoutError:
            return 'nothing came back'
        except OSError as error:
            return error.strerror or str(error)
    return ''


class _Timex(ctypes.Structure):
    """The begin of struct timex of adjtimex(2); the rest is padding."""

    _fields_ = [
        ('modes', ctypes.c_uint),
        ('offset', ctypes.c_long),
        ('freq', ctypes.c_long),
        ('maxerror', ctypes.c_long),
        ('esterror', ctypes.c_long),
        ('status', ctypes.c_int),
        ('rest', ctypes.c_char * 256),
    ]


def clock(environ: Mapping[str, str]) -> Iterator[Finding]:
    """Yield whether the system clock is plausible, and follows a time server."""
    if time.time() < _BUILT:
        said = f'it is {time.strftime("%Y-%m-%d %H:%M")} by the system clock'
        yield Finding(ERROR, 'clock', said, 'set it: timedatectl set-ntp true')
        return
    state = _Timex()
    call = getattr(ctypes.CDLL(None), 'adjtimex', None)
    if call is None or call(ctypes.byref(state)) < 0:
        yield Finding(WARN, 'clock', 'the kernel does not say whether it follows a time server', 'ask: timedatectl')
    elif state.status & _UNSYNCHRONISED:
        said = 'the system clock follows no time server; stamps of two computers drift apart'
        yield Finding(WARN, 'clock', said, 'apt install chrony, or timedatectl set-ntp true')
    else:
        yield Finding(OK, 'clock', f'follows a time server, at most {state.maxerror * 1e-3:.0f} ms off')


def storage(environ: Mapping[str, str]) -> Iterator[Finding]:
    """Yield free space and permissions where recordings, logs and shared memory go."""
    yield _folder('recordings', Path.cwd(), _LITTLE, _LEAST)
    home = Path(environ.get('ROS_HOME') or Path(environ.get('HOME') or '/', '.ros'))
    yield _folder('logs', Path(environ.get('ROS_LOG_DIR') or home / 'log'), _LEAST, 1e8)
    shared = Path('/dev/shm')
    if shared.is_dir():
        yield _folder('shared memory', shared, _SHARED, 1e6)
        foreign = [p for p in shared.glob('fastrtps_*') if not os.access(p, os.W_OK)]
        if foreign:
            said = f"{len(foreign)} files of another user's nodes lie in /dev/shm"
            yield Finding(WARN, 'shared memory', said, 'run all nodes as one user, or give them different domains')


def _folder(subject: str, folder: Path, little: float, least: float) -> Finding:
    there = next(p for p in (folder, *folder.parents) if p.exists())
    free = shutil.disk_usage(there).free
    said = f'{free / 1e9:.1f} GB free in {folder}'
    if not os.access(there, os.W_OK):
        return Finding(ERROR, subject, f'{folder} cannot be written', f'chown it: sudo chown $USER {there}')
    if free < little:
        return Finding(ERROR if free < least else WARN, subject, said, f'free space: du -sh {there}/* | sort -h')
    return Finding(OK, subject, said)


CHECKS = (versions, environment, network, clock, storage)
"""Each takes the environment's variables and yields findings."""
