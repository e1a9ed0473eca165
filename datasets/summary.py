"""Summary of a log: topics, rates, gaps, completeness, undecodable messages."""

import json
import math
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from datasets.digest import Digest
from datasets.reader import Entry, LogScan, ProtobufDecoders, is_ours
from messages.errors import LogError

FRAME_SCHEMAS = {"foxglove.FrameTransforms", "foxglove.FrameTransform"}


@dataclass
class TopicSummary:
    """One topic; `longest_gap_s` between receptions, `failed` counts undecodable messages."""

    topic: str
    schema: str
    encoding: str
    count: int = 0
    bytes: int = 0
    first_ns: int = 0
    last_ns: int = 0
    longest_gap_s: float = 0.0
    missing: int = 0
    failed: int = 0

    @property
    def rate_hz(self) -> float | None:
        """Mean rate (Hz); None for a single message."""
        span_s = (self.last_ns - self.first_ns) * 1e-9
        return (self.count - 1) / span_s if span_s > 0.0 else None


@dataclass
class FrameTree:
    """Frames of a log: parents of each child."""

    parents: dict[str, set[str]] = field(default_factory=dict)

    def add(self, parent: str, child: str) -> None:
        """Adds a transform from `parent` to `child`."""
        self.parents.setdefault(child, set()).add(parent)

    @property
    def frames(self) -> list[str]:
        """All frames, sorted."""
        return sorted(set(self.parents).union(*self.parents.values()))

    @property
    def roots(self) -> list[str]:
        """Frames without parent."""
        return [frame for frame in self.frames if frame not in self.parents]

    @property
    def is_one_tree(self) -> bool:
        """Whether there is one root, and every other frame has one parent and descends from it."""
        if len(self.roots) != 1 or any(len(parents) != 1 for parents in self.parents.values()):
            return False
        return all(self._reaches_root(frame) for frame in self.parents)

    def _reaches_root(self, frame: str) -> bool:
        for _ in range(len(self.parents)):
            if frame in self.parents:
                (frame,) = self.parents[frame]
        return frame in self.roots


@dataclass(frozen=True)
class LogSummary:
    """Result of `summarize_log`; `lost_bytes` are unreadable, `digest` is over the Headland messages in the log.

    `is_digest_valid` is None without a digest in the end record.
    """

    path: str
    size_bytes: int
    is_complete: bool
    problems: tuple[str, ...]
    lost_bytes: int
    messages: int
    start_ns: int | None
    end_ns: int | None
    topics: tuple[TopicSummary, ...]
    frames: tuple[str, ...]
    is_one_tree: bool | None
    undecoded: int
    digest: str
    is_digest_valid: bool | None
    metadata: dict[str, dict[str, str]]

    @property
    def span_s(self) -> float:
        """From the first message to the last."""
        return 0.0 if self.start_ns is None or self.end_ns is None else (self.end_ns - self.start_ns) * 1e-9


def summarize_log(path: Path) -> LogSummary:
    """Reads a complete or truncated log; raises LogError for a file that is not MCAP."""
    scan, statistics = LogScan(path), _LogStatistics()
    for entry in scan:
        statistics.add(entry)
    topics = tuple(sorted(statistics.topics.values(), key=lambda t: t.topic))
    claimed = scan.metadata.get("end", {}).get("digest")
    digest = statistics.digest.text()
    return LogSummary(
        path=str(path),
        size_bytes=scan.size_bytes,
        is_complete=scan.is_complete,
        problems=tuple(_problems(scan, statistics)),
        lost_bytes=sum(damage.length for damage in scan.damages),
        messages=sum(t.count for t in topics),
        start_ns=min((t.first_ns for t in topics), default=None),
        end_ns=max((t.last_ns for t in topics), default=None),
        topics=topics,
        frames=tuple(statistics.tree.frames),
        is_one_tree=statistics.tree.is_one_tree if statistics.tree.parents else None,
        undecoded=sum(t.failed for t in topics),
        digest=digest,
        is_digest_valid=None if claimed is None else claimed == digest,
        metadata=scan.metadata,
    )


class _LogStatistics:
    """Counts, rates, frames and digest, updated by entry."""

    def __init__(self) -> None:
        self.topics: dict[str, TopicSummary] = {}
        self.tree = FrameTree()
        self.digest = Digest()
        self.failures: Counter[str] = Counter()
        self._sequences: dict[str, int] = {}
        self._decoders = ProtobufDecoders()

    def add(self, entry: Entry) -> None:
        name = entry.schema.name if entry.schema is not None else ""
        topic = self.topics.setdefault(entry.topic, TopicSummary(entry.topic, name, entry.encoding))
        _count(topic, entry)
        if is_ours(entry):
            self.digest.add(entry.topic, entry.stamp_ns, entry.data)
            topic.missing += max(0, entry.sequence - self._sequences.get(entry.topic, entry.sequence - 1) - 1)
            self._sequences[entry.topic] = entry.sequence
        try:
            self._decode(entry, name)
        except LogError as error:
            topic.failed += 1
            self.failures[str(error)] += 1

    def _decode(self, entry: Entry, name: str) -> None:
        if entry.encoding == "json":
            _check_json(entry)
        elif entry.encoding == "protobuf":
            proto = self._decoders.decode(entry)
            if name in FRAME_SCHEMAS:
                for one in proto.transforms if name.endswith("s") else (proto,):
                    self.tree.add(one.parent_frame_id, one.child_frame_id)


def _count(topic: TopicSummary, entry: Entry) -> None:
    if topic.count:
        topic.longest_gap_s = max(topic.longest_gap_s, (entry.receive_ns - topic.last_ns) * 1e-9)
    else:
        topic.first_ns = topic.last_ns = entry.receive_ns
    topic.count += 1
    topic.bytes += len(entry.data)
    topic.first_ns, topic.last_ns = min(topic.first_ns, entry.receive_ns), max(topic.last_ns, entry.receive_ns)


def _check_json(entry: Entry) -> None:
    try:
        json.loads(entry.data)
    except ValueError as error:
        raise LogError(f"topic {entry.topic!r}: a message is not JSON ({error})") from error


def _problems(scan: LogScan, statistics: _LogStatistics) -> list[str]:
    out = [f"byte {d.offset}: {d.reason}; {d.length} bytes lost" for d in scan.damages]
    if scan.orphans:
        out.append(f"{scan.orphans} messages of a channel in a lost part")
    out += [f"{text} ({count} times)" for text, count in statistics.failures.items()]
    read = sum(t.count for t in statistics.topics.values()) + scan.orphans
    if scan.declared_messages not in (None, read):
        out.append(f"the end record states {scan.declared_messages} messages, {read} were read")
    return out


def summary_json(summary: LogSummary) -> dict[str, Any]:
    """Object of `inspect-log --json`; missing numbers are null."""
    out = asdict(summary) | {"span_s": summary.span_s}
    out["topics"] = [asdict(t) | {"rate_hz": t.rate_hz} for t in summary.topics]
    return out


def render_summary(summary: LogSummary) -> str:
    """The summary as text."""
    state = "complete" if summary.is_complete else "TRUNCATED OR DAMAGED"
    size = summary.size_bytes / 1e6
    lines = [
        f"{summary.path}: {state}, {size:.1f} MB, {summary.messages} messages, {summary.span_s:.1f} s",
        *(f"  ! {problem}" for problem in summary.problems),
        f"  {'topic':<28}{'schema':<30}{'count':>8}{'Hz':>8}{'gap s':>8}{'lost':>6}{'bad':>5}{'MB':>9}",
        *(f"  {_row(t)}" for t in summary.topics),
        f"  frames: {_tree_text(summary)}",
        f"  digest: {summary.digest}{_DIGEST_TEXT[summary.is_digest_valid]}",
    ]
    lines += [f"  {name}: {_short(values)}" for name, values in summary.metadata.items()]
    return "\n".join(lines)


_DIGEST_TEXT = {None: "", True: " (as in the end record)", False: " (NOT as in the end record)"}


def _row(topic: TopicSummary) -> str:
    rate = topic.rate_hz if topic.rate_hz is not None else math.nan
    return (
        f"{topic.topic:<28}{topic.schema:<30}{topic.count:>8}{rate:>8.1f}{topic.longest_gap_s:>8.2f}"
        f"{topic.missing:>6}{topic.failed:>5}{topic.bytes / 1e6:>9.2f}"
    )


def _tree_text(summary: LogSummary) -> str:
    if summary.is_one_tree is None:
        return "none"
    return f"{', '.join(summary.frames)} ({'one tree' if summary.is_one_tree else 'NOT one tree'})"


def _short(values: dict[str, str]) -> str:
    return ", ".join(
        f"{key} = {value if len(value) <= 60 else f'({len(value)} characters)'}" for key, value in values.items()
    )
