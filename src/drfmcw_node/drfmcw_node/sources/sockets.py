"""Sockets at which the sources `tcp` and `udp` listen, and who may send to them."""

import dataclasses
import ipaddress
import socket
import ssl

from drfmcw_physics.settings import ConfigurationError, parameter

Network = ipaddress.IPv4Network | ipaddress.IPv6Network


@dataclasses.dataclass(frozen=True)
class SocketSettings:
    """Where a source listens for the digitiser, and whom it believes."""

    ip_address: str = parameter('127.0.0.1', structural=True, description='address at which sources tcp and udp listen')
    ip_port: int = parameter(
        9000, structural=True, bounds=(0, 65535), description='port at which sources tcp and udp listen; 0: any'
    )
    feed_from: str = parameter(
        '',
        structural=True,
        description='addresses or networks (10.0.0.0/24), separated by commas, that are heard; empty: any',
    )
    feed_key: str = parameter(
        '', structural=True, description='file with the key that the digitiser shares (docs/security.md); empty: none'
    )
    feed_samples: int = parameter(
        1 << 20, structural=True, bounds=(16, 1 << 25), description='largest number of int16 values in a frame'
    )
    feed_timeout: float = parameter(
        5.0,
        unit='s',
        structural=True,
        bounds=(0.1, 600.0),
        description='for a handshake, or a frame that has begun; then a TCP client is disconnected',
    )
    tls_certificate: str = parameter(
        '', structural=True, description='file with the certificate chain of source tcp (PEM); empty: no TLS'
    )
    tls_key: str = parameter('', structural=True, description='file with the private key of that certificate (PEM)')
    tls_clients: str = parameter(
        '',
        structural=True,
        description='file with the authorities whose certificates a digitiser must show (PEM); empty: any digitiser',
    )

    def __post_init__(self) -> None:
        """Refuse networks that are none, and TLS settings that lack their certificate."""
        networks(self.feed_from)
        if bool(self.tls_certificate) != bool(self.tls_key) or (self.tls_clients and not self.tls_certificate):
            raise ConfigurationError('tls_certificate and tls_key go together, and tls_clients needs both')

    def refuse_tls(self) -> None:
        """Raise ConfigurationError where TLS is asked for."""
        if self.tls_certificate:
            raise ConfigurationError('tls_certificate: TLS needs source tcp; source udp takes feed_key')

    @property
    def is_local(self) -> bool:
        """Whether the socket is for this machine alone."""
        try:
            return ipaddress.ip_address(self.ip_address).is_loopback
        except ValueError:
            return self.ip_address == 'localhost'

    @property
    def authenticates(self) -> bool:
        """Whether a digitiser has to show that it is one."""
        return bool(self.feed_key or self.tls_clients)


def networks(listed: str) -> tuple[Network, ...]:
    """Return the networks in a list separated by commas; raises ConfigurationError for what is none."""
    try:
        return tuple(ipaddress.ip_network(name.strip()) for name in listed.split(',') if name.strip())
    except ValueError as error:
        raise ConfigurationError(f'feed_from: {error}') from None


def is_heard(host: str, allowed: tuple[Network, ...]) -> bool:
    """Return whether a sender's address is in one of the networks; every one is where there are none."""
    if not allowed:
        return True
    address = ipaddress.ip_address(host.partition('%')[0])
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is not None:
        address = address.ipv4_mapped
    return any(address in network for network in allowed)


def caution(settings: SocketSettings) -> str:
    """Return what is unsafe about the settings, '' for nothing."""
    if settings.is_local or settings.authenticates:
        return ''
    return f'{settings.ip_address} takes sweeps from anyone who can reach it: set feed_key (docs/security.md)'


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


def tls_context(settings: SocketSettings) -> ssl.SSLContext | None:
    """Return what source tcp needs for TLS, None where it is not wanted.

    Raises:
        ConfigurationError: a file is not readable, or is no certificate or key.
    """
    if not settings.tls_certificate:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    name = 'tls_certificate, tls_key'
    try:
        context.load_cert_chain(settings.tls_certificate, settings.tls_key, password=_no_password)
        name = 'tls_clients'
        if settings.tls_clients:
            context.load_verify_locations(settings.tls_clients)
            context.verify_mode = ssl.CERT_REQUIRED
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        raise ConfigurationError(f'{name}: {error}') from None
    return context


def _no_password() -> str:
    raise ValueError('the private key is encrypted')
