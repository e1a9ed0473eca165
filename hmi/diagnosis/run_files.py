"""Run folders, and the files of them that may be downloaded."""

import json
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

MAX_LISTED = 100
MAX_MANIFEST = 1_000_000
OFFERED = re.compile(r"log(\.\d+)?\.mcap|report\.html|result\.jsonl|console\.log|config\.yaml")
NAME = re.compile(r"[\w+-][\w.+-]{0,120}")


@dataclass(frozen=True)
class Run:
    """A run folder: the verb that made it, whether it is complete, and the size of each offered file (bytes)."""

    name: str
    verb: str
    is_complete: bool
    files: dict[str, int]


def runs_of(folder: Path) -> list[Run]:
    """The newest run folders of a folder, those that a command of Headland has made."""
    try:
        names = sorted(
            (entry.name for entry in os.scandir(folder) if entry.is_dir(follow_symlinks=False)), reverse=True
        )
    except OSError:
        return []
    found = (run for name in names if (run := _run(folder, name)) is not None)
    return [run for run, _ in zip(found, range(MAX_LISTED), strict=False)]


def file_of(folder: Path, run: str, name: str) -> Path | None:
    """A file that may be downloaded; None for anything else, such as links and names with folders."""
    if not OFFERED.fullmatch(name) or (found := _run(folder, run)) is None or name not in found.files:
        return None
    return folder / run / name


def _run(folder: Path, name: str) -> Run | None:
    path = folder / name
    if not NAME.fullmatch(name) or path.is_symlink():
        return None
    with suppress(OSError, ValueError, AttributeError):
        manifest = path / "manifest.json"
        if manifest.is_symlink() or manifest.stat().st_size > MAX_MANIFEST:
            return None
        values = json.loads(manifest.read_text(encoding="utf-8"))
        return Run(name, str(values.get("verb", ""))[:20], values.get("is_complete") is True, dict(_sizes(path)))
    return None


def _sizes(path: Path) -> Iterator[tuple[str, int]]:
    for entry in sorted(os.scandir(path), key=lambda entry: entry.name):
        if OFFERED.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
            yield entry.name, entry.stat(follow_symlinks=False).st_size
