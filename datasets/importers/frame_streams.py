"""Folders of numbered files as recordings: one stream per sensor; a file that cannot be read is skipped and counted."""

import heapq
import re
from calendar import timegm
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from datasets.importers.recording import (
    CameraCalibration,
    Description,
    Extrinsic,
    Ignored,
    Received,
    Recording,
    Sensor,
    Skipped,
)
from messages.errors import LogError
from messages.message import Message

FRAME_NS = 100_000_000
MAX_FRAME = 10**8
# Files by frame number, and the reasons for files that are not read.
Files = tuple[dict[int, Path], tuple[str, ...]]
# Stamps (ns) by frame number, and the reasons for frames that are not read.
Times = tuple[dict[int, int], tuple[str, ...]]
NO_TIMES = "no time stamps: the time of a frame is its number at 10 Hz"


@dataclass(frozen=True)
class FrameStream:
    """Files of one source by frame number: `stamps` (ns) and `read`, which gives one message per sensor.

    `read` takes frame number and stamp and raises LogError; `unread` has the reason by file for files without a stamp.
    """

    sensors: tuple[Sensor, ...]
    stamps: dict[int, int]
    read: Callable[[int, int], tuple[Message, ...]]
    unread: tuple[str, ...] = ()


@dataclass
class FolderContents:
    """What an importer finds in a folder, in the order of its search."""

    path: Path
    format: str
    streams: list[FrameStream] = field(default_factory=list)
    extrinsics: list[Extrinsic] = field(default_factory=list)
    cameras: list[CameraCalibration] = field(default_factory=list)
    ignored: list[Ignored] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def recording(self, truth_frame: str | None, truth_view_deg: float, vehicle: str | None) -> Recording:
        """The recording of all streams; raises LogError without any."""
        if not self.streams:
            reasons = "; ".join(f"{i.source}: {i.reason}" for i in self.ignored) or "nothing of the format in it"
            raise LogError(f"{self.path}: {self.format} without a sensor ({reasons})")
        sensors = tuple(sensor for stream in self.streams for sensor in stream.sensors)
        description = Description(
            self.format, sensors, tuple(self.extrinsics), tuple(self.ignored), truth_frame, tuple(self.notes),
            truth_view_deg, vehicle, tuple(self.cameras),
        )  # fmt: skip
        return Recording(self.path, description, lambda: merged(self.streams))


def merged(streams: Iterable[FrameStream]) -> Iterator[Received | Skipped]:
    """All messages in order of their stamps; of one stamp in the order of the streams."""
    return heapq.merge(*map(_messages, streams), key=lambda received: received[0])


def _messages(stream: FrameStream) -> Iterator[Received | Skipped]:
    first = stream.sensors[0]
    begin_ns = min(stream.stamps.values(), default=0)
    yield from (Skipped(begin_ns, first.source, first.source_type, reason) for reason in stream.unread)
    for frame, stamp_ns in sorted(stream.stamps.items(), key=lambda item: item[1]):
        try:
            messages = stream.read(frame, stamp_ns)
        except LogError as error:
            yield Skipped(stamp_ns, first.source, first.source_type, str(error))
            continue
        yield from ((stamp_ns, sensor.topic, m) for sensor, m in zip(stream.sensors, messages, strict=True))


def numbered_files(files: Iterable[Path]) -> Files:
    """Files in the order of their names, the frame numbers, and the reasons for files without a number of their own."""
    found: dict[int, Path] = {}
    reasons = []
    for path in sorted(files):
        number = int(path.stem) if re.fullmatch(r"[0-9]{1,18}", path.stem) else MAX_FRAME
        if number >= MAX_FRAME:
            reasons.append(f"{path}: its name is no frame number below {MAX_FRAME}")
        elif number in found:
            reasons.append(f"{path}: frame {number} is {found[number].name}")
        else:
            found[number] = path
    return dict(sorted(found.items())), tuple(reasons)


def nominal_times(frames: Iterable[int], period_ns: int = FRAME_NS) -> dict[int, int]:
    """Stamps (ns) of frames at a fixed rate."""
    return {number: number * period_ns for number in frames}


def read_times(path: Path, frames: Iterable[int]) -> Times:
    """Stamps (ns, UTC) from a file with one line per frame number, and the reasons for frames without one.

    Raises LogError when the file cannot be read.
    """
    lines = read_lines(path)
    stamps: dict[int, int] = {}
    reasons = []
    for number in frames:
        stamp_ns = _parse_time(lines[number]) if number < len(lines) else None
        if stamp_ns is None:
            text = repr(lines[number][:40]) if number < len(lines) else "nothing"
            reasons.append(f"{path}: frame {number} has no time stamp, but {text}")
        else:
            stamps[number] = stamp_ns
    return stamps, tuple(reasons)


def _parse_time(line: str) -> int | None:
    found = re.fullmatch(r"(\d{4})-(\d\d)-(\d\d) (\d\d):(\d\d):(\d\d)(?:\.(\d{1,9}))?", line.strip(), re.ASCII)
    if found is None or not 1 <= int(found.group(2)) <= 12:
        return None
    parts = [int(g) for g in found.groups()[:6]]
    return timegm((*parts, 0, 0, 0)) * 1_000_000_000 + int((found.group(7) or "0").ljust(9, "0"))


def read_bytes(path: Path) -> bytes:
    """Content of a file; raises LogError."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error


def read_lines(path: Path) -> list[str]:
    """Lines of an ASCII file; raises LogError."""
    try:
        return read_bytes(path).decode("ascii").split("\n")
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: is no ASCII text (byte {error.start})") from error


def unread_entries(folder: Path, known: Iterable[str]) -> tuple[Ignored, ...]:
    """What a folder holds besides the entries `known`, files by suffix with their number."""
    names = set(known)
    others = [p for p in folder.iterdir() if p.name not in names and not p.name.startswith(".")]
    folders = sorted(p.name for p in others if p.is_dir())
    suffixes = Counter(f"*{p.suffix}" if p.suffix else p.name for p in others if not p.is_dir())
    reason = "is no part of the format"
    return (
        *(Ignored(f"{folder / name}/", "folder", reason) for name in folders),
        *(Ignored(str(folder / name), "file", reason, count) for name, count in sorted(suffixes.items())),
    )
