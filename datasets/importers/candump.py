"""CAN logs of `candump -l`, `(seconds) interface ID#DATA`, and its output `(seconds) interface ID [length] DATA`."""

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from datasets.importers.can_batches import FD, NO_DATA, Numbered, can_lines, can_recording
from datasets.importers.recording import Open, Recording, Skipped
from messages.command import CanFrame

NAME = "candump"
_TIME = r"\((?:(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)|(\d+))\.(\d{1,9})\)"
_LOG = re.compile(rf"{_TIME} (\S+) ([0-9A-F]{{1,8}})#(\S*)(?: .*)?", re.ASCII | re.IGNORECASE)
_SCREEN = re.compile(
    rf"{_TIME} +(\S+) +(?:[RT]X [-B] [-E] +)?([0-9A-F]{{3,8}}) +\[(\d+)\]((?: +[0-9A-F]{{2}})*)(?: +\D.*)?",
    re.ASCII | re.IGNORECASE,
)
_START = re.compile(
    r"\s*(?:(?:#|//).*\s+)*" + rf"{_TIME} +\S+ +(?:[RT]X [-B] [-E] +)?[0-9A-F]+(?:#| +\[)", re.IGNORECASE
)
LOCAL = "times with a date are those of the recording PC, read as UTC"


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a file whose first line, beside comments, is one of candump."""
    return open_candump if _START.match(head.decode("utf-8-sig", "replace")) else None


def open_candump(path: Path, _: Path | None = None) -> Recording:
    """A candump log; other lines are skipped and counted."""
    return can_recording(path, NAME, partial(_frames, path), (LOCAL,) if _has_date(path) else ())


def _frames(path: Path) -> Iterator[Numbered | Skipped]:
    return can_lines(path, _frame)


def _has_date(path: Path) -> bool:
    with path.open("rb") as file:
        return re.search(rb"\(\d{4}-\d\d-", file.read(4096)) is not None


def _frame(line: str) -> Numbered:
    """Channel and frame of a line; raises ValueError."""
    found = _LOG.fullmatch(line) or _SCREEN.fullmatch(line)
    if found is None:
        raise ValueError("not of the form (seconds) interface ID#DATA, or (seconds) interface ID [length] DATA")
    day, seconds, fraction, channel, identifier, *data = found.groups()
    if day is not None:
        seconds = round(datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp())
    frame = partial(CanFrame, int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0")), int(identifier, 16))
    if len(data) == 1:
        if data[0].startswith("#"):
            raise ValueError(FD)
        if data[0].upper().startswith("R"):
            raise ValueError(NO_DATA)
        return channel, frame(bytes.fromhex(data[0].replace(".", "")))
    if len(data[0]) > 1:  # [08]
        raise ValueError(FD)
    if line.endswith("remote request"):
        raise ValueError(NO_DATA)
    if len(content := bytes.fromhex(data[1])) != int(data[0]):
        raise ValueError("the length is not that of the data")
    return channel, frame(content)
