"""A time interval of a recording as a recording of its own."""

import math
from collections.abc import Iterator
from dataclasses import replace

from datasets.importers.recording import Received, Recording, Skipped
from messages.errors import LogError
from messages.message import Message

HELD = ("path",)  # sent once, valid until the next


def excerpt(recording: Recording, from_s: float, to_s: float) -> Recording:
    """Messages from `from_s` to `to_s` after the first, preceded by earlier paths, which are still valid.

    Raises LogError when the interval is empty.
    """
    if not 0.0 <= from_s < to_s:
        raise LogError(f"from {from_s} s to {to_s} s is no time interval of a recording")
    note = f"from {from_s:g} s to {'its end' if math.isinf(to_s) else f'{to_s:g} s'} of the recording"
    about = replace(recording.description, notes=(*recording.description.notes, note))
    return Recording(recording.path, about, lambda: _between(recording, from_s, to_s))


def _between(recording: Recording, from_s: float, to_s: float) -> Iterator[Received | Skipped]:
    begin_ns: int | None = None
    held: list[tuple[str, Message]] = []
    for item in recording.messages():
        begin_ns = item[0] if begin_ns is None else begin_ns
        at_s = (item[0] - begin_ns) * 1e-9
        if at_s > to_s:
            return
        if at_s >= from_s:
            yield from ((item[0], t, m) for t, m in held)
            held.clear()
            yield item
        elif not isinstance(item, Skipped) and item[1] in HELD:
            held.append((item[1], item[2]))
