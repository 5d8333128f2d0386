"""Settings of the gateway, and what must be given before it listens to a network."""

import dataclasses
import ipaddress
import math

from drfmcw_physics.settings import ConfigurationError, parameter

LARGEST_PAIR_COUNT = 64
"""Blocks that the register map has addresses for."""


@dataclasses.dataclass(frozen=True)
class GatewaySettings:
    """Which ranges are served, when they count as lost, and who may read them."""

    pairs: list[str] = parameter(
        ['master/slave'],
        description="pairs of stations as 'first/second', in the order of their blocks",
        structural=True,
    )
    timeout: float = parameter(
        0.2, unit='s', bounds=(0.02, 60.0), description='without a range, after which it is signalled as stale'
    )
    age_limit: float = parameter(
        1.0,
        unit='s',
        bounds=(0.02, 1e6),
        nan_means='stamps are not compared with the clock',
        description='difference of a stamp from the clock beyond which a range counts as stale',
    )
    lost_time: float = parameter(
        2.0, unit='s', bounds=(0.02, 1e6), description='without a range, after which OPC UA gives no value'
    )
    controller_timeout: float = parameter(
        math.nan,
        unit='s',
        bounds=(0.02, 1e6),
        nan_means='no controller is expected to write',
        description="without a change of the controller's heartbeat, after which the controller counts as silent",
    )
    opcua: bool = parameter(True, description='serve OPC UA', structural=True)
    opcua_address: str = parameter(
        '127.0.0.1',
        description='local address; any but a loopback one needs certificate, key and clients',
        structural=True,
    )
    opcua_port: int = parameter(4840, bounds=(1, 65535), description='TCP port of OPC UA', structural=True)
    certificate: str = parameter('', description="file of the server's certificate (DER or PEM)", structural=True)
    key: str = parameter('', description="file of the certificate's private key (PEM)", structural=True)
    clients: str = parameter(
        '', description='directory with the certificates of the OPC UA clients that may connect', structural=True
    )
    modbus: bool = parameter(True, description='serve Modbus TCP', structural=True)
    modbus_address: str = parameter('127.0.0.1', description='local address of the Modbus server', structural=True)
    modbus_port: int = parameter(
        1502, bounds=(1, 65535), description='TCP port; 502, the usual one, needs privileges', structural=True
    )
    modbus_from: str = parameter(
        '',
        description='addresses or networks that may connect, separated by commas; empty: any',
        structural=True,
    )
    modbus_connections: int = parameter(
        8, bounds=(1, 1000), description='connections at a time, beyond which a new one is refused', structural=True
    )

    def __post_init__(self) -> None:
        """Refuse what cannot be served, or would be open to strangers.

        Raises:
            ConfigurationError: naming the parameter.
        """
        for pair in self.pairs:
            if pair.count('/') != 1 or not all(pair.split('/')):
                raise ConfigurationError(f"pairs: '{pair}' is not 'first/second'")
        if len(set(self.pairs)) != len(self.pairs):
            raise ConfigurationError(f'pairs: a pair is given twice in {self.pairs}')
        if len(self.pairs) > LARGEST_PAIR_COUNT:
            raise ConfigurationError(f'pairs: {len(self.pairs)} pairs, at most {LARGEST_PAIR_COUNT} are served')
        if not self.opcua and not self.modbus:
            raise ConfigurationError('opcua and modbus are both false: nothing to serve')
        if self.lost_time < self.timeout:
            raise ConfigurationError(f'lost_time = {self.lost_time:g} s is below timeout = {self.timeout:g} s')
        refuse_half_a_pair(self.certificate, self.key)
        if self.clients and not self.certificate:
            raise ConfigurationError('clients is given without certificate and key')
        for name in ('opcua_address', 'modbus_address'):
            is_loopback(name, getattr(self, name))
        if self.opcua and not is_loopback('opcua_address', self.opcua_address) and not self.clients:
            raise ConfigurationError(
                f'opcua_address = {self.opcua_address} is no loopback address: '
                'certificate, key and clients must be given (./drfmcw gateway --make-certificate)'
            )
        networks(self.modbus_from)

    @property
    def endpoint(self) -> str:
        """Return the URL that OPC UA clients connect to."""
        host = f'[{self.opcua_address}]' if ':' in self.opcua_address else self.opcua_address
        return f'opc.tcp://{host}:{self.opcua_port}/drfmcw/'

    @property
    def period(self) -> float:
        """Return how often silence is looked for [s]: five times within the time-out, 20 times a second at most."""
        return min(0.05, self.timeout / 5.0)


def refuse_half_a_pair(certificate: str, key: str) -> None:
    """Refuse a certificate without its key, or a key without its certificate; '' for none.

    Raises:
        ConfigurationError: naming what lacks.
    """
    if bool(certificate) != bool(key):
        given, lacking = ('certificate', 'key') if certificate else ('key', 'certificate')
        raise ConfigurationError(f'{given} is given without {lacking}')


def is_loopback(name: str, address: str) -> bool:
    """Return whether only this machine reaches an address.

    Raises:
        ConfigurationError: it is none; `name` is the parameter's.
    """
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        raise ConfigurationError(f"{name}: '{address}' is no IP address") from None


def networks(text: str) -> list[ipaddress.IPv4Network | ipaddress.IPv6Network]:
    """Return the networks that a list separated by commas names.

    Raises:
        ConfigurationError: one of them is no network.
    """
    try:
        return [ipaddress.ip_network(part.strip()) for part in text.split(',') if part.strip()]
    except ValueError as error:
        raise ConfigurationError(f'modbus_from: {error}') from None
