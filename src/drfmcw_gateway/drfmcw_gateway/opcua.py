"""OPC UA server: a variable per quantity and pair, with the range's quality as status and its stamp as source time."""

import datetime
import logging
import math
import os
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from drfmcw_physics.settings import ConfigurationError

from .board import Board
from .certificates import certificate_of, key_of
from .quantities import GATEWAY_QUANTITIES, PAIR_QUANTITIES, GatewayQuantity, Kind, Quantity
from .reading import NANOSECONDS, USABLE, Quality, Reading
from .settings import GatewaySettings, is_loopback

NAMESPACE = 'urn:drfmcw:gateway'
"""Of the variables. Their identifiers are strings: `master/slave/range`, `gateway/heartbeat`."""
HEARTBEAT = 'gateway/controller_heartbeat'
"""The one variable that clients may write."""
_TYPES = {Kind.UINT16: ua.VariantType.UInt16, Kind.UINT32: ua.VariantType.UInt32}  # others: Double
_OF_STATE = {
    Quality.VALID: ua.StatusCodes.Good,
    Quality.DOUBTFUL: ua.StatusCodes.UncertainSensorNotAccurate,
    Quality.REFUSED: ua.StatusCodes.BadSensorFailure,
    Quality.STALE: ua.StatusCodes.UncertainLastUsableValue,
    Quality.NO_RANGE: ua.StatusCodes.BadWaitingForInitialData,
}
_GOOD, _BAD = ua.StatusCodes.Good, ua.StatusCodes.BadNoCommunication


def status_of(reading: Reading, lost_time: float) -> int:
    """Return the OPC UA status code of a pair's measured variables.

    Args:
        reading: of the pair.
        lost_time: silence beyond which the last value is no longer given [s].
    """
    if reading.state == Quality.STALE and (reading.silence >= lost_time or not reading.judgement & USABLE):
        return _BAD
    return _OF_STATE[reading.state]


class _Users:
    """Who may open a session: anyone where only this machine is heard, otherwise the holders of known certificates."""

    def __init__(self, known: set[bytes], open_to_all: bool) -> None:
        self._known, self._open_to_all = known, open_to_all

    def get_user(
        self, iserver: Any, username: str | None = None, password: str | None = None, certificate: bytes | None = None
    ) -> User | None:
        """Return a user without rights to administer, None for a stranger; called by asyncua."""
        if username is None and (self._open_to_all or certificate in self._known):
            return User(role=UserRole.User)
        return None


class OpcUaServer:
    """Serves a board; started and stopped in an event loop."""

    def __init__(self, board: Board) -> None:
        """Serve `board` at the address of its settings; read the certificates.

        Raises:
            ConfigurationError: a certificate or the key cannot be read, or they do not fit.
        """
        settings = board.settings
        self._board = board
        self._certificate = certificate_of(settings.certificate) if settings.certificate else None
        self._key = key_of(settings.key, self._certificate) if self._certificate else None
        self._known = _certificates_in(settings.clients) if settings.clients else set()
        self._server: Server | None = None
        self._namespace = 0
        self._states: dict[str, tuple[int, Quality]] = {}
        for name in ('asyncua', 'asyncuagds'):
            logging.getLogger(name).setLevel(logging.CRITICAL)

    @property
    def sessions(self) -> int:
        """Return the number of connected clients."""
        return len(self._server.bserver.clients) if self._server is not None and self._server.bserver else 0

    async def start(self) -> None:
        """Make the address space and listen.

        Raises:
            ConfigurationError: the address cannot be listened at.
        """
        settings = self._board.settings
        _check_port(settings)  # before the address space, which takes seconds to make
        loopback = is_loopback('opcua_address', settings.opcua_address)
        open_to_all = loopback and not settings.clients
        server = Server(user_manager=_Users(self._known, open_to_all))
        await server.init()
        server.set_endpoint(settings.endpoint)
        server.set_server_name('drfmcw gateway')
        await server.set_application_uri(_application_uri(self._certificate))
        server.set_identity_tokens([ua.AnonymousIdentityToken, ua.X509IdentityToken])
        policies = [ua.SecurityPolicyType.NoSecurity] if open_to_all else []
        if self._certificate is not None and self._key is not None:
            policies.append(ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt)
            server.iserver.certificate, server.iserver.private_key = self._certificate, self._key
            server.set_certificate_validator(self._validate)
        server.set_security_policy(policies)
        self._namespace = await server.register_namespace(NAMESPACE)
        await self._make_variables(server)
        self._server = server
        await self.update(list(self._board.pairs))
        try:
            await server.start()
        except OSError as error:
            self._server = None
            raise _cannot_listen(settings, error) from None

    async def stop(self) -> None:
        """Close all sessions."""
        if self._server is not None:
            await self._server.stop()

    async def _validate(self, certificate: x509.Certificate, application: ua.ApplicationDescription) -> None:
        """Refuse the certificate of a client that is not known, or not valid now; called by asyncua."""
        now = datetime.datetime.now(datetime.UTC)
        if not certificate.not_valid_before_utc <= now <= certificate.not_valid_after_utc:
            raise ServiceError(ua.StatusCodes.BadCertificateTimeInvalid)
        if self._known and _der(certificate) not in self._known:
            raise ServiceError(ua.StatusCodes.BadCertificateUntrusted)

    async def _make_variables(self, server: Server) -> None:
        root = await server.nodes.objects.add_object(self._id('drfmcw'), ua.QualifiedName('drfmcw', self._namespace))
        gateway = await root.add_object(self._id('gateway'), ua.QualifiedName('gateway', self._namespace))
        for own in GATEWAY_QUANTITIES:
            await self._add(gateway, 'gateway', own)
        heartbeat = await gateway.add_variable(
            self._id(HEARTBEAT),
            ua.QualifiedName('controller_heartbeat', self._namespace),
            ua.Variant(0, ua.VariantType.UInt16),
        )
        await heartbeat.set_writable()
        server.iserver.aspace.set_attribute_value_setter(heartbeat.nodeid, ua.AttributeIds.Value, self._write_heartbeat)
        for pair in self._board.pairs:
            parent = await root.add_object(self._id(pair), ua.QualifiedName(pair, self._namespace))
            for quantity in _served():
                await self._add(parent, pair, quantity)

    async def _add(self, parent: Any, name: str, quantity: Quantity | GatewayQuantity) -> None:
        kind = _TYPES.get(quantity.kind, ua.VariantType.Double)
        initial = ua.Variant(0.0 if kind == ua.VariantType.Double else 0, kind)
        node = await parent.add_variable(
            self._id(f'{name}/{quantity.name}'), ua.QualifiedName(quantity.name, self._namespace), initial
        )
        text = quantity.description + (f' [{quantity.unit}]' if quantity.unit else '')
        description = ua.DataValue(ua.Variant(ua.LocalizedText(text), ua.VariantType.LocalizedText))
        await node.write_attribute(ua.AttributeIds.Description, description)

    def _write_heartbeat(self, node: Any, attribute: ua.AttributeIds, value: ua.DataValue) -> None:
        node.attributes[attribute].value = value
        if value.Value is not None and isinstance(value.Value.Value, int):
            self._board.write_heartbeat(value.Value.Value)

    def _id(self, name: str) -> ua.NodeId:
        return ua.NodeId(name, self._namespace)

    async def update(self, pairs: Sequence[str]) -> None:
        """Write all variables of the pairs that got a range, or whose state may have changed."""
        margin = self._board.settings.period
        for pair, reading in self._board.readings(pairs, margin).items():
            await self._write(pair, reading, _served())

    async def tick(self) -> None:
        """Write what changes by itself: the gateway's variables; of each pair the age, or all if its state changed."""
        own = self._board.gateway()
        for quantity in GATEWAY_QUANTITIES:
            number = quantity.read(own)
            await self._put(f'gateway/{quantity.name}', quantity.kind, number, _GOOD, None)
        for pair, reading in self._board.readings(margin=self._board.settings.period).items():
            state = (status_of(reading, self._board.settings.lost_time), reading.quality)
            changed = self._states.get(pair) != state
            await self._write(pair, reading, _served() if changed else [q for q in _served() if q.name == 'age'])

    async def _write(self, pair: str, reading: Reading, quantities: Sequence[Quantity]) -> None:
        status = status_of(reading, self._board.settings.lost_time)
        self._states[pair] = (status, reading.quality)
        stamp = _time(reading.estimate.stamp) if reading.estimate else None
        for quantity in quantities:
            measured = quantity.measured
            number = _last(reading, quantity) if measured else quantity.read(reading)
            code = status if measured else _GOOD
            if measured and math.isnan(number) and not ua.StatusCode(code).is_bad():
                code = ua.StatusCodes.BadWaitingForInitialData  # a velocity that is not known yet
            await self._put(f'{pair}/{quantity.name}', quantity.kind, number, code, stamp if measured else None)

    async def _put(self, name: str, kind: Kind, number: float, status: int, stamp: datetime.datetime | None) -> None:
        assert self._server is not None
        type_ = _TYPES.get(kind)
        value = ua.Variant(float(number), ua.VariantType.Double) if type_ is None else _integer(kind, number, type_)
        now = datetime.datetime.now(datetime.UTC)
        data = ua.DataValue(value, ua.StatusCode(status), stamp or now, now)
        await self._server.write_attribute_value(self._id(name), data)


def _check_port(settings: GatewaySettings) -> None:
    """Refuse an address that cannot be listened at."""
    family = socket.AF_INET6 if ':' in settings.opcua_address else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((settings.opcua_address, settings.opcua_port))
        except OSError as error:
            raise _cannot_listen(settings, error) from None


def _cannot_listen(settings: GatewaySettings, error: OSError) -> ConfigurationError:
    reason = os.strerror(error.errno) if error.errno else str(error)
    return ConfigurationError(f'opcua_address, opcua_port: cannot listen at {settings.endpoint}: {reason}')


def _integer(kind: Kind, number: float, type_: ua.VariantType) -> ua.Variant:
    return ua.Variant(int(number) % (1 << 16 * kind.size), type_)


def _served() -> list[Quantity]:
    return [q for q in PAIR_QUANTITIES if not q.registers_only]


def _last(reading: Reading, quantity: Quantity) -> float:
    """Return the last number, however old: the status says whether it may be used."""
    return math.nan if reading.estimate is None else float(getattr(reading.estimate, quantity.name))


def _time(stamp: int) -> datetime.datetime:
    return datetime.datetime.fromtimestamp(0, datetime.UTC) + datetime.timedelta(
        seconds=stamp // NANOSECONDS, microseconds=stamp % NANOSECONDS // 1000
    )


def _application_uri(certificate: x509.Certificate | None) -> str:
    """Return the URI that the certificate bears, as the standard demands, or one of this machine."""
    if certificate is not None:
        try:
            names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except x509.ExtensionNotFound:
            names = None
        uris = names.get_values_for_type(x509.UniformResourceIdentifier) if names else []
        if uris:
            return uris[0]
    return f'urn:{socket.gethostname()}:drfmcw:gateway'


def _certificates_in(directory: str) -> set[bytes]:
    """Return the certificates in a directory (DER).

    Raises:
        ConfigurationError: it is none, or holds no certificate.
    """
    path = Path(directory)
    if not path.is_dir():
        raise ConfigurationError(f'clients: {directory} is no directory')
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in ('.der', '.pem', '.crt', '.cer'))
    if not files:
        raise ConfigurationError(f'clients: {directory} holds no certificate (*.der, *.pem, *.crt, *.cer)')
    return {_der(certificate_of(str(file), 'clients')) for file in files}


def _der(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(Encoding.DER)
