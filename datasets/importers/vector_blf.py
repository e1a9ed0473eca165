"""CAN logs in Vector's binary format (BLF), read by python-can."""

import struct
import zlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import can
from can.io.blf import BLFParseError

from datasets.importers.can_batches import ERROR_FRAME, FD, NO_DATA, Numbered, can_recording, check
from datasets.importers.can_text_logs import LOCAL
from datasets.importers.recording import Ignored, Open, Recording, Skipped
from messages.command import CanFrame
from messages.errors import LogError

NAME = "Vector BLF"
MAGIC = b"LOGG"
DAMAGED = (can.CanError, BLFParseError, struct.error, zlib.error, ValueError, LookupError, ArithmeticError, EOFError)


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a BLF file."""
    return open_blf if head.startswith(MAGIC) else None


def open_blf(path: Path, _: Path | None = None) -> Recording:
    """A BLF file; frames other than those of data are skipped and counted; raises LogError."""
    with _reader(path) as reader:
        size, count = reader.file_size, reader.object_count
    others = count - sum(1 for _ in _frames(path))
    ignored = [Ignored(path.name, NAME, "objects other than CAN frames are not read", others)] if others > 0 else []
    if path.stat().st_size < size:
        ignored = [Ignored(path.name, NAME, f"the file is cut off: {path.stat().st_size} of {size} bytes")]
    return can_recording(path, NAME, partial(_frames, path), (LOCAL,), tuple(ignored))


def _reader(path: Path) -> can.BLFReader:
    try:
        return can.BLFReader(path)
    except (OSError, *DAMAGED) as error:
        raise LogError(f"{path}: no header of a BLF file ({error})") from error


def _frames(path: Path) -> Iterator[Numbered | Skipped]:
    last_ns = 0
    with _reader(path) as reader:
        try:
            for message in reader:
                last_ns = round(message.timestamp * 1e6) * 1000
                yield _frame(message, last_ns, path)
        except (OSError, *DAMAGED) as error:
            yield Skipped(
                last_ns, path.name, NAME, f"the rest of the file is damaged ({error or type(error).__name__})"
            )


def _frame(message: can.Message, stamp_ns: int, path: Path) -> Numbered | Skipped:
    frame = CanFrame(stamp_ns, message.arbitration_id, bytes(message.data))
    skipped = partial(Skipped, max(0, stamp_ns), path.name, NAME)
    for is_kind, reason in (
        (message.is_error_frame, ERROR_FRAME), (message.is_remote_frame, NO_DATA), (message.is_fd, FD)
    ):  # fmt: skip
        if is_kind:
            return skipped(reason)
    try:
        check(frame)
    except ValueError as error:
        return skipped(str(error))
    number = message.channel if isinstance(message.channel, int) else 0  # the file counts from 1, python-can from 0
    return f"can{number + 1}", frame
