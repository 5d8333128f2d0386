"""Sockets at which the sources `tcp` and `udp` listen."""

import dataclasses
import socket

from drfmcw_physics.settings import ConfigurationError, parameter


@dataclasses.dataclass(frozen=True)
class SocketSettings:
    """Where a source listens for the digitiser."""

    ip_address: str = parameter('127.0.0.1', structural=True, description='address at which sources tcp and udp listen')
    ip_port: int = parameter(
        9000, structural=True, bounds=(0, 65535), description='port at which sources tcp and udp listen; 0: any'
    )


def listening_socket(kind: int, settings: SocketSettings) -> socket.socket:
    """Return a socket of `kind` (socket.SOCK_STREAM or SOCK_DGRAM) bound to the address and port.

    Raises:
        ConfigurationError: the address cannot be used.
    """
    family = socket.AF_INET6 if ':' in settings.ip_address else socket.AF_INET
    made = socket.socket(family, kind)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((settings.ip_address, settings.ip_port))
    except (OSError, OverflowError) as error:
        made.close()
        raise ConfigurationError(f'ip_address {settings.ip_address}, ip_port {settings.ip_port}: {error}') from None
    return made
