"""Where page and emergency stop are reached: the loopback interface, or by TLS an address of this computer."""

import io
from dataclasses import dataclass
from pathlib import Path

from hmi.certificate import Certificate, own_certificate

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Place:
    """Address of page and emergency stop; with a certificate unless it is that of the loopback interface."""

    host: str
    certificate: Certificate | None = None

    def url(self, port: int) -> str:
        """Address with a port."""
        return f"http{'s' if self.certificate else ''}://{self.host}:{port}/"


def place_of(listen: str | None, state: Path) -> Place:
    """Place of an address of this computer, the loopback interface for None; raises HeadlandError."""
    if listen is None:
        return Place(LOOPBACK)
    return Place(listen, own_certificate(state, listen))


def qr_text(url: str) -> str:
    """QR code for a terminal."""
    import segno

    text = io.StringIO()
    segno.make(url).terminal(text, compact=True)
    return text.getvalue()
