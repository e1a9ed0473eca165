"""CAN frames of a recording as messages, one per channel and 20 ms, and the lines of text logs as frames."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from datasets.importers.recording import END_NS, Description, Ignored, Received, Recording, Sensor, Skipped
from messages.command import CanFrame, CanFrames
from messages.errors import LogError

# Duration of one message, the period of the machine's topic.
BATCH_NS = 20_000_000
STANDARD_BITS, EXTENDED_BITS = 0x7FF, 0x1FFF_FFFF
ERROR = 0x2000_0000  # flag in an identifier of SocketCAN
COMMENTS = ("#", "//")
CUT = "the last line has no line end: it may be cut off"
NO_DATA = "remote frame, without data"
FD = "CAN FD frame, which is not read"
ERROR_FRAME = "error frame of the interface"
Numbered = tuple[str, CanFrame]  # channel, frame
Frames = Callable[[], Iterator[Numbered | Skipped]]


def can_recording(
    path: Path, name: str, frames: Frames, notes: tuple[str, ...] = (), ignored: tuple[Ignored, ...] = ()
) -> Recording:
    """A recording of CAN frames; `frames` starts a new pass."""
    channels: Counter[str] = Counter()
    standard: Counter[str] = Counter()
    for item in frames():
        if not isinstance(item, Skipped):
            channels[item[0]] += 1
            standard[item[0]] += item[1].identifier <= STANDARD_BITS
    sensors = tuple(Sensor(f"can/{channel}", "", channel, name) for channel in channels)
    bits = (
        f"{channel}: {count} of {channels[channel]} frames have identifiers of 11 bits, which the gateway does not read"
        for channel, count in standard.items()
        if count
    )
    description = Description(name, sensors, ignored=ignored, notes=(*notes, *bits))
    return Recording(path, description, lambda: can_batches(frames()))


def can_lines(path: Path, parse: Callable[[str], Numbered | None]) -> Iterator[Numbered | Skipped]:
    """Frames of the lines of a text log; raises LogError.

    `parse` gives the frame of a stripped line, None for one of a header, and raises ValueError with the reason why a
    line is skipped. A byte order mark, empty lines and comments (#, //) are not lines.
    """
    last_ns, line = 0, "\n"
    try:
        with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
            for line in file:
                if not line.strip() or line.lstrip().startswith(COMMENTS):
                    continue
                try:
                    found = parse(line.strip())
                    if found is not None:
                        check(found[1], line)
                        last_ns = found[1].stamp_ns
                        yield found
                except ValueError as error:
                    yield Skipped(last_ns, path.name, "lines", str(error))
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error})") from error


def check(frame: CanFrame, line: str = "\n") -> None:
    """Raises ValueError for a frame that is none of data: by its line, identifier, length or time."""
    if not line.endswith(("\n", "\r")):
        raise ValueError(CUT)
    if frame.identifier & ERROR:
        raise ValueError(ERROR_FRAME)
    if frame.identifier > EXTENDED_BITS:
        raise ValueError("an identifier of more than 29 bits")
    if len(frame.data) > 8:
        raise ValueError("more than 8 bytes in a frame")
    if not 0 <= frame.stamp_ns < END_NS:
        raise ValueError("a time before 1970 or after 2262 (is it in ms?)")


def can_batches(frames: Iterable[Numbered | Skipped]) -> Iterator[Received | Skipped]:
    """Frames of a channel within 20 ms as one message, received with its last frame; `Skipped` as they come."""
    open_batches: dict[str, list[CanFrame]] = {}
    for item in frames:
        if isinstance(item, Skipped):
            yield item
            continue
        channel, frame = item
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
