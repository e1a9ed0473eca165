"""`headland label`: decisions on the objects that `validate` proposes as truth of a log without labels."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from datasets.labelling import Added, At, Decisions, Labels, decide, locked, read_labels, truth_file, write_labels
from messages.errors import HeadlandError
from messages.perception import ObstacleClass


def main(arguments: argparse.Namespace) -> int:
    """Writes the decisions, then lists all objects; 0 on success, raises HeadlandError."""
    if not arguments.log.exists():
        raise HeadlandError(f"{arguments.log}: does not exist")
    if arguments.proposed is not None and not arguments.proposed.is_file():
        raise HeadlandError(f"--proposed {arguments.proposed}: not a file")
    decisions = _decisions(arguments)
    if arguments.list and decisions != Decisions():
        raise HeadlandError("--list takes no decision")
    log = arguments.log.absolute()
    with locked(truth_file(log, arguments.truth).parent):
        labels = read_labels(log, arguments.truth, arguments.proposed)
        if decisions != Decisions():
            decide(labels, decisions)
            write_labels(labels)
    result = _result(arguments.log, labels)
    sys.stdout.write(json.dumps(result) + "\n" if arguments.json else _text(result))
    return 0


def _decisions(arguments: argparse.Namespace) -> Decisions:
    label, size = arguments.label, None
    if arguments.size is not None:
        length, width, height = _numbers("--size", arguments.size, 3)
        size = (length, width, height)
    if label is not None and label not in {one.value for one in ObstacleClass}:
        raise HeadlandError(f"--class {label}: one of {', '.join(ObstacleClass)}")
    if size is not None and min(size) <= 0.0:
        raise HeadlandError(f"--size {arguments.size}: must be positive")
    if (label is not None or size is not None) and not arguments.accept and not arguments.add:
        raise HeadlandError("--class and --size need --accept ID or --add")
    if arguments.add and (label is None or size is None):
        raise HeadlandError("--add needs --class and --size")
    added = tuple(Added(label, size, tuple(map(_at, words))) for words in arguments.add if label and size)
    return Decisions(tuple(arguments.accept), tuple(arguments.reject), label, size, added, arguments.complete)


def _at(word: str) -> At:
    """A position over time, `T:X,Y`."""
    t, colon, xy = word.partition(":")
    if not colon:
        raise HeadlandError(f"--add {word}: not T:X,Y (s in the log; m ahead and left in the lidar frame)")
    x, y = _numbers("--add", xy, 2)
    return _numbers("--add", t, 1)[0], x, y


def _numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or any(abs(v) > 1e6 or v != v for v in values):
        raise HeadlandError(f"{option} {text}: {count} number{'s' * (count > 1)} needed")
    return values


def _result(log: Path, labels: Labels) -> dict[str, Any]:
    """Object of `--json`."""
    objects = labels.objects()
    folder = labels.source.parent if labels.source is not None else None
    for one in objects:
        if one.get("picture") and folder is not None:
            one["picture"] = str(folder / one["picture"])
    return {
        "log": str(log), "truth": str(labels.file), "proposed": None if labels.source is None else str(labels.source),
        "is_complete": labels.about.get("is_complete", False), "objects": objects,
        "undecided": [one["id"] for one in objects if one["status"] == "proposed"],
    }  # fmt: skip


def _text(result: dict[str, Any]) -> str:
    lines = [f"{'id':>6} {'status':<10}{'class':<9}{'from s':>8}{'to s':>8}{'range m':>15}  stop  picture"]
    for one in result["objects"]:
        first, last, ranges = one.get("first_s"), one.get("last_s"), one.get("range_m")
        times = "".join(f"{'—' if t is None else format(t, '.1f'):>8}" for t in (first, last))
        span = "—" if ranges is None else f"{ranges[0]:.1f} → {ranges[1]:.1f}"
        stop = {True: "yes", False: "no", None: "—"}[one.get("is_stop_requested")]
        name = f"{one['id']:>6} {one['status']:<10}{one['class']:<9}"
        lines.append(f"{name}{times}{span:>15}  {stop:<5} {one.get('picture') or '—'}")
    counts = f"{len(result['objects'])} objects, {len(result['undecided'])} undecided"
    reviewed = "all objects in the path are listed" if result["is_complete"] else "not reviewed for missing objects"
    lines += [f"{counts}, {reviewed}", f"truth: {result['truth']}"]
    return "\n".join(lines) + "\n"
