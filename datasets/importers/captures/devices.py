"""Contract of the makers' modules: they recognize datagrams and decode those of one sensor."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from datasets.importers.recording import Extrinsic
from messages.message import Message


@dataclass(frozen=True)
class Stream:
    """Datagrams of one sensor: address and port, and what they are (`Velodyne VLP-16`), as `recognize` names it."""

    source: str
    port: int
    model: str


class Lost(NamedTuple):
    """Data that a sensor sent, or should have sent, and the capture lacks."""

    reason: str


class Decoder(Protocol):
    """Messages of one stream."""

    kind: str  # of topic
    frame: str
    notes: tuple[str, ...]
    extrinsics: tuple[Extrinsic, ...]

    def receive(self, payload: bytes, receive_ns: int) -> Iterator[Message | Lost]:
        """Messages that a datagram completes; raises LogError for one that cannot be read."""

    def finish(self) -> Iterator[Message | Lost]:
        """Messages begun before the end of the capture."""


class Maker(Protocol):
    """A module with decoders."""

    def recognize(self, payload: bytes) -> str | None:
        """What a datagram is, by its content; None for other content. Part of a stream's identity."""

    def open_decoder(self, stream: Stream, payload: bytes, capture: Path) -> Decoder:
        """A decoder for a stream that begins with `payload`; raises LogError with the reason why it cannot be read."""
