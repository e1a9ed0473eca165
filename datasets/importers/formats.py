"""Recording formats: every module of this folder with `NAME` and `sniff` is an importer, found without a list.

An importer decides by content, never by file name. The first module in alphabetical order that answers is used.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Protocol, cast

from datasets import importers
from datasets.importers.recording import Open, Recording, read_head
from datasets.importers.unread_formats import name_of
from messages.errors import LogError

# Entries of a folder among which a recording is looked for
MAX_ENTRIES = 100


class Importer(Protocol):
    """Contract of an importer module; with `TAKES_LABELS = True` its `open` function accepts label files as truth."""

    NAME: str

    def sniff(self, path: Path, head: bytes) -> Open | None:
        """The function that opens `path`, or None for another format; `head` holds the first bytes of a file."""


@cache
def known_importers() -> tuple[Importer, ...]:
    """All importer modules, by name."""
    names = sorted(module.name for module in iter_modules(importers.__path__))
    modules = (import_module(f"{importers.__name__}.{name}") for name in names)
    return tuple(cast(Importer, module) for module in modules if hasattr(module, "sniff"))


def open_recording(path: Path, truth: Path | None = None) -> Recording:
    """A recording of any known format; `truth` names labels outside its folder. Raises LogError."""
    if truth is not None and not truth.exists():
        raise LogError(f"{truth}: there is no such truth")
    importer, open_path = _find(path)
    if truth is not None and not getattr(importer, "TAKES_LABELS", False):
        raise LogError(f"{truth}: labels cannot be used with {path.name}, a recording of format {importer.NAME}")
    return open_path(path, truth)


def takes_labels(path: Path) -> bool:
    """Whether the format of a recording accepts label files as truth; raises LogError."""
    return bool(getattr(_find(path)[0], "TAKES_LABELS", False))


def _find(path: Path) -> tuple[Importer, Open]:
    head = b"" if path.is_dir() else read_head(path)
    if not head and not path.is_dir():
        raise LogError(f"{path}: is empty, nothing was recorded")
    if (found := _sniff(path, head)) is not None:
        return found
    names = ", ".join(importer.NAME for importer in known_importers())
    if path.is_dir():
        some = ", ".join(sorted(p.name for p in path.iterdir())[:6]) or "nothing"
        raise LogError(f"{path}: no known recording format ({names}); it holds {some}{_deeper(path)}")
    if (name := name_of(head)) is not None:
        raise LogError(f"{path}: is {name}, which is not read; read are {names}")
    raise LogError(f"{path}: no known recording format ({names}); it begins with {head[:16]!r}")


def _sniff(path: Path, head: bytes) -> tuple[Importer, Open] | None:
    opens = ((importer, importer.sniff(path, head)) for importer in known_importers())
    return next(((importer, found) for importer, found in opens if found is not None), None)


def _deeper(folder: Path) -> str:
    """Which of the first entries of a folder is a recording, for an error."""
    for path in sorted(folder.iterdir())[:MAX_ENTRIES]:
        try:
            found = _sniff(path, b"" if path.is_dir() else read_head(path))
        except (LogError, OSError):
            continue
        if found is not None:
            return f"; give {path} ({found[0].NAME}), or another one in the folder"
    return ""
