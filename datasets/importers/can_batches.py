"""CAN frames of a recording as messages, one per channel and 20 ms."""

from collections.abc import Iterable, Iterator

from datasets.importers.recording import Received, Skipped
from messages.command import CanFrame, CanFrames

# Duration of one message, the period of the machine's topic.
BATCH_NS = 20_000_000


def can_batches(frames: Iterable[tuple[str, CanFrame] | Skipped]) -> Iterator[Received | Skipped]:
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
