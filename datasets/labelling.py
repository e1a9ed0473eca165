"""Decisions of a person on proposed objects, written as the truth sidecar of a log."""

import fcntl
import json
import math
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from datasets.importers.sidecar_lines import BoxLine, FileLine, ObjectLine, Status, read_lines, read_sidecar
from messages.errors import HeadlandError, LogError

PROPOSED = ".proposed.jsonl"
SAME_M = 1.0  # between the first boxes of an object in the truth and in the proposal
At = tuple[float, float, float]  # time in the log (s), x, y in the lidar frame (m)


@dataclass(frozen=True)
class Added:
    """An object that was not perceived: positions of its centre over time, linear between them."""

    label: str
    size_m: tuple[float, float, float]
    positions: tuple[At, ...]


@dataclass(frozen=True)
class Decisions:
    """Changes to the labels of a log; class and size hold for the accepted objects."""

    accepted: tuple[int, ...] = ()
    rejected: tuple[int, ...] = ()
    label: str | None = None
    size_m: tuple[float, float, float] | None = None
    added: tuple[Added, ...] = ()
    is_complete: bool = False


@dataclass
class Labels:
    """Lines of the truth `file` of a log, with the objects of the proposal `source` that it lacks."""

    file: Path
    source: Path | None
    lines: list[dict[str, Any]] = field(default_factory=list)

    @property
    def about(self) -> dict[str, Any]:
        """The line of the file."""
        return next(line for line in self.lines if "log" in line)

    def objects(self) -> list[dict[str, Any]]:
        """Lines of the objects, by first time."""
        heads = [line for line in self.lines if "id" in line and "stamp_ns" not in line and "stamp_s" not in line]
        return sorted(heads, key=lambda line: (line.get("first_s") or 0.0, line["id"]))


def truth_file(log: Path, truth: Path | None) -> Path:
    """File of the truth of a log, links resolved."""
    return (truth or log.with_name(f"{log.name}.truth.jsonl")).resolve()


def read_labels(log: Path, truth: Path | None, proposed: Path | None) -> Labels:
    """Labels of a log; the truth is by default `LOG.truth.jsonl`. Raises LogError, also without any proposal."""
    file = truth_file(log, truth)
    source = proposed or newest_proposal(log)
    labels = Labels(file, source)
    known = read_lines(file) if file.exists() else []
    new = read_lines(source) if source is not None else []
    if not known and not new:
        raise LogError(f"{log}: no proposed objects; first run headland validate {log.name}, or name --proposed FILE")
    if known and not any(isinstance(line, FileLine) for _, line in known):
        raise LogError(
            f"{file}: not written by headland label (no line with the key log); edit it, or name --truth FILE"
        )
    for path, lines in ((file, known), (source, new)):
        about = next((line for _, line in lines if isinstance(line, FileLine)), None)
        if lines and (about is None or about.log != log.name):
            raise LogError(f"{path}: labels of {'no log' if about is None else about.log}, not of {log.name}")
    _check_same(file, source, known, new)
    ids = {line.id for _, line in known if isinstance(line, ObjectLine | BoxLine)}
    labels.lines = [values for values, _ in known]
    labels.lines += [
        values
        for values, line in new
        if (isinstance(line, FileLine) and not known) or (not isinstance(line, FileLine) and values["id"] not in ids)
    ]
    return labels


def newest_proposal(log: Path) -> Path | None:
    """Proposal beside the log, else of the newest run in `runs/`."""
    name = f"{log.name}{PROPOSED}"
    found = sorted(Path("runs").glob(f"*-validate/{_escaped(name)}"), key=lambda p: p.parent.name)
    return next((p for p in (log.with_name(name), *reversed(found)) if p.is_file()), None)


def _escaped(name: str) -> str:
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)


def _check_same(file: Path, source: Path | None, known: Iterable[Any], new: Iterable[Any]) -> None:
    """Raises LogError if an id stands for one object in the truth and for another one in the proposal."""
    first, second = (
        {line.id: line for _, line in reversed(list(lines)) if isinstance(line, BoxLine)} for lines in (known, new)
    )
    for i in sorted(first.keys() & second.keys()):
        a, b = first[i], second[i]
        if a.time_ns != b.time_ns or math.dist(a.center_m, b.center_m) > SAME_M:
            raise LogError(
                f"{source}: object {i} is another one than object {i} of {file}; "
                "name the proposal of that file with --proposed, or move the file"
            )


def decide(labels: Labels, decisions: Decisions) -> None:
    """Applies decisions; raises HeadlandError for unknown ids, naming them, and for contradictions."""
    known = {line["id"] for line in labels.lines if "id" in line}
    unknown = sorted({*decisions.accepted, *decisions.rejected} - known)
    if unknown:
        names = ", ".join(map(str, unknown))
        raise HeadlandError(f"no object {names}; objects: {', '.join(map(str, sorted(known))) or 'none'}")
    both = sorted({*decisions.accepted} & {*decisions.rejected})
    if both:
        raise HeadlandError(f"object {both[0]} both accepted and rejected")
    changes: dict[str, Any] = {"class": decisions.label} if decisions.label is not None else {}
    for line in labels.lines:
        if line.get("id") in decisions.accepted:
            line |= {"status": Status.ACCEPTED.value} | changes
            if decisions.size_m is not None and "stamp_ns" not in line and "stamp_s" not in line:
                line["size_m"] = list(decisions.size_m)
        elif line.get("id") in decisions.rejected:
            line["status"] = Status.REJECTED.value
    for added in decisions.added:
        _add(labels, added)
    if decisions.is_complete:
        undecided = [str(o["id"]) for o in labels.objects() if o["status"] == Status.PROPOSED.value]
        if undecided:
            raise HeadlandError(f"--complete: objects {', '.join(undecided)} are undecided")
        labels.about["is_complete"] = True


def _add(labels: Labels, added: Added) -> None:
    about = labels.about
    number = 1 + max((line["id"] for line in labels.lines if "id" in line), default=0)
    end_s = (about["last_ns"] - about["first_ns"]) * 1e-9
    outside = next((t for t, _, _ in added.positions if not 0.0 <= t <= end_s), None)
    if outside is not None:
        raise HeadlandError(f"--add: {outside:g} s is not within the log (0 to {end_s:.1f} s)")
    same = {"id": number, "status": Status.ACCEPTED.value, "class": added.label}
    z = about["ground_m"] + 0.5 * added.size_m[2]
    times = [t for t, _, _ in added.positions]
    labels.lines.append(
        same | {"size_m": list(added.size_m), "first_s": min(times), "last_s": max(times), "note": "added by a person"}
    )
    labels.lines += [
        {"stamp_ns": about["first_ns"] + round(t * 1e9), "t_s": t} | same
        | {"center_m": [x, y, round(z, 3)], "size_m": list(added.size_m)}
        for t, x, y in added.positions
    ]  # fmt: skip


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Waits for other writers of labels in a folder; raises HeadlandError without the folder."""
    try:
        lock = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise HeadlandError(f"{folder}: cannot be opened ({error.strerror})") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def write_labels(labels: Labels) -> None:
    """Writes the truth in place of the earlier one, at once; raises HeadlandError if that is not possible."""
    temporary = labels.file.with_name(f".{labels.file.name}.new")
    text = "".join(json.dumps(line, ensure_ascii=False) + "\n" for line in labels.lines)
    try:
        try:
            with temporary.open("w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            read_sidecar(temporary)
            temporary.replace(labels.file)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise HeadlandError(f"{labels.file}: cannot be written ({error.strerror}); name --truth FILE") from error
