"""CAN logs of `candump -l`, with one line `(seconds) interface ID#DATA` per frame."""

import re
from collections.abc import Iterator
from pathlib import Path

from datasets.importers.recording import Description, Open, Received, Recording, Sensor
from messages.command import CanFrame, CanFrames
from messages.errors import LogError

NAME = "candump"
LINE = re.compile(r"\((\d+)\.(\d{1,9})\) (\S+) ([0-9A-Fa-f]{1,8})#(\S*)(?: .*)?")
START = re.compile(rb"\A\(\d+\.\d+\) \S+ [0-9A-Fa-f]+#")
# Duration of one message, the period of the machine's topic.
BATCH_NS = 20_000_000


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a file whose first line is a candump line."""
    return open_candump if START.match(head) else None


def open_candump(path: Path, _: Path | None = None) -> Recording:
    """A candump log; raises LogError with the line number."""
    channels = list(dict.fromkeys(channel for channel, _ in _frames(path)))
    sensors = tuple(Sensor(f"can/{c}", "", c, "candump") for c in channels)
    return Recording(path, Description(NAME, sensors), lambda: _batches(path))


def _batches(path: Path) -> Iterator[Received]:
    """Frames of a channel within 20 ms as one message, received with its last frame."""
    open_batches: dict[str, list[CanFrame]] = {}
    for channel, frame in _frames(path):
        batch = open_batches.setdefault(channel, [])
        if batch and not 0 <= frame.stamp_ns - batch[0].stamp_ns < BATCH_NS:
            yield _message(channel, batch)
            batch = open_batches[channel] = []
        batch.append(frame)
    for channel, batch in open_batches.items():
        yield _message(channel, batch)


def _message(channel: str, frames: list[CanFrame]) -> Received:
    stamp_ns = frames[-1].stamp_ns
    return stamp_ns, f"can/{channel}", CanFrames(stamp_ns, channel, tuple(frames))


def _frames(path: Path) -> Iterator[tuple[str, CanFrame]]:
    try:
        with path.open(encoding="ascii") as file:
            for number, line in enumerate(file, start=1):
                if line.strip():
                    yield _frame(path, number, line.strip())
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: cannot be read ({error})") from error


def _frame(path: Path, number: int, line: str) -> tuple[str, CanFrame]:
    found = LINE.fullmatch(line)
    try:
        if found is None:
            raise ValueError("not of the form (seconds) interface ID#DATA")
        data = b"" if found[5].startswith("R") else bytes.fromhex(found[5])
        if len(data) > 8:
            raise ValueError(f"{len(data)} bytes in a frame")
    except ValueError as error:
        raise LogError(f"{path}:{number}: {line[:60]!r}: {error}") from error
    stamp_ns = int(found[1]) * 1_000_000_000 + int(found[2].ljust(9, "0"))
    return found[3], CanFrame(stamp_ns, int(found[4], 16), data)
