"""`drfmcw keystore`: SROS2 policy and keystore of a site's nodes, where the middleware has security."""

import argparse
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from drfmcw_physics.settings import ConfigurationError

from ..commands.cli import Parser, guarded, write_atomically
from .security import fast_dds_is_secure, policy, rights

_PAIR = re.compile(r'([A-Za-z_]\w*)/([A-Za-z_]\w*)', re.ASCII)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status."""
    parser = Parser(prog='drfmcw keystore', description=__doc__)
    parser.add_argument('directory', type=Path, help='keystore to make; policy.xml is written into it')
    parser.add_argument(
        '--pair', action='append', metavar='FIRST/SECOND', help='pair of stations (repeatable; master/slave)'
    )
    parser.add_argument('--feed', action='store_true', help='digitisers feed the stations, which own their sweeps')
    parser.add_argument('--policy-only', action='store_true', help='write the policy, for another machine')
    arguments = parser.parse_args(argv)
    return guarded(parser.prog, lambda: _make(arguments))


def _make(arguments: argparse.Namespace) -> None:
    pairs = []
    for text in arguments.pair or ['master/slave']:
        found = _PAIR.fullmatch(text)
        if found is None:
            raise ConfigurationError(f"--pair '{text}' is not FIRST/SECOND: letters, digits and _, no digit first")
        pairs.append((found[1], found[2]))
    nodes = rights(pairs, arguments.feed)
    if not arguments.policy_only:
        if fast_dds_is_secure(os.environ) is False:
            raise ConfigurationError(
                'this Fast DDS was built without security: a keystore would protect nothing. Use an installed '
                'ROS 2 Jazzy, or --policy-only (docs/security.md)'
            )
        if shutil.which('ros2') is None:
            raise ConfigurationError("no command 'ros2': install ros-jazzy-sros2 and source its setup.bash")
    try:
        arguments.directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f'{arguments.directory}: {error.strerror}') from None
    path = arguments.directory / 'policy.xml'
    write_atomically(path, policy(nodes))
    print(f'{path}: {", ".join(node.enclave for node in nodes)}')
    if arguments.policy_only:
        return
    store = str(arguments.directory)
    enclaves = [node.enclave for node in nodes]
    for command in (['create_keystore', store], ['generate_artifacts', '-k', store, '-p', str(path), '-e', *enclaves]):
        done = subprocess.run(['ros2', 'security', *command], capture_output=True, text=True, check=False)
        if done.returncode:
            said = (done.stderr or done.stdout).strip().splitlines()[-1:]
            raise ConfigurationError(f'ros2 security {command[0]}: {" ".join(said) or done.returncode}')
    print(f'export ROS_SECURITY_KEYSTORE={store} ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce')


if __name__ == '__main__':
    sys.exit(main())
