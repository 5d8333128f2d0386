"""Certificates of OPC UA: a self-signed one to begin with, and reading those that are given."""

import datetime
import ipaddress
import os
import socket
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey, generate_private_key
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import write_atomically

_KEY_SIZE = 2048  # bits; Basic256Sha256 takes 2048 to 4096
_DAYS = 3650
CERTIFICATE, KEY = 'certificate.der', 'key.pem'
"""Files that `make_certificate` writes."""


def make_certificate(directory: Path, name: str, days: int = _DAYS) -> tuple[Path, Path]:
    """Write a self-signed certificate and its key, which only the owner may read; return both paths.

    Args:
        directory: created where it does not exist.
        name: of the application, in subject and URI.
        days: for which the certificate is valid.

    Raises:
        ConfigurationError: one of the files is there already, or cannot be written.
    """
    certificate, key = directory / CERTIFICATE, directory / KEY
    for path in (certificate, key):
        if path.exists():
            raise ConfigurationError(f'{path}: exists already, not overwriting')
    private = generate_private_key(public_exponent=65537, key_size=_KEY_SIZE)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        previous = os.umask(0o077)
        try:
            write_atomically(key, private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
        finally:
            os.umask(previous)
    except OSError as error:
        raise ConfigurationError(f'{directory}: {error.strerror or error}') from None
    write_atomically(certificate, _self_signed(private, name, days).public_bytes(Encoding.DER))
    return certificate, key


def _self_signed(private: RSAPrivateKey, name: str, days: int) -> x509.Certificate:
    """Return a certificate with what OPC UA asks for (OPC 10000-6, 6.2.2)."""
    host = socket.gethostname()
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    names: list[x509.GeneralName] = [
        x509.UniformResourceIdentifier(f'urn:{host}:drfmcw:{name}'),
        x509.DNSName(host),
        x509.IPAddress(ipaddress.ip_address('127.0.0.1')),
    ]
    usage = x509.KeyUsage(
        digital_signature=True, content_commitment=True, key_encipherment=True, data_encipherment=True,
        key_agreement=False, key_cert_sign=True, crl_sign=False, encipher_only=False, decipher_only=False,
    )  # fmt: skip
    now = datetime.datetime.now(datetime.UTC)
    public = private.public_key()
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(minutes=5))  # clocks of crane and client may differ
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]), critical=False
        )
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(public), critical=False)
    )
    return builder.sign(private, hashes.SHA256())


def certificate_of(path: str, setting: str = 'certificate') -> x509.Certificate:
    """Return the certificate in a file, DER or PEM.

    Raises:
        ConfigurationError: it cannot be read; `setting` is the parameter that names the file.
    """
    data = _content(path, setting)
    try:
        load = x509.load_pem_x509_certificate if data.startswith(b'-----') else x509.load_der_x509_certificate
        return load(data)
    except ValueError:
        raise ConfigurationError(f'{setting}: {path} holds no certificate (DER or PEM)') from None


def key_of(path: str, certificate: x509.Certificate) -> RSAPrivateKey:
    """Return the private key in a file.

    Raises:
        ConfigurationError: it cannot be read, others may read it, or it is not that of the certificate.
    """
    data = _content(path, 'key')
    if Path(path).stat().st_mode & 0o077:
        raise ConfigurationError(f'key: others may read {path}; chmod 600 it')
    try:
        key = load_pem_private_key(data, None)
    except (ValueError, TypeError):
        raise ConfigurationError(f'key: {path} holds no private key (PEM, without a password)') from None
    if not isinstance(key, RSAPrivateKey) or key.public_key() != certificate.public_key():
        raise ConfigurationError(f'key: {path} is not the RSA key of the certificate')
    return key


def _content(path: str, setting: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ConfigurationError(f'{setting}: {path}: {error.strerror or error}') from None
