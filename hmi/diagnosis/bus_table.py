"""Frames of the machine's bus: the newest of each identifier, decoded by the CAN database."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any

from configs.strict import CONFIGS
from messages.command import CanFrame, CanFrames
from messages.message import Envelope

FIRST_PDU2 = 0xF000  # groups from here on have no destination (ISO 11783-3)
MAX_IDENTIFIERS = 200  # a flood of others is not kept


@dataclass(frozen=True)
class BusRow:
    """Newest frame of an identifier: `is_sent` by the gateway, its name ("" if unknown), and values with units."""

    is_sent: bool
    identifier: int
    name: str
    count: int
    values: str


class BusTable:
    """Number and newest frame by identifier and direction."""

    def __init__(self) -> None:
        self._frames: dict[tuple[bool, int], tuple[int, CanFrame]] = {}

    def take(self, envelopes: Iterable[Envelope]) -> None:
        """Processes the frames among the messages."""
        for envelope in envelopes:
            message = envelope.message
            for frame in message.frames if isinstance(message, CanFrames) else ():
                key = (envelope.topic.endswith("/tx"), frame.identifier)
                if key in self._frames or len(self._frames) < MAX_IDENTIFIERS:
                    self._frames[key] = (self._frames.get(key, (0, frame))[0] + 1, frame)

    def rows(self) -> list[BusRow]:
        """All by direction and identifier."""
        return [
            BusRow(is_sent, identifier, count=count, **_decoded(frame))
            for (is_sent, identifier), (count, frame) in sorted(self._frames.items(), key=lambda item: item[0])
        ]  # fmt: skip


def group_of(identifier: int) -> int:
    """Parameter group of a 29-bit identifier, without priority, addresses."""
    group = identifier >> 8 & 0x3FFFF
    return group if group & 0xFF00 >= FIRST_PDU2 else group & 0x3FF00


@cache
def _messages() -> dict[int, Any]:
    """Messages of the CAN database by identifier, and by group for another source address."""
    import cantools

    messages: Any = cantools.database.load_file(CONFIGS / "can" / "headland.dbc").messages  # type: ignore[union-attr]
    by_group = {-1 - group_of(one.frame_id): one for one in reversed(messages)}
    return by_group | {one.frame_id: one for one in messages}


def _decoded(frame: CanFrame) -> dict[str, str]:
    known = _messages()
    message = known.get(frame.identifier) or known.get(-1 - group_of(frame.identifier))
    if message is None:
        return {"name": "", "values": frame.data.hex(" ")}
    try:
        values = message.decode(frame.data, decode_choices=False)
    except Exception:
        return {"name": message.name, "values": frame.data.hex(" ")}
    units = {signal.name: signal.unit or "" for signal in message.signals}
    shown = (f"{name} {value:g} {units[name]}".strip() for name, value in values.items())
    return {"name": message.name, "values": ", ".join(shown)}
