"""Truth in a sidecar file beside a log of any format; `sidecar_lines` describes its lines."""

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from datasets.importers.formats import open_recording, takes_labels
from datasets.importers.recording import Received, Recording, Sensor, Skipped
from datasets.importers.sidecar_lines import read_sidecar
from messages.errors import LogError
from messages.truth import TrueObjects

SUFFIX = ".truth.jsonl"
OUTSIDE_NS = 1_000_000_000  # stamps so far before the first or behind the last scan are not of this log


def open_with_truth(path: Path, truth: Path | None, source: str) -> Recording:
    """A recording with truth from label files, from a sidecar (named or beside it), or from its own topic."""
    file = sidecar_of(path, truth, source)
    if file is not None:
        return _with_sidecar(open_recording(path), file)
    recording = open_recording(path, truth if truth is not None and takes_labels(path) else None)
    if source == "sidecar":
        raise LogError(f"{path}: the conditions require truth from a sidecar, and {path.name}{SUFFIX} does not exist")
    return recording


def sidecar_of(path: Path, truth: Path | None, source: str) -> Path | None:
    """The sidecar that holds the truth of a log: the one named, or that beside it; None without one."""
    beside = path.with_name(path.name + SUFFIX)
    if truth is None and beside.is_file() and source in ("any", "sidecar"):
        return beside
    return truth if truth is not None and truth.is_file() and truth.suffix in (".jsonl", ".json") else None


def _with_sidecar(recording: Recording, file: Path) -> Recording:
    lidars = [s for s in recording.description.sensors if s.topic.startswith("lidar/")]
    if not lidars:
        raise LogError(f"{recording.path}: no lidar for the frame of the truth")
    sidecar = read_sidecar(file)
    mine = [lidar for lidar in lidars if sidecar.frame in ("", lidar.frame, lidar.topic)]
    if not mine:
        known = ", ".join(lidar.frame or lidar.topic for lidar in lidars)
        raise LogError(f"{file}: frame {sidecar.frame!r} is none of the log's lidars ({known})")
    truth = Sensor(f"truth_objects/{mine[0].topic.partition('/')[2]}", mine[0].frame, str(file), "sidecar")
    about = replace(recording.description, sensors=(*recording.description.sensors, truth), truth_frame=mine[0].frame)
    return Recording(recording.path, about, lambda: _merged(recording, mine[0].topic, truth, sidecar.messages))


def _merged(
    recording: Recording, lidar: str, truth: Sensor, messages: tuple[TrueObjects, ...]
) -> Iterator[Received | Skipped]:
    """The recording with each true message behind the first scan that is not older; those outside are skipped.

    Raises LogError if all stamps are outside of the log.
    """
    waiting, received, scans_ns, is_used = deque(messages), 0, (0, 0), not messages

    def place(message: TrueObjects) -> Received | Skipped:
        nonlocal is_used
        if not scans_ns[0] - OUTSIDE_NS <= message.stamp_ns <= scans_ns[1] + OUTSIDE_NS:
            return Skipped(received, truth.source, truth.source_type, "stamp outside of the log")
        is_used = True
        return received, truth.topic, message

    for item in recording.messages():
        if isinstance(item, Skipped):
            yield item
            continue
        if not item[1].startswith("truth_objects"):
            yield item
        if item[1] == lidar:
            received, stamp_ns = item[0], item[2].stamp_ns
            scans_ns = (scans_ns[0] or stamp_ns, max(scans_ns[1], stamp_ns))
            while waiting and waiting[0].stamp_ns <= stamp_ns:
                yield place(waiting.popleft())
    yield from (place(message) for message in waiting)
    if not is_used:
        raise LogError(
            f"{truth.source}: no stamp is within the log; stamps {messages[0].stamp_ns} to {messages[-1].stamp_ns} ns, "
            f"scans {scans_ns[0]} to {scans_ns[1]} ns"
        )
