"""Packet captures (pcap, pcapng) of a SocketCAN interface, as of Wireshark; other frames in them are not read.

Source: LINKTYPE_CAN_SOCKETCAN of tcpdump.
"""

import struct
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from datasets.importers.can_batches import (
    ERROR,
    ERROR_FRAME,
    EXTENDED_BITS,
    NO_DATA,
    STANDARD_BITS,
    Numbered,
    can_recording,
)
from datasets.importers.captures.container import frames, is_capture
from datasets.importers.recording import Ignored, Open, Recording, Skipped
from messages.command import CanFrame

NAME = "CAN capture"
LINK = 227
# The capture does not name its interface.
CHANNEL = "can0"
UNNAMED = f"the capture does not name its interface: {CHANNEL}"
EXTENDED, REMOTE = 0x8000_0000, 0x4000_0000


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a capture whose first frame is one of SocketCAN."""
    if path.is_dir() or not is_capture(head):
        return None
    first = next(frames(path, []), None)
    return open_can_capture if first is not None and first.link == LINK else None


def open_can_capture(path: Path, _: Path | None = None) -> Recording:
    """A capture of CAN frames; others are skipped and counted."""
    damages: list[str] = []
    for _frame in frames(path, damages):
        pass
    ignored = tuple(Ignored(path.name, "file", damage) for damage in damages)
    return can_recording(path, NAME, partial(_can_frames, path), (UNNAMED,), ignored)


def _can_frames(path: Path) -> Iterator[Numbered | Skipped]:
    for frame in frames(path, []):
        skipped = partial(Skipped, frame.receive_ns, CHANNEL, "SocketCAN")
        if frame.link != LINK:
            yield skipped(f"frame of link type {frame.link}")
            continue
        if len(frame.data) < 8:
            yield skipped(f"frame of {len(frame.data)} bytes")
            continue
        identifier, size = struct.unpack_from(">IB", frame.data)
        data = frame.data[8 : 8 + size]
        if identifier & ERROR:
            yield skipped(ERROR_FRAME)
        elif identifier & REMOTE:
            yield skipped(NO_DATA)
        elif size > 8 or len(data) < size:
            yield skipped("more than 8 bytes in a frame, or fewer than it states")
        else:
            bits = EXTENDED_BITS if identifier & EXTENDED else STANDARD_BITS
            yield CHANNEL, CanFrame(frame.receive_ns, identifier & bits, data)
