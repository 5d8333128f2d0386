"""Sockets that the feed's sources listen at."""

import socket

from drfmcw_physics.settings import ConfigurationError


def bound(kind: int, address: str, port: int) -> socket.socket:
    """Return a socket of `kind` bound to an address.

    Raises:
        ConfigurationError: the address cannot be used.
    """
    family = socket.AF_INET6 if ':' in address else socket.AF_INET
    made = socket.socket(family, kind)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((address, port))
    except (OSError, OverflowError) as error:
        made.close()
        raise ConfigurationError(f'ip_address {address}, ip_port {port}: {error}') from None
    return made
