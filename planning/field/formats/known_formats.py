"""Formats of field files: every module of this folder with `NAME` and `sniff` reads one, found without a list.

A format is recognized by content. The first module in alphabetical order that answers is used.
"""

from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Protocol, cast

from messages.errors import FieldError
from planning.field import formats
from planning.field.formats.contents import FieldFile
from planning.field.formats.source import Source

Read = Callable[[], FieldFile]


class Format(Protocol):
    """Contract of a format module."""

    NAME: str

    def sniff(self, source: Source) -> Read | None:
        """The function that reads `source`, or None for another format; it raises FieldError."""


@cache
def known_formats() -> tuple[Format, ...]:
    """All format modules, by name."""
    modules = (import_module(f"{formats.__name__}.{m.name}") for m in iter_modules(formats.__path__))
    return tuple(cast(Format, module) for module in modules if hasattr(module, "sniff"))


def read_file(path: Path) -> FieldFile:
    """Fields and guidance lines of a file of any known format; raises FieldError."""
    source = Source(path)
    if not source.names and not source.head:
        raise FieldError(f"{path}: " + ("an empty folder" if path.is_dir() else "the file is empty"))
    for known in known_formats():
        if (read := known.sniff(source)) is not None:
            return read()
    names = ", ".join(known.NAME for known in known_formats())
    raise FieldError(f"{path}: no known field format ({names}); {_contents(source)}")


def _contents(source: Source) -> str:
    if source.names:
        more = len(source.names) - 5
        return f"it holds {', '.join(source.names[:5])}" + (f" and {more} more" if more > 0 else "")
    if source.xml is not None:
        return f"it is XML with the root <{source.xml.tag[:40]}>"
    return f"it begins with {source.head[:16]!r}"
