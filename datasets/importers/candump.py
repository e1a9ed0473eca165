"""CAN logs of `candump -l`, with one line `(seconds) interface ID#DATA` per frame."""

import re
from collections.abc import Iterator
from pathlib import Path

from datasets.importers.can_batches import can_batches
from datasets.importers.recording import Description, Open, Recording, Sensor, Skipped
from messages.command import CanFrame
from messages.errors import LogError

NAME = "candump"
LINE = re.compile(r"\((\d+)\.(\d{1,9})\) (\S+) ([0-9A-Fa-f]{1,8})#(\S*)(?: .*)?")
START = re.compile(rb"\A\(\d+\.\d+\) \S+ [0-9A-Fa-f]+#")


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a file whose first line is a candump line."""
    return open_candump if START.match(head) else None


def open_candump(path: Path, _: Path | None = None) -> Recording:
    """A candump log; other lines are skipped and counted."""
    channels = list(dict.fromkeys(item[0] for item in _frames(path) if not isinstance(item, Skipped)))
    sensors = tuple(Sensor(f"can/{c}", "", c, NAME) for c in channels)
    return Recording(path, Description(NAME, sensors), lambda: can_batches(_frames(path)))


def _frames(path: Path) -> Iterator[tuple[str, CanFrame] | Skipped]:
    last_ns = 0
    try:
        with path.open(encoding="ascii", errors="replace") as file:
            for line in filter(str.strip, file):
                try:
                    channel, frame = _frame(line.strip())
                except ValueError as error:
                    yield Skipped(last_ns, path.name, "lines", str(error))
                else:
                    last_ns = frame.stamp_ns
                    yield channel, frame
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error})") from error


def _frame(line: str) -> tuple[str, CanFrame]:
    """Channel and frame of a line; raises ValueError."""
    found = LINE.fullmatch(line)
    if found is None:
        raise ValueError("not of the form (seconds) interface ID#DATA")
    data = b"" if found[5].startswith("R") else bytes.fromhex(found[5])
    if len(data) > 8:
        raise ValueError("more than 8 bytes in a frame")
    stamp_ns = int(found[1]) * 1_000_000_000 + int(found[2].ljust(9, "0"))
    return found[3], CanFrame(stamp_ns, int(found[4], 16), data)
