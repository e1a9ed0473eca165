"""Certificate of the page for TLS, made at the first start on an address: self-signed, the key stays in its file."""

import datetime
import ipaddress
import os
import ssl
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import NameOID

from messages.errors import HeadlandError

CERTIFICATE, KEY = "certificate.pem", "certificate_key.pem"
DAYS, RENEWED_DAYS = 800, 30  # browsers refuse more than 825; another one is made so long before the end
NAME = "Headland operator's page"


@dataclass(frozen=True)
class Certificate:
    """Files of certificate and key, and the SHA-256 fingerprint by which a person recognizes it."""

    path: Path
    key: Path
    fingerprint: str

    def context(self) -> ssl.SSLContext:
        """Settings of a server."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.load_cert_chain(self.path, self.key)
        return context


def own_certificate(folder: Path, address: str, now: datetime.datetime | None = None) -> Certificate:
    """Certificate of the folder for an IP address, made unless there is a valid one; raises HeadlandError."""
    now = now or datetime.datetime.now(datetime.UTC)
    path, key_path = folder / CERTIFICATE, folder / KEY
    certificate = _valid(path, key_path, address, now)
    if certificate is None:
        key = ec.generate_private_key(ec.SECP256R1())
        certificate = _made(key, address, now)
        pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)  # never one beside the key of another
            _write(key_path, pem)
            _write(path, certificate.public_bytes(Encoding.PEM))
        except OSError as error:
            raise HeadlandError(f"{folder}: the certificate cannot be written ({error.strerror})") from error
    digits = certificate.fingerprint(hashes.SHA256()).hex().upper()
    return Certificate(path, key_path, ":".join(digits[k : k + 2] for k in range(0, len(digits), 2)))


def _made(key: ec.EllipticCurvePrivateKey, address: str, now: datetime.datetime) -> x509.Certificate:
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, NAME)])
    names = x509.SubjectAlternativeName([
        x509.IPAddress(ipaddress.ip_address(address)), x509.IPAddress(ipaddress.ip_address("127.0.0.1")),
        x509.DNSName("localhost"),
    ])  # fmt: skip
    builder = x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
    builder = builder.not_valid_before(now - datetime.timedelta(hours=1))
    builder = builder.not_valid_after(now + datetime.timedelta(days=DAYS)).add_extension(names, critical=False)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    return builder.sign(key, hashes.SHA256())


def _valid(path: Path, key_path: Path, address: str, now: datetime.datetime) -> x509.Certificate | None:
    """The certificate of the files, None for another address, a soon end, another key, or damage."""
    try:
        found = x509.load_pem_x509_certificate(path.read_bytes())
        key = load_pem_private_key(key_path.read_bytes(), None)
        names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (OSError, ValueError, TypeError, UnsupportedAlgorithm, x509.ExtensionNotFound):
        return None
    pem, form = Encoding.PEM, PublicFormat.SubjectPublicKeyInfo
    is_own = key.public_key().public_bytes(pem, form) == found.public_key().public_bytes(pem, form)
    is_for = ipaddress.ip_address(address) in names.get_values_for_type(x509.IPAddress)
    lasts = found.not_valid_before_utc <= now < found.not_valid_after_utc - datetime.timedelta(days=RENEWED_DAYS)
    return found if is_own and is_for and lasts else None


def _write(path: Path, data: bytes) -> None:
    """Writes a file that only this user can read, at once."""
    fresh = path.with_suffix(".new")
    fresh.unlink(missing_ok=True)
    with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(data)
    fresh.replace(path)
